"""Inverse kinematics of a fingertip that is dragged: where it can be, and with which joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


class DraggedTip(NamedTuple):
    """The answer to a fingertip that is dragged."""

    posture: Mapping[int, float] | None
    """Positions of the finger's joints by number, rad; None: it cannot be there."""
    nearest: Vector
    """The place in reach that is nearest, (3,), m, palm frame."""
    distance: float
    """From there to the point that was asked for, m."""


class TipIK:
    """Inverse kinematics of every finger of a hand whose fingers can be moved alone."""

    def __init__(self, spec: HandSpec) -> None:
        self._fingers = {finger.name: finger for finger in spec.fingers}
        self._hand = hand_kinematics(spec)

    def tip(self, finger: str, position: Vector) -> Vector:
        """The tip's centre in a posture, (n,), rad: (3,), m, palm frame."""
        joints = list(self._fingers[finger].joints)
        return np.asarray(self._hand.finger(finger, position).fk(position[joints]).position)

    def drag(self, finger: str, point: Vector, near: Vector) -> DraggedTip:
        """Move a tip to a point, (3,), m, palm frame, by the posture nearest to `near`, (n,), rad."""
        joints, solver = list(self._fingers[finger].joints), self._hand.finger(finger, near)
        held = np.clip(near[joints], solver.lower, solver.upper)
        best = solver.ik(point, near=held).best(held)
        if best.reached:
            inside = np.clip(best.posture, solver.lower, solver.upper)
            return DraggedTip(dict(zip(joints, inside.tolist(), strict=True)), point, 0.0)
        return DraggedTip(None, np.asarray(solver.fk(best.posture).position), float(best.distance))
