"""Everything that makes a hand visible: cameras, films, strips, and what Rerun shows; colours and views are shared.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import allegro_twin.sim as sim  # noqa: F401  # It chooses how MuJoCo renders, which must come before MuJoCo.
from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.viewing.camera import Camera
    from allegro_twin.viewing.films import filmed
    from allegro_twin.viewing.plot import Line, plot
    from allegro_twin.viewing.report.html import film_figure
    from allegro_twin.viewing.stills import pictured, save_png

__all__ = [
    "Camera",
    "Line",
    "film_figure",
    "filmed",
    "pictured",
    "plot",
    "save_png",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "camera": ("Camera",),
        "films": ("filmed",),
        "report.html": ("film_figure",),
        "plot": (
            "Line",
            "plot",
        ),
        "stills": (
            "pictured",
            "save_png",
        ),
    },
)
