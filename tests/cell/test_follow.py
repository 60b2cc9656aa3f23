"""A cell that is led from outside goes where it is led, no faster than it may, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.assembly import Room
from allegro_twin.cell.journal.observers import Onlookers
from allegro_twin.cell.remote.remote_control import Fingers, Led, Palm, Stay, Wish, follow
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.pose import Pose
from allegro_twin.recording.events import DeviceSample, SessionEvent
from allegro_twin.types import Array, Vector
from tests.cell.test_run import room_of


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
def room() -> Iterator[Room]:
    found = room_of()
    yield found
    found.close()


def led(room: Room, wishes: Mapping[float, Wish], seconds: float) -> Seen:
    """What is seen of a cell of which something is wished at times, s."""
    seen, who, waiting = Seen(), Led(room), dict(wishes)

    def until(t: float) -> bool:
        for at in [at for at in waiting if at <= t]:
            who.wish(waiting.pop(at))
        return t >= seconds

    follow(who, Onlookers(room, [seen]), until, speed=None)
    return seen


def palm_at(room: Room, *place: float) -> Palm:
    return Palm(Pose(np.array(place), room.security.rotation))


def test_the_palm_goes_where_it_is_led_in_a_bounded_step(room: Room) -> None:
    seen = led(room, {0.1: palm_at(room, -0.12, 0.1, 0.36)}, 3.0)
    assert seen.said == []
    np.testing.assert_allclose(seen.tool[-1][:3], [-0.12, 0.1, 0.36], atol=5e-3)
    steps = np.linalg.norm(np.diff([tool[:3] for tool in seen.tool], axis=0), axis=1)
    assert steps.max() < 1.3 * room.settings.arm.speed * room.settings.arm.period


def test_a_palm_that_is_only_turned_turns_about_itself(room: Room) -> None:
    here = room.security
    wish = Palm(Pose(here.position, rotate(here.rotation, np.array([0.0, 0.9, 0.0]))))
    seen = led(room, {0.1: wish}, 2.5)
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
    room: Room, place: tuple[float, float, float], said: str
) -> None:
    import re

    seen = led(room, {0.1: palm_at(room, *place)}, 0.6)
    assert len(seen.said) == 1
    assert re.search(said, seen.said[0]), seen.said
    np.testing.assert_allclose(seen.tool[-1], seen.tool[0], atol=2e-3)


def test_of_several_places_at_once_only_the_last_counts(room: Room) -> None:
    who = Led(room)
    who.wish(palm_at(room, 0.0, 0.0, 9.0))
    who.wish(palm_at(room, -0.2, 0.05, 0.4))
    room.arm.reset()
    assert who.turn(room.arm.read()) == []
    who.wish(palm_at(room, 0.0, 0.0, 9.0))
    assert len(who.turn(room.arm.read())) == 1


def test_fingers_go_through_their_postures_and_stay_when_told(room: Room) -> None:
    goal = room.open + 0.25
    seen = led(room, {0.1: Fingers(np.array([0.8]), goal[None])}, 1.5)
    assert seen.said == []
    assert np.abs(seen.fingers[-1] - goal).max() < 0.08


def test_stay_ends_a_motion_where_it_is(room: Room) -> None:
    seen = led(room, {0.0: palm_at(room, -0.1, 0.2, 0.4), 0.5: Stay()}, 1.5)
    assert np.linalg.norm(seen.tool[-1][:3] - [-0.1, 0.2, 0.4]) > 0.05
    moved = np.linalg.norm(np.diff([tool[:3] for tool in seen.tool[-50:]], axis=0), axis=1)
    assert moved.max() < 1e-4


def changed(room: Room, **joints: float) -> Array:
    posture = room.open.copy()
    for name, value in joints.items():
        posture[room.hand.spec.joint(name)] = value
    return posture


def darting(room: Room) -> tuple[Array, Array]:
    """Slow but for 4 ms between two ticks of the check."""
    return np.array([0.5, 0.504, 1.0]), room.open + np.array([[0.0], [0.1], [0.1]])


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        (lambda room: Fingers(np.array([0.005]), room.open[None] + 0.1), "is where the guard stops: slow down"),
        (lambda room: Fingers(*darting(room)), "is where the guard stops: slow down"),
        (lambda room: Fingers(*darting(room), np.zeros((3, 16))), "is where the guard stops: slow down"),
        (lambda room: Fingers(np.array([1.0, 0.5]), np.tile(room.open, (2, 1))), "times must ascend from above 0 s"),
        (lambda room: Fingers(np.array([1.0]), changed(room, index_3=3.0)[None]), "outside its limits"),
    ],
)
def test_fingers_that_cannot_are_refused(room: Room, wish: Callable[[Room], Any], said: str) -> None:
    seen = led(room, {0.05: wish(room)}, 0.2)
    assert len(seen.said) == 1
    assert said in seen.said[0]


def test_fingers_that_would_meet_the_table_are_refused(room: Room) -> None:
    straight = np.clip(np.zeros(16), room.hand.spec.lower, room.hand.spec.upper)
    long = max(float(tip.position[2]) for tip in room.model.fingertips(straight).values())  # The palm's z points down.
    bent = Fingers(np.array([0.6]), changed(room, index_1=1.4, middle_1=1.4, ring_1=1.4)[None])
    low = palm_at(room, -0.2, 0.0, long - 0.01)
    seen = led(room, {0.0: bent, 0.8: low, 2.6: Fingers(np.array([0.5]), straight[None])}, 2.8)
    assert seen.tool[-1][2] < long
    assert len(seen.said) == 1
    assert "the table" in seen.said[0]
    assert seen.said[0].startswith("fingers: ")
