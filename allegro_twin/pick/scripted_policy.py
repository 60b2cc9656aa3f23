"""A script for `ArmPick`: to where the approach begins, to the thing, close, squeeze, lift; by what was seen first.

How far it is, the script reads off the state. So it has an action for every state, whoever led there: a teacher for
imitation, too.
"""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.motion.empty_grasp import squeeze_speed
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.pick.env import ArmPick, Floats
from allegro_twin.pick.episode import closed_at, posture_at
from allegro_twin.types import Vector

# All ours, set on 30 episodes of each control.
_SPEED = 0.25  # m/s.
_NEAR = (0.009, 0.08)
"""m and rad from the palm's pose in the grasp, within which it closes."""
_CLOSING, _SQUEEZED = 0.3, 1.98
"""How far a grasp is closed that goes on being closed wherever the palm is, and one that is lifted."""
_ASIDE, _LAST = 0.012, 0.02
"""m beside the straight approach from which the palm goes back to it first, but for the last part, m."""
_UP = 0.15  # m.


class ScriptedPick:
    """Scripted policy of the episode that is going on; asked before every step."""

    def __init__(self, env: ArmPick) -> None:
        self._now, self._settings = env.episodes, env.settings

    def __call__(self) -> Floats:
        """The next action."""
        now, way = self._now, self._now.candidate
        grasped = self._settings.control == "grasp"
        closed = now.closed if grasped else closed_at(now.grasp, now.scene.path.goal)
        if closed >= _SQUEEZED:
            return self._action(Pose(way.palm.position + np.array([0.0, 0.0, _UP]), way.palm.rotation), 2.0)
        if closed > _CLOSING or _there(now.scene.palm, way.palm):
            return self._action(way.palm, min(closed + self._pace(closed), 2.0))
        return self._action(Pose(self._approach(), way.palm.rotation), 0.0)

    def _approach(self) -> Vector:
        """Where the palm goes to reach the thing, (3,), m: by the straight line from where the approach begins."""
        way = self._now.candidate
        line = way.palm.position - way.before.position
        length = float(np.linalg.norm(line))
        from_begin = self._now.scene.palm.position - way.before.position
        along = float(np.clip(from_begin @ line / max(length, 1e-9), 0.0, length))
        foot = way.before.position + along / max(length, 1e-9) * line
        aside = float(np.linalg.norm(self._now.scene.palm.position - foot))
        return foot if aside > _ASIDE and along < length - _LAST else way.palm.position

    def _pace(self, closed: float) -> float:
        """By how much the grasp closes in an action."""
        grasp = self._now.grasp
        if closed < 1.0:
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
