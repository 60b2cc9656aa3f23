"""How a hand lies while it is excited: three ways, which together show every joint its weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.spec import Side
from allegro_twin.types import Vector

G = 9.81  # m/s²
TILT = np.radians(15.0)  # rad. A stand that leans more is another pose.


@dataclass(frozen=True, slots=True)
class Pose:
    """One way to lay the hand."""

    name: str
    facing: tuple[float, float, float]
    """Where the palm looks, world axes; z is up."""
    fingers: tuple[float, float, float]
    """Where stretched fingers point."""
    words: str
    """For a person."""

    @property
    def gravity(self) -> tuple[float, float, float]:
        """In the palm frame (x: where the palm looks, z: where the fingers point), m/s²."""
        x, z = np.array(self.facing), np.array(self.fingers)
        down = np.array([0.0, 0.0, -G])
        a, b, c = (float(down @ axis) + 0.0 for axis in (x, np.cross(z, x), z))
        return a, b, c

    def check(self, measured: Vector) -> None:
        """Raise ConfigError where gravity in the palm frame (3,), m/s², says that the hand lies otherwise."""
        known = np.array(self.gravity)
        length = float(np.linalg.norm(measured))
        if not np.isfinite(length) or length < 0.1 * G:
            return
        lean = float(np.arccos(np.clip(measured @ known / length / G, -1.0, 1.0)))
        if lean > TILT:
            raise ConfigError(
                f"the hand's IMU is {np.degrees(lean):.0f}° off the pose {self.name!r}: {self.words}, or name the pose "
                "that it has"
            )


def pose(name: str, side: Side) -> Pose:
    """A pose by its name, for a hand of that side. Raises ConfigError with the nearest names."""
    thumb = 1.0 if side == "right" else -1.0
    known = (
        Pose("up", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), "stand the hand upright, its fingers pointing up"),
        Pose("palm-up", (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), "lay the hand on its back, the palm looking up"),
        Pose("side", (0.0, -thumb, 0.0), (1.0, 0.0, 0.0), "lay the hand on its edge, the thumb's side up"),
        Pose("palm-down", (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), "hold the hand out, the palm looking down"),
    )
    for each in known:
        if each.name == name:
            return each
    raise ConfigError(unknown("pose", name, [each.name for each in known]))
