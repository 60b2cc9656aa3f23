"""A person's hand, tracked, drives a robot's: a client of `Hand` that never turns its loop.
docs/how-to/teleoperate.md.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.surfaces.teleop.session import open_follower

__all__ = [
    "open_follower",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "session": ("open_follower",),
    },
)
