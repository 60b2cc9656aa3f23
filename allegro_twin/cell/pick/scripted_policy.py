"""A script for `ArmPick`: to where the approach begins, to the thing, close, squeeze, lift; by what was seen first."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.motion.empty_grasp import squeeze_speed
from allegro_twin.cell.pick.env import ArmPick, Floats
from allegro_twin.cell.pick.episode import posture_at
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Vector

_SPEED = 0.25  # m/s.
_NEAR = (0.006, 0.06)  # m and rad, as in the cell.
_HELD = 0.2  # s. After the squeeze.
_UP = 0.15  # m.


class ScriptedPick:
    """Scripted policy of one episode; made after its reset, and asked before every step."""

    def __init__(self, env: ArmPick) -> None:
        self._now, self._settings = env.episodes, env.settings
        way = self._now.candidate
        self._left = [way.before, way.palm]
        self._closed, self._rest = 0.0, _HELD

    def __call__(self) -> Floats:
        """The next action."""
        palm = self._now.scene.palm
        if self._left and _there(palm, self._left[0]):
            self._left.pop(0)
        way = self._now.candidate
        if self._left:
            return self._action(self._left[0], 0.0)
        if self._closed < 2.0:
            self._closed = min(self._closed + self._pace(), 2.0)
        elif self._rest > 0.0:
            self._rest -= self._now.seconds
        if self._rest > 0.0:
            return self._action(way.palm, self._closed)
        return self._action(Pose(way.palm.position + np.array([0.0, 0.0, _UP]), way.palm.rotation), self._closed)

    def _pace(self) -> float:
        grasp = self._now.grasp
        if self._closed < 1.0:
            speed, far = grasp.speed, grasp.close - grasp.preshape
        else:
            speed, far = squeeze_speed(grasp), grasp.squeeze - grasp.close
        most = self._settings.close if self._settings.control == "grasp" else np.inf
        return min(self._now.seconds * speed / max(float(np.abs(far).max()), 1e-6), most)

    def _action(self, palm: Pose, closed: float) -> Floats:
        settings, scene = self._settings, self._now.scene
        aim = scene.aim
        way = palm.position - aim.position
        far = float(np.linalg.norm(way))
        step = way * min(1.0, _SPEED * self._now.seconds / max(far, 1e-9))
        twist = rotation_between(aim.rotation, palm.rotation)
        if settings.control == "grasp":
            fingers: Vector = np.array([(closed - self._now.closed) / settings.close])
        else:
            fingers = (posture_at(self._now.grasp, closed) - scene.path.goal) / settings.turn
        action = np.concatenate([step / settings.step, twist / settings.turn, fingers])
        return np.asarray(np.clip(action, -1.0, 1.0), np.float32)


def _there(palm: Pose, goal: Pose) -> bool:
    off, wide = (
        np.linalg.norm(palm.position - goal.position),
        np.linalg.norm(rotation_between(palm.rotation, goal.rotation)),
    )
    return bool(off < _NEAR[0] and wide < _NEAR[1])
