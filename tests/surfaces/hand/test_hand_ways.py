"""Every move between postures arrives, or is refused by name before anything moves; none pushes on and on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig
from allegro_twin.control.demonstration import TaughtMotion
from allegro_twin.control.trajectory import Waypoint
from allegro_twin.errors import MotionStalled, SelfCollision
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import grasp_names, load_posture, posture_names
from allegro_twin.sim.contact import collision_free_paths
from allegro_twin.sim.contact.collision_free_paths import CollisionFreePaths
from allegro_twin.spec import Side
from allegro_twin.surfaces.cli.start.keys import play, press
from allegro_twin.surfaces.hand import Hand
from allegro_twin.types import Sample, TorqueCommand, Vector
from tests.conftest import can_config
from tests.patience import wait_for

ARRIVED, CLIPPED = 0.03, 1.0  # rad; s that a joint may be given 99 % of its clip without a break.
JAMMED = [
    ("count_1", "fist"), ("count_2", "count_1"), ("count_2", "fist"), ("count_3", "count_1"), ("count_3", "fist"),
    ("fist", "count_2"), ("fist", "count_3"), ("fist", "rock"), ("ok", "fist"), ("paper", "fist"), ("point", "fist"),
    ("rock", "fist"), ("scissors", "count_1"), ("scissors", "fist"),
]  # fmt: skip
"""The moves on which fingers ran into each other in a straight line of the joints, and stayed there."""
QUICK = [("count_2", "count_1"), ("fist", "count_3"), ("fist", "rock"), ("ok", "fist"), ("scissors", "fist")]
"""What is tried of them before each push: to all postures that they lead to but one; the long run tries all moves."""


def config(side: str = "right", posture: str | None = None) -> RunConfig:
    return RunConfig.model_validate(
        {"hand": {"side": side}, "backend": {"kind": "sim", "start": posture}, "controller": {"kind": "pid"}}
    )


class Clip:
    """How long any joint was given 99 % of its clip without a break, s."""

    def __init__(self, hand: Hand) -> None:
        self._limit, self._period = 0.99 * hand.spec.actuation.torque_limit, 0.003
        self._run = self.longest = np.zeros(hand.spec.n_joints)

    def __call__(self, sample: Sample) -> None:
        assert isinstance(sample.command, TorqueCommand)
        self._run = np.where(np.abs(sample.command.torque) >= self._limit, self._run + self._period, 0.0)
        self.longest = np.maximum(self.longest, self._run)


def missed(hand: Hand, posture: str, speed: float = 1.0) -> str:
    """What a move misses of the bar, or nothing: there within 0.03 rad, and no joint at its clip for a second, also in
    the 1.2 s after that."""
    clip = Clip(hand)
    with hand.listening(clip):
        hand.move_to(posture, speed)
        hand.wait(1.2)
    off = np.abs(hand.state.position - load_posture(posture, hand.spec))
    if not off.max() < ARRIVED:
        return f"{posture}: {hand.spec.aliases[int(off.argmax())]} is {off.max():.3f} rad off"
    longest = clip.longest.max()
    return "" if longest <= CLIPPED else f"{posture}: a joint was at its clip for {longest:.2f} s"


@pytest.mark.parametrize(("start", "goal"), QUICK)
def test_moves_on_which_fingers_used_to_meet_arrive(start: str, goal: str) -> None:
    with Hand.open(config(posture=start)) as hand:
        hand.move_to(start, 3.0)
        assert not missed(hand, goal)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("keys", "side"),
    [
        ("g1", "right"),
        ("e2", "left"),
        *(pytest.param(*row, marks=pytest.mark.long) for row in (("k1", "left"), ("p1", "right"))),
    ],
)
def test_from_a_grasp_at_the_keyboard_the_hand_gets_to_every_posture(keys: str, side: str) -> None:
    with Hand.open(config(side)) as hand:
        press(hand, keys[0])
        hand.wait()
        clip = Clip(hand)
        with hand.listening(clip):
            posture = press(hand, keys[1])
            hand.wait()
            hand.wait(1.2)
        assert posture is not None
        assert np.abs(hand.state.position - load_posture(posture, hand.spec)).max() < ARRIVED
        assert clip.longest.max() <= CLIPPED


@pytest.mark.long
@pytest.mark.parametrize("start", posture_names())
def test_every_move_between_two_postures_arrives(start: str, side: Side) -> None:
    for goal in posture_names():
        if goal != start:
            with Hand.open(config(side, start)) as hand:
                hand.move_to(start, 3.0)
                assert not missed(hand, goal)


@pytest.mark.long
@pytest.mark.parametrize("grasp", grasp_names())
def test_every_move_from_a_grasp_to_a_posture_arrives_and_so_does_the_way_back(grasp: str, side: Side) -> None:
    with Hand.open(config(side)) as hand:
        for goal in posture_names():
            hand.grasp(grasp)
            assert not missed(hand, goal)


@pytest.mark.long
@pytest.mark.parametrize("speed", [0.3, 3.0])
def test_slow_and_fast_moves_arrive_as_well(speed: float, side: Side) -> None:
    with Hand.open(config(side)) as hand:
        for start, goal in JAMMED:
            assert not missed(hand, start, speed)
            assert not missed(hand, goal, speed)


def test_on_a_bus_fingers_go_round_each_other_too() -> None:
    with Hand.open(can_config("v4")) as hand:
        hand.move_to("fist", 4.0)
        assert not missed(hand, "rock", 4.0)


def test_in_the_background_a_wish_in_the_middle_of_a_motion_is_planned_from_where_the_hand_stops() -> None:
    with Hand.open(config(posture="fist"), background=True) as hand:
        hand.move_to("fist")
        hand.move_to("open", 4.0, wait=False)
        begun = hand.state.t
        wait_for(lambda: hand.state.t > begun + 0.15, "the hand's time")
        hand.move_to("rock", 4.0)
        assert np.abs(hand.state.position - load_posture("rock", hand.spec)).max() < ARRIVED


def test_a_posture_in_which_fingers_are_inside_each_other_is_refused_by_name_and_nothing_moves(side: Side) -> None:
    with Hand.open(config(side)) as hand:
        fist = load_posture("fist", hand.spec).copy()
        fist[14] += 0.3  # The thumb bent further, into the middle finger.
        with pytest.raises(SelfCollision, match=r"the posture: middle and thumb would be 18\.\d mm inside each other"):
            hand.move_to(fist)
        assert (hand.controller, hand.state.t) == ("torque", 0.0)


def test_where_no_way_is_found_the_fingers_that_meet_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collision_free_paths, "plan_path", lambda space, start, goal: None)
    with Hand.open(config(posture="fist")) as hand:
        with pytest.raises(SelfCollision, match="rock: found no way from here on which index and thumb keep clear; go"):
            hand.move_to("rock")
        assert hand.controller == "torque"


def test_a_detour_stops_between_its_legs_and_no_leg_is_faster_than_is_wise() -> None:
    spec = load_spec()
    start, goal = (load_posture(name, spec) for name in ("fist", "rock"))
    for speed, peak in ((0.5, 0.5), (9.0, 1.5)):
        legs = CollisionFreePaths(spec).legs(start, Waypoint(goal, speed=speed), (spec.lower, spec.upper), "rock")
        assert len(legs) > 1
        rows = [start, *(leg.posture for leg in legs)]
        for (a, b), leg in zip(pairwise(rows), legs, strict=True):
            assert leg.seconds is not None
            assert leg.seconds == pytest.approx(max(np.abs(b - a).max() * 15 / 8 / peak, 0.15))


def test_a_straight_move_is_as_fast_as_asked_where_the_fingers_are_far_from_each_other() -> None:
    spec = load_spec()
    start = load_posture("open", spec)
    for name, speed in (("paper", 9.0), ("ok", 1.5)):  # On the way to `ok` two of them come to touch.
        (leg,) = CollisionFreePaths(spec).legs(
            start, Waypoint(load_posture(name, spec), speed=9.0), (spec.lower, spec.upper), name
        )
        assert (leg.seconds, leg.speed) == (None, speed), name


def test_a_hand_that_is_asked_to_stay_stays() -> None:
    """Also where its fingers lean on each other."""
    with Hand.open(config(posture="fist")) as hand:
        hand.move_to("fist")
        before = hand.state.t
        hand.move_to("fist")
        assert hand.state.t - before < 0.1


def straight_into_a_jam(hand: Hand) -> TaughtMotion:
    """From the fist to rock in a straight line of the joints, which the planner would not take."""
    rows = np.array([load_posture(name, hand.spec) for name in ("fist", "rock")])
    return TaughtMotion(np.array([0.0, 1.5]), rows, "jam")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sim", "v4"])
def test_a_motion_that_is_stopped_says_by_what_and_gives_up_its_torque(kind: str) -> None:
    with Hand.open(config() if kind == "sim" else can_config("v4")) as hand:
        clip, sent = Clip(hand), list[Vector]()
        hand.listen(lambda sample: sent.append(sample.command.torque))  # type: ignore[union-attr]  # A torque hand.
        with (
            hand.listening(clip),
            pytest.raises(MotionStalled, match=r"^jam stalled: \w+_\d 0\.\d+ rad.* short; .*thumb.* touch\. The hand"),
        ):
            hand.play(straight_into_a_jam(hand))
        assert clip.longest.max() <= CLIPPED
        assert hand.stalled is not None
        hand.wait(0.5)  # It is told once.
        assert (np.abs(sent[-1]) < 0.5 * hand.spec.actuation.torque_limit).all()
        assert hand.controller == "pid"
        assert not missed(hand, "rock")
        assert hand.stalled is None


def test_a_stall_that_nobody_waits_for_is_told_to_who_waits_next() -> None:
    with Hand.open(config()) as hand:
        hand.play(straight_into_a_jam(hand), wait=False)
        hand.wait(0.3)
        with pytest.raises(MotionStalled, match="jam stalled"):
            hand.wait(3.0)
        hand.wait(0.1)


def test_what_stops_a_finger_without_touching_the_hand_is_something_in_the_way() -> None:
    with Hand.open(config()) as hand:
        hand.move_to("open", 3.0)
        assert hand.sim is not None
        hand.sim.push(np.where(np.arange(16) == 2, -0.6, 0.0))
        with pytest.raises(MotionStalled, match=r"home stalled: index_2 \d\.\d\d rad short; something is in the way"):
            hand.move_to("home")


def test_a_grasp_presses_for_as_long_as_it_likes_and_its_approach_does_not() -> None:
    with Hand.open(config()) as hand:
        hand.grasp("tip_pinch")
        hand.wait(3.0)
        assert hand.stalled is None
        hand.move_to("open", 3.0)
        assert hand.sim is not None
        hand.sim.push(np.where(np.arange(16) == 1, -0.9, 0.0))
        with pytest.raises(MotionStalled, match="grasp tip_pinch stalled: index_1"):
            hand.grasp("tip_pinch")


def test_a_fingertip_that_would_end_in_another_finger_is_refused_by_name(side: Side) -> None:
    with Hand.open(config(side)) as hand:
        hand.move_to("ok", 3.0)
        before, tips = hand.state.t, hand.fingertips()
        with pytest.raises(SelfCollision, match=r"fingertip of index: index and thumb would be 24\.0 mm inside each"):
            hand.move_fingertips({"index": tips["thumb"].position})
        assert hand.state.t == before


def test_a_line_through_another_finger_is_refused_by_name_and_one_that_ends_a_touch_is_not(side: Side) -> None:
    spec = load_spec(side=side)
    touching, rock = (load_posture(name, spec) for name in ("ok", "rock"))
    with pytest.raises(SelfCollision, match="the line: index and thumb meet on the straight line there; go round"):
        CollisionFreePaths(spec).check_line(np.linspace(load_posture("fist", spec), rock, 100), "the line")
    CollisionFreePaths(spec).check_line(np.linspace(touching, load_posture("open", spec), 100), "the line")


class Scripted:
    """A keyboard at which time passes while nobody presses a key."""

    def __init__(self, hand: Hand, keys: str) -> None:
        self._hand, self._keys = hand, list(keys)

    def isatty(self) -> bool:
        return False

    def read(self, count: int) -> str:
        key = self._keys.pop(0) if self._keys else ""
        if key == " ":
            end = self._hand.state.t + 1.0
            self._hand._mover.driver.wait(lambda sample: sample.state.t >= end)
        return key


def test_at_the_keyboard_a_motion_that_is_stopped_is_shown_at_once() -> None:
    shown: list[str] = []
    with Hand.open(config()) as hand:
        hand.play(straight_into_a_jam(hand), wait=False)
        play(hand, Scripted(hand, "    q"), shown.append)  # type: ignore[arg-type]  # As much of one as is used.
    assert [line for line in shown if "jam stalled: " in line] == shown[1:]
    assert len(shown) == 2  # The other is the help.
