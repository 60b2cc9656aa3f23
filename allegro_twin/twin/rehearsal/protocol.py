"""Rehearsal protocol: poses, postures, a trajectory, grasps, and the duration of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.limits import alike_joints
from allegro_twin.types import frozen

REST, AVERAGED = 2.0, 0.5
"""s that a hand stays at a posture, and the last part of it in which its error is averaged."""
SWING = 0.45
"""Share of half a joint's range by which the trajectory swings about the middle."""
SIGNS = ((0, 0, 0, 0), (1, 1, -1, 1), (-1, -1, 1, -1), (1, -1, 1, 1), (-1, 1, -1, 1), (1, 1, -1, -1), (0, 0, 0, 0))
"""Where each waypoint of the trajectory has a finger's joints, from the palm outward: above or below the middle."""
APPROACH_SPEED = 1.0
"""rad/s, to the trajectory's first waypoint."""


@dataclass(frozen=True, slots=True)
class RehearsalProtocol:
    """The steps of a rehearsal. The defaults are those of the twenty hidden hands (docs/results/rehearsal.md)."""

    poses: Mapping[str, float] = field(default_factory=lambda: {"up": 16.0, "side": 16.0, "palm-up": 16.0})
    """Seconds of excitation in each pose, in this order; in the first, every joint is led to both its ends."""
    postures: tuple[str, ...] = ("ok", "fist", "point", "count_3")
    posture_poses: tuple[str, ...] = ("palm-up", "side")
    controllers: tuple[str, ...] = ("pd", "pid")
    speeds: Mapping[str, float] = field(default_factory=lambda: {"slow": 0.5, "fast": 3.0})
    """Peak speed of the trajectory, of the joint that travels furthest, rad/s, by the level's name."""
    feedforward: tuple[bool, ...] = (False, True)
    """Whether the trajectory is performed with inverse dynamics fed forward: `controller.inverse_dynamics`."""
    grasps: tuple[str, ...] = ()
    """Scenarios whose grasps are closed: in the air, or on their objects where a scene is simulated."""
    twins: tuple[str, ...] = ("nominal", "identified")
    seed: int = 0
    """Seed of the excitations."""

    def tracking_poses(self) -> tuple[str, ...]:
        """Poses in which postures are held: those that are also excited, else the last that is."""
        return tuple(pose for pose in self.posture_poses if pose in self.poses) or (list(self.poses)[-1],)


def rehearsal_trajectory(spec: HandSpec, speed: float) -> Moves:
    """Minimum-jerk moves of all joints at once about the middle of their ranges, alike fingers in parallel: to the
    middle, and then to waypoints each at a peak of `speed` rad/s of the joint that travels furthest. The nominal hand
    touches nothing on the way."""
    middle, half = (spec.lower + spec.upper) / 2.0, (spec.upper - spec.lower) / 2.0
    place = np.zeros(spec.n_joints, dtype=int)
    for finger in spec.fingers:
        place[list(finger.joints)] = range(len(finger.joints))
    for group in alike_joints(spec):
        half[group] = half[group].min()
    postures = [middle + SWING * half * np.array(signs)[place] for signs in SIGNS]
    speeds = (APPROACH_SPEED, *(speed for _ in postures[1:]))
    return Moves([Waypoint(frozen(each), speed=pace) for each, pace in zip(postures, speeds, strict=True)])
