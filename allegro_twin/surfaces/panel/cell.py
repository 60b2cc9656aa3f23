"""What passes between a cell and its page: moments, what it looks like, and where its palm is wished."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


class CellFrame(NamedTuple):
    """One moment."""

    t: float
    """s, on the cell's clock."""
    arm: Vector
    """(n,), rad."""
    hand: Vector
    """(m,), rad."""
    poses: Mapping[str, Vector]
    """`flange`, `tool`, the palm, `goal`, where the palm is to be, and `objects`, of all things in a row: (7,) each."""
    force: Vector
    """On the hand, (3,), N, world."""
    stopped: bool
    """Nothing is obeyed until somebody releases the stop."""


@dataclass(frozen=True, slots=True)
class CellOpened:
    """A cell is there."""

    title: str
    arm: HandSpec
    hand: HandSpec
    look: Mapping[str, Any]
    """As its recording has it: `lab.look.cell_look`."""
    lower: tuple[float, float, float]
    """Where the palm may be, m, world."""
    upper: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Place:
    """Be with the palm at a pose of the world: position, m, and quaternion w x y z."""

    pose: tuple[float, ...]
