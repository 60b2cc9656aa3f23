"""What a simulated arm has that a hand has not: it holds itself while nobody commands it, and feels at its flange."""

from __future__ import annotations

from typing import TypeAlias

import mujoco
import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import Vector

Places: TypeAlias = slice | list[int]
"""Of its joints in an array of the simulation."""
_STIFFNESS, _DAMPING = 7.0, 0.6
"""Of its joints, in their torque limits: N·m/rad and N·m·s/rad a N·m. OWN: a hand's weight moves it a millimetre."""


class Holding:
    """Counts an arm's periods without a command, and holds it from `silence` on; also before the first command."""

    def __init__(self, spec: ArmSpec, period: float, qpos: Places, dof: Places) -> None:
        self._patience = max(round(spec.silence / period), 1)
        self._limit, self._qpos, self._dof = spec.actuation.torque_limit, qpos, dof
        self._missed = self._patience
        self._at: Vector | None = None

    def reset(self) -> None:
        """Nobody has commanded it yet."""
        self._missed, self._at = self._patience, None

    def heard(self) -> None:
        """A command came."""
        self._missed, self._at = 0, None

    def torque(self, data: mujoco.MjData) -> Vector | None:
        """For the period that begins, (n,), N·m; None: what was commanded last."""
        self._missed += 1
        if self._missed <= self._patience:
            return None
        if self._at is None:
            self._at = data.qpos[self._qpos].copy()
        error = self._at - data.qpos[self._qpos]
        wanted: Vector = self._limit * (_STIFFNESS * error - _DAMPING * data.qvel[self._dof])
        return np.minimum(np.maximum(wanted, -self._limit), self._limit)


def feels(spec: HandSpec, model: mujoco.MjModel) -> Places | None:
    """Where an arm's sensors of force and torque are among all that the simulation senses."""
    if not isinstance(spec, ArmSpec):
        return None
    found: list[int] = []
    for kind in ("force", "torque"):
        start = int(model.sensor(f"{spec.flange}_{kind}").adr[0])
        found += range(start, start + 3)
    return slice(found[0], found[-1] + 1) if found == list(range(found[0], found[0] + 6)) else found
