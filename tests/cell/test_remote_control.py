"""A cell that is remote from outside goes where it is remote, no faster than it may, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.journal.observers import Observers
from allegro_twin.cell.remote.remote_control import (
    FingersCommand,
    PalmCommand,
    ReleaseCommand,
    RemoteCommand,
    RemoteControl,
    StayCommand,
    StopCommand,
    run_remote_control,
)
from allegro_twin.errors import ArmReflex
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.events import DeviceSample, SessionEvent
from allegro_twin.types import Array, Vector
from tests.cell.test_run import cell_of


class Seen:
    """An onlooker that keeps what it sees."""

    def __init__(self) -> None:
        self.tool: list[Vector] = []
        self.said: list[str] = []
        self.fingers: list[Vector] = []

    def on_event(self, event: SessionEvent) -> None:
        if not isinstance(event, DeviceSample):
            self.said += [event.row["sentence"]] if event.row.get("sentence") else []
        elif event.device == "arm":
            self.tool.append(event.extras["tool"])
        else:
            self.fingers.append(event.sample.state.position)


@pytest.fixture
def cell() -> Iterator[Cell]:
    found = cell_of()
    yield found
    found.close()


def remote(cell: Cell, commands: Mapping[float, RemoteCommand], seconds: float) -> Seen:
    """What is seen of a cell of which something is wished at times, s."""
    seen, who, waiting = Seen(), RemoteControl(cell), dict(commands)

    def until(t: float) -> bool:
        for at in [at for at in waiting if at <= t]:
            who.command(waiting.pop(at))
        return t >= seconds

    run_remote_control(who, Observers(cell, [seen]), until, speed=None)
    return seen


def palm_at(cell: Cell, *place: float) -> PalmCommand:
    return PalmCommand(Pose(np.array(place), cell.security.rotation))


@pytest.mark.slow
def test_the_palm_goes_where_it_is_led_in_a_bounded_step(cell: Cell) -> None:
    seen = remote(cell, {0.1: palm_at(cell, -0.12, 0.1, 0.36)}, 3.0)
    assert seen.said == []
    np.testing.assert_allclose(seen.tool[-1][:3], [-0.12, 0.1, 0.36], atol=5e-3)
    steps = np.linalg.norm(np.diff([tool[:3] for tool in seen.tool], axis=0), axis=1)
    assert steps.max() < 1.3 * cell.settings.arm.speed * cell.settings.arm.period


@pytest.mark.slow
def test_a_palm_that_is_only_turned_turns_about_itself(cell: Cell) -> None:
    here = cell.security
    command = PalmCommand(Pose(here.position, rotate(here.rotation, np.array([0.0, 0.9, 0.0]))))
    seen = remote(cell, {0.1: command}, 2.5)
    assert seen.said == []
    away = np.linalg.norm([tool[:3] - here.position for tool in seen.tool], axis=1)
    assert away.max() < 0.03
    turns = [abs(float(tool[3:] @ seen.tool[0][3:])) for tool in seen.tool]
    assert 2.0 * np.arccos(min(turns[-1], 1.0)) == pytest.approx(0.9, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "said"),
    [
        ((np.nan, 0.0, 0.4), r"position\[0\] is nan"),
        ((-0.1, 0.0, 0.1), r"would be (in|too near to) the table, at -?\d+ mm: nothing moves; ask for \d+ mm more"),
        ((0.0, 0.0, 0.9), r"is outside \(-0.35, -0.4, 0.03\) to \(0.3, 0.4, 0.6\) m: the arm stays"),
        ((0.28, 0.38, 0.58), r"the arm stays: fer does not reach"),
    ],
)
def test_a_place_that_cannot_be_is_refused_in_a_sentence_and_nothing_moves(
    cell: Cell, place: tuple[float, float, float], said: str
) -> None:
    import re

    seen = remote(cell, {0.1: palm_at(cell, *place)}, 0.6)
    assert len(seen.said) == 1
    assert re.search(said, seen.said[0]), seen.said
    np.testing.assert_allclose(seen.tool[-1], seen.tool[0], atol=2e-3)


def test_of_several_places_at_once_only_the_last_counts(cell: Cell) -> None:
    who = RemoteControl(cell)
    who.command(palm_at(cell, 0.0, 0.0, 9.0))
    who.command(palm_at(cell, -0.2, 0.05, 0.4))
    cell.arm.reset()
    assert who.update(cell.arm.read()) == []
    who.command(palm_at(cell, 0.0, 0.0, 9.0))
    assert len(who.update(cell.arm.read())) == 1


def test_fingers_go_through_their_postures_and_stay_when_told(cell: Cell) -> None:
    goal = cell.open + 0.25
    seen = remote(cell, {0.1: FingersCommand(np.array([0.8]), goal[None])}, 1.5)
    assert seen.said == []
    assert np.abs(seen.fingers[-1] - goal).max() < 0.08


def test_stay_ends_a_motion_where_it_is(cell: Cell) -> None:
    seen = remote(cell, {0.0: palm_at(cell, -0.1, 0.2, 0.4), 0.5: StayCommand()}, 1.5)
    assert np.linalg.norm(seen.tool[-1][:3] - [-0.1, 0.2, 0.4]) > 0.05
    moved = np.linalg.norm(np.diff([tool[:3] for tool in seen.tool[-50:]], axis=0), axis=1)
    assert moved.max() < 1e-4


def test_nothing_that_comes_after_a_stop_moves_whoever_sent_it_until_it_is_released(cell: Cell) -> None:
    """Said once: a program sends a hundred a second."""
    who, away, here = RemoteControl(cell), palm_at(cell, -0.2, 0.05, 0.4), cell.security.position
    cell.arm.reset()
    close = FingersCommand(np.array([0.8]), cell.open[None] + 0.25)
    for command in (StopCommand(), close, away, close, away, StayCommand()):
        who.command(command)
    (said,) = who.update(cell.arm.read())
    assert said == "the cell is stopped, and nothing moves it before the stop is released"
    assert who.stopped
    np.testing.assert_allclose(who.goal.position, here, atol=2e-3)
    who.command(close)
    assert who.update(cell.arm.read()) == []
    np.testing.assert_array_equal(who.fingers(1.0).position, who.fingers(0.0).position)
    who.command(away)
    assert who.update(cell.arm.read()) == []
    np.testing.assert_allclose(who.goal.position, here, atol=2e-3)
    who.command(ReleaseCommand())
    who.command(away)
    assert who.update(cell.arm.read()) == []
    assert not who.stopped
    np.testing.assert_allclose(who.goal.position, [-0.2, 0.05, 0.4])
    who.command(StopCommand())
    who.command(away)
    assert who.update(cell.arm.read()) == [said], "once a stop, and this is another one"


def test_an_arm_that_meets_something_while_it_is_stopped_does_not_back_off(cell: Cell) -> None:
    who, arm = RemoteControl(cell), cell.arm.reset()
    met = ArmReflex("fer stopped itself", "cartesian_reflex", (0.0, 0.0, 30.0, 0.0, 0.0, 0.0))
    who.command(StopCommand())
    who.update(arm)
    who.on_reflex(met, arm)
    assert who.update(arm) == [f"{met}. It is recovered and stays: it is stopped"]
    np.testing.assert_allclose(who.goal.position, cell.robot.palm(arm).position)
    who.command(ReleaseCommand())
    who.update(arm)
    who.on_reflex(met, arm)
    assert np.linalg.norm(who.goal.position - cell.robot.palm(arm).position) > 0.01


def changed(cell: Cell, **joints: float) -> Array:
    posture = cell.open.copy()
    for name, value in joints.items():
        posture[cell.hand.spec.joint(name)] = value
    return posture


def darting(cell: Cell) -> tuple[Array, Array]:
    """Slow but for 4 ms between two ticks of the check."""
    return np.array([0.5, 0.504, 1.0]), cell.open + np.array([[0.0], [0.1], [0.1]])


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (lambda cell: FingersCommand(np.array([0.005]), cell.open[None] + 0.1), "is where the guard stops: slow down"),
        (lambda cell: FingersCommand(*darting(cell)), "is where the guard stops: slow down"),
        (lambda cell: FingersCommand(*darting(cell), np.zeros((3, 16))), "is where the guard stops: slow down"),
        (
            lambda cell: FingersCommand(np.array([1.0, 0.5]), np.tile(cell.open, (2, 1))),
            "times must ascend from above 0 s",
        ),
        (lambda cell: FingersCommand(np.array([1.0]), changed(cell, index_3=3.0)[None]), "outside its limits"),
    ],
)
def test_fingers_that_cannot_are_refused(cell: Cell, command: Callable[[Cell], Any], said: str) -> None:
    seen = remote(cell, {0.05: command(cell)}, 0.2)
    assert len(seen.said) == 1
    assert said in seen.said[0]


@pytest.mark.slow
def test_fingers_that_would_meet_the_table_are_refused(cell: Cell) -> None:
    straight = np.clip(np.zeros(16), cell.hand.spec.lower, cell.hand.spec.upper)
    long = max(float(tip.position[2]) for tip in cell.model.fingertips(straight).values())  # The palm's z points down.
    bent = FingersCommand(np.array([0.6]), changed(cell, index_1=1.4, middle_1=1.4, ring_1=1.4)[None])
    low = palm_at(cell, -0.2, 0.0, long - 0.01)
    seen = remote(cell, {0.0: bent, 0.8: low, 2.6: FingersCommand(np.array([0.5]), straight[None])}, 2.8)
    assert seen.tool[-1][2] < long
    assert len(seen.said) == 1
    assert "the table" in seen.said[0]
    assert seen.said[0].startswith("fingers: ")
