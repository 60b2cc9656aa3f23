"""Inverse kinematics of a fingertip that is dragged: where it can be, and with which joints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.kinematics.closed_form.finger import FingerKinematics
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


class DraggedTip(NamedTuple):
    """The answer to a fingertip that is dragged."""

    posture: Vector | None
    """All joints, (n,), rad; None: it cannot be there."""
    nearest: Vector
    """The place in reach that is nearest, (3,), m, palm frame."""
    distance: float
    """From there to the point that was asked for, m."""


class TipIK:
    """Inverse kinematics of every finger of a hand, in closed form. Raises ConfigError for a hand without one."""

    def __init__(self, spec: HandSpec) -> None:
        self._fingers = {finger.name: finger for finger in spec.fingers}
        self._solvers = {name: FingerKinematics(spec, name) for name in self._fingers}

    def tip(self, finger: str, position: Vector) -> Vector:
        """The tip's centre in a posture, (n,), rad: (3,), m, palm frame."""
        joints = list(self._fingers[finger].joints)
        return np.asarray(self._solvers[finger].tip(position[joints]))

    def drag(self, finger: str, point: Vector, near: Vector) -> DraggedTip:
        """Move a tip to a point, (3,), m, palm frame, by the posture nearest to `near`, (n,), rad."""
        joints, solver = list(self._fingers[finger].joints), self._solvers[finger]
        held = np.clip(near[joints], solver.lower, solver.upper)
        best = solver.ik(point, near=held).best(held)
        if best.reached:
            posture = near.copy()
            posture[joints] = np.clip(best.posture, solver.lower, solver.upper)
            return DraggedTip(posture, point, 0.0)
        return DraggedTip(None, np.asarray(solver.tip(best.posture)), float(best.distance))
