"""Trajectories side by side are the trajectories that they would be alone, to the last bit."""

from __future__ import annotations

import numpy as np

from allegro_twin.control.trajectory import BatchedTrajectories, Moves, Trajectory, Waypoint
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics


def paths(rng: np.random.Generator) -> list[Trajectory]:
    """Of different lengths, profiles and numbers of legs, one of which goes nowhere."""
    made = []
    for legs in (1, 3, 2):
        start, *postures = rng.uniform(-1.0, 1.0, (legs + 1, 16))
        waypoints = [Waypoint(posture, seconds=rng.uniform(0.2, 0.9)) for posture in postures]
        waypoints.insert(1, Waypoint(postures[0], seconds=0.3))
        waypoints.append(Waypoint(start, profile="linear"))
        made.append(Moves(waypoints).begin(start))
    return made


def test_every_row_is_where_its_trajectory_is_alone_before_within_and_after() -> None:
    alone = paths(np.random.default_rng(4))
    together, rows = BatchedTrajectories(alone), np.array([2, 0, 1])
    for t in np.arange(0.0, 6.0, 0.007).tolist():
        found = together(rows, t)
        for place, row in enumerate(rows):
            point = alone[row](t)
            np.testing.assert_array_equal(found.position[place], point.position)
            np.testing.assert_array_equal(found.velocity[place], point.velocity)


def test_the_torques_of_many_postures_are_those_of_each() -> None:
    spec, rng = load_spec(), np.random.default_rng(5)
    model = hand_kinematics(spec)
    postures, down = rng.uniform(spec.lower, spec.upper, (5, 16)), rng.normal(size=(5, 3))
    each = [model.gravity_torque(posture, gravity) for posture, gravity in zip(postures, down, strict=True)]
    np.testing.assert_array_equal(model.gravity_torque(postures, down), each)
