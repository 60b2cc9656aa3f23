"""Robot cell: an arm, a hand and a camera that find an object, take it and check the grasp.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.cell.assembly import Cell, make_cell
    from allegro_twin.cell.run import LabReport, perform
    from allegro_twin.cell.settings import LabSettings

__all__ = [
    "Cell",
    "LabReport",
    "LabSettings",
    "make_cell",
    "perform",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "assembly": (
            "Cell",
            "make_cell",
        ),
        "run": (
            "LabReport",
            "perform",
        ),
        "settings": ("LabSettings",),
    },
)
