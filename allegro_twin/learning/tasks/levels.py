"""How much of an object a task with a scripted grasp varies, at each of its levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.types import Array

_Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Variation:
    """What is drawn of an object at every reset, unless `randomise` or an option of the reset says it."""

    noise: float
    """It is off by up to so much along each axis, m."""
    yaw: float = 0.0
    """It is turned about the vertical by up to so much, rad."""
    friction: _Range | None = None
    """Sliding friction of every contact."""
    mass: _Range | None = None
    """Factor on its mass."""
    size: _Range | None = None
    """Factor on its size."""
    push: float = 1.0
    """Factor on the pushes."""

    def draw(self, draws: Draws, values: dict[str, Array]) -> None:
        """Put what nobody has drawn into `values`; the same numbers are used up whatever is missing."""
        for name in ("friction", "mass", "size"):
            share = draws.within(0.0, 1.0)[:, 0]
            found: _Range | None = getattr(self, name)
            if found is not None and name not in values:
                values[name] = found[0] + (found[1] - found[0]) * share


EASY = Variation(noise=0.010)
HARD = Variation(noise=0.020, yaw=float(np.radians(20.0)), friction=(0.4, 1.0), mass=(0.5, 2.5), size=(0.9, 1.1))
