"""A gait: a posture around which every joint swings, again and again. It is a script like a grasp's closing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from allegro_twin.files.assets import find, read_yaml
from allegro_twin.files.schema import Settings, parse
from allegro_twin.policy.script import Script
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array, Vector, frozen

Row = tuple[float, ...]


class Hold(Settings):
    """The object in the grasp that a gait's posture is, above the upturned palm of the gait's own side."""

    size: Annotated[float, Field(gt=0)]
    """Factor on its size."""
    place: tuple[float, float, float]
    """Of its middle, m: x where the fingers point, z up, from the palm's origin."""
    yaw: float
    """rad."""


class Gait(Settings):
    """Set-points posture + r(t) · (shift + Σ amplitude_k · sin(2π k f t + phase_k)), k = 1, 2; r rises from 0 to 1."""

    description: str
    side: Side
    """Which hand the angles are for; the other does the mirror image."""
    frequency: Annotated[float, Field(gt=0)]
    """f, Hz."""
    rise: Annotated[float, Field(gt=0)]
    """s until r is 1."""
    posture: Row
    """rad, a number a joint, as all that follow."""
    shift: Row
    amplitude: tuple[Row, Row]
    phase: tuple[Row, Row]
    hold: Hold

    def swing(self, t: Vector) -> Array:
        """How far the set-points are from the posture at some times (t,), shape (t, n), rad; of the gait's own side."""
        turn = 2.0 * np.pi * self.frequency * t[:, None]
        swing: Array = np.array(self.shift) + np.zeros_like(turn)
        for k, amplitude, phase in zip((1, 2), self.amplitude, self.phase, strict=True):
            swing = swing + np.array(amplitude) * np.sin(k * turn + np.array(phase))
        return np.asarray(np.minimum(t / self.rise, 1.0)[:, None] * swing)

    def rest(self, spec: HandSpec) -> Vector:
        """The posture on this hand, (n,), rad."""
        return frozen(self._on(spec, np.array(self.posture)))

    def sampled(self, spec: HandSpec, periods: int, period: float) -> Script:
        """A row a period. The rates are zero: the law damps against standing still, as it did in the search."""
        position = self._on(spec, np.array(self.posture) + self.swing(frozen(np.arange(periods) * period)))
        return Script(frozen(position), frozen(np.zeros_like(position)))

    def _on(self, spec: HandSpec, position: Array) -> Array:
        return position if spec.side == self.side else spec.mirrored(position)


def load_gait(name: str | Path) -> Gait:
    """By path or by its name in conf/gaits. Raises ConfigError with the nearest names."""
    path = find(name, "gait", "conf/gaits")
    return parse(Gait, read_yaml(path), str(path))
