"""Many simulations at once: on threads, and on a GPU.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.sim.batch.cpu import Rows, SimBatch

__all__ = [
    "Rows",
    "SimBatch",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "cpu": (
            "Rows",
            "SimBatch",
        ),
    },
)
