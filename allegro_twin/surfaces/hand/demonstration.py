"""Demonstration: states of a hand that somebody guides by hand."""

from __future__ import annotations

import numpy as np

from allegro_twin.control.demonstration import TaughtMotion, trim_demonstration
from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.spec.hand import GIVE
from allegro_twin.types import Array, Sample, Vector

_WRONG = 0.2
"""rad beyond a limit from which it is no stop that yields (ours)."""


class Demonstration:
    """Keeps every sample of what a person shows."""

    def __init__(self, spec: HandSpec) -> None:
        self._spec = spec
        self._rows: list[tuple[float, Vector]] = []
        self._ended = False

    def __call__(self, sample: Sample) -> None:
        if not self._ended:
            self._rows.append((sample.state.t, sample.state.position))

    def end(self) -> None:
        """What comes from now on is not shown by anybody. Any thread may call it."""
        self._ended = True

    @property
    def empty(self) -> bool:
        """Whether nothing has been shown."""
        return not self._rows

    def posture(self) -> Vector:
        """Where the fingers were left, (n,), rad. Raises ConfigError, as `motion` does, for a joint further beyond its
        limits than any stop yields."""
        if not self._rows:
            raise ConfigError("nothing was taught: no time has passed in the demonstration; hand.wait(seconds) lets it")
        return self._inside(self._rows[-1][1])

    def motion(self, tolerance: float = 0.004) -> TaughtMotion:
        """The way they went, trimmed and simplified to within `tolerance` (rad)."""
        self.posture()
        times, positions = zip(*self._rows, strict=True)
        return trim_demonstration(np.array(times), self._inside(np.array(positions)), tolerance=tolerance)

    def clipped(self, *, motion: bool = True) -> str:
        """Which joint went furthest beyond its limits, where it was by more than a stop yields, and by how much; empty
        where none did. What is taught ends at the limits. `motion`: in the whole motion; otherwise in the posture."""
        position = np.array([each for _, each in (self._rows if motion else self._rows[-1:])])
        if not len(position):
            return ""
        joint, excess = self._furthest(position)
        return "" if excess <= GIVE else f"{joint} went {excess:.3f} rad beyond its limit; what is stored ends there"

    def _inside(self, positions: Array) -> Array:
        """A joint that leans on its stop gives; what is taught ends at the limit."""
        joint, excess = self._furthest(positions)
        if excess > _WRONG:
            raise ConfigError(
                f"{joint} was read {excess:.2f} rad beyond its limit, where no stop yields more than {_WRONG:g}: its "
                "encoder's zero or the limit is wrong; `allegro-twin calibrate limits` measures it"
            )
        return np.clip(positions, self._spec.lower, self._spec.upper)

    def _furthest(self, positions: Array) -> tuple[str, float]:
        """Which joint of positions, (…, n), rad, is furthest beyond its limits, and by how much, rad."""
        excess = np.maximum(self._spec.lower - positions, positions - self._spec.upper)
        joint = int(np.unravel_index(int(excess.argmax()), excess.shape)[-1])
        return self._spec.joint_labels[joint], float(excess.max())
