"""The lengths of one finger, read from the table of facts: what the closed forms need and nothing more."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.kinematics.orientation import matrix_from_euler
from allegro_twin.types import Array, Vector, frozen

_FINGER = [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 1, 0]]
_THUMB = [[-1, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 0]]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """One finger of the right hand at zero. Lengths m; the base frame is joint 0's, seen from the palm."""

    is_thumb: bool
    origin: Vector
    """The base frame's origin in the palm, shape (3,)."""
    base: Array
    """The base frame's orientation in the palm, shape (3, 3)."""
    offset: Vector
    """From joint 0 to joint 1 in the base frame, shape (3,)."""
    rise: float
    """From joint 1 to joint 2 along z on the thumb; zero on a finger, whose joints 1 to 3 all bend."""
    links: tuple[float, ...]
    """From each bending joint to the next, and from the last to the tip: three on a finger, two on the thumb."""


@cache
def has_closed_form(model: str, finger: str) -> bool:
    """Whether `load_geometry` has it."""
    try:
        load_geometry(model, finger)
    except ConfigError:
        return False
    return True


@cache
def load_geometry(model: str, finger: str) -> Geometry:
    """The geometry of one finger, from models/<model>.yaml. Raises ConfigError where the closed form does not hold."""
    path = data_root() / "models" / f"{model}.yaml"
    if not path.is_file():
        raise ConfigError(f"{model} {finger}: no closed form, for its links and axes are in no models/{model}.yaml")
    table = read_yaml(path)
    place = table["fingers"][finger]
    rows = table["chains"][place["chain"]]
    axes = [row["axis"] for row in rows]
    steps = [row["xyz"] for row in rows[1:]] + [[0.0, 0.0, place["tip"]]]
    straight = all(step[:2] == [0, 0] for step in (steps if axes == _FINGER else steps[1:]))
    if axes not in (_FINGER, _THUMB) or not straight:
        raise ConfigError(f"{model} {finger}: its axes and offsets have no closed form")
    is_thumb = axes == _THUMB
    return Geometry(
        is_thumb=is_thumb,
        origin=frozen(place["xyz"]),
        base=frozen(matrix_from_euler(np.array(place["rpy"], dtype=np.float64))),
        offset=frozen(steps[0]),
        rise=float(steps[1][2]) if is_thumb else 0.0,
        links=tuple(float(step[2]) for step in steps[2 if is_thumb else 1 :]),
    )
