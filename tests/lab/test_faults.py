"""What goes wrong in the running cell ends by its name: a sensor that drifts, a thing that moves, an arm at its end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.arm.faults import Disturbed
from allegro_twin.errors import ConfigError
from allegro_twin.lab.cell import Room
from allegro_twin.lab.run import perform
from allegro_twin.lab.states import Now
from tests.lab.test_run import away, room_of, states, still

QUIET = np.zeros(6)
BY_FORCE: dict[str, Any] = {"validation": {"by": "force"}, "decide": {"retries": 0}}
HEAVY = [{"name": "tomato_soup_can", "at": [0.0, 0.0]}]


def drifting(room: Room, force: tuple[float, float, float], at: float) -> Room:
    """From `at` on, s, the flange's sensor is wrong by this, N in its own axes."""
    return replace(room, arm=Disturbed(room.arm, QUIET, np.array([*force, 0.0, 0.0, 0.0]), at))


DRIFTS = [((5.0, 0.0, 0.0), 1.0), ((0.0, 0.0, -5.0), 3.5)]
"""Before each push: aside on the way there, and down with the thing in the hand."""
OTHERS = [
    (force, at)
    for force in ((5.0, 0.0, 0.0), (0.0, -5.0, 0.0), (0.0, 0.0, 5.0), (0.0, 0.0, -5.0))
    for at in (1.0, 3.5)
    if (force, at) not in DRIFTS
]


@pytest.mark.parametrize(("force", "at"), [*DRIFTS, *(pytest.param(*row, marks=pytest.mark.long) for row in OTHERS)])
def test_a_force_sensor_that_drifts_is_suspect_and_the_fingers_still_tell(
    force: tuple[float, float, float], at: float
) -> None:
    room = room_of()
    report = perform(drifting(room, force, at))
    assert report.end.word == "held"
    assert report.truly
    assert "the force sensor is suspect" in report.end.sentence


@pytest.mark.long
@pytest.mark.parametrize("force", [3.0, pytest.param(-3.0, marks=pytest.mark.long)])
def test_a_force_sensor_that_decides_and_drifts_ends_in_a_fault_with_the_thing_in_the_hand(force: float) -> None:
    room = room_of(**BY_FORCE, objects=HEAVY)
    report = perform(drifting(room, (force, 0.0, 0.0), 3.5))
    assert str(report.end) == "fault: force sensor"
    assert report.truly
    assert still(room)


def test_a_drift_that_looks_like_a_weight_is_no_thing_in_the_hand() -> None:
    room = room_of(**BY_FORCE, objects=HEAVY)
    down = np.array([0.0, 0.0, -3.4])  # What the can weighs, where a can is no more.

    def taken(now: Now) -> None:
        away(room, now, "Approach", "tomato_soup_can")
        if now.state == "ToLiftedPose":
            arm = room.cell.model.pose(room.cell.world.data.qpos[:7]).rotation
            sensor._bias[:3] = arm.T @ down

    sensor = Disturbed(room.arm, QUIET, np.zeros(6))
    report = perform(replace(room, arm=sensor), entered=taken)
    assert str(report.end) == "fault: force sensor"
    assert "where they would be around nothing" in report.end.sentence
    assert not report.truly


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_a_sensor_that_is_only_noisy_is_not_suspect(seed: int) -> None:
    """Nor is it with seed 0, in test_run.py."""
    report = perform(room_of(seed=seed))
    assert (str(report.end), report.end.sentence) == ("held", "")


@pytest.mark.parametrize(
    "way",
    [(0.05, 0.0), *(pytest.param(way, marks=pytest.mark.long) for way in ((0.0, -0.05), (-0.05, 0.0), (0.0, 0.05)))],
)
def test_a_thing_that_is_moved_on_the_way_is_looked_for_again_and_never_said_to_be_held_when_it_is_not(
    way: tuple[float, float],
) -> None:
    room = room_of()
    moves = iter([True])

    def moved(now: Now) -> None:
        if now.state == "Approach" and next(moves, False):
            room.cell.world.data.joint("apple").qpos[:2] += way

    report = perform(room, entered=moved)
    assert (report.end.word == "held") == report.truly
    assert report.end.word == "held" or report.end.reason in ("outside", "no_object")  # A ball that was hit rolls away.
    assert report.tries == 2


def test_an_empty_hand_whose_fingers_meet_is_not_said_to_hold() -> None:
    room = room_of(objects=[{"name": "pear"}], decide={"retries": 0})
    report = perform(room, entered=lambda now: away(room, now, "Approach", "pear"))
    assert str(report.end) == "missed"
    assert report.checked is not None
    assert report.checked.by_torque  # Which is why it does not decide.


def test_a_spring_that_friction_holds_is_refused_before_anything_moves() -> None:
    room = room_of(arm={"model": "fer", "stiffness": 10.0})
    before = room.cell.world.data.qpos.copy()
    with pytest.raises(ConfigError, match=r"stiffness.linear 10 N/m: dry friction would keep fer up to .* take at"):
        perform(room)
    np.testing.assert_array_equal(room.cell.world.data.qpos, before)
    assert room.cell.world.steps == 0


def test_an_arm_at_the_end_of_a_joint_is_named_and_stands_still() -> None:
    room = room_of()
    limits = replace(room.cell.limits, upper=room.posture + 0.2)
    report = perform(replace(room, cell=replace(room.cell, limits=limits)))
    assert str(report.end) == "fault: arm at a limit"
    assert states(report)[-2:] == ["ToTargetPose", "Done"]
    assert float(np.abs(room.cell.world.data.qvel[:7]).max()) < 0.1  # From 1.5 rad/s, half a second later.
