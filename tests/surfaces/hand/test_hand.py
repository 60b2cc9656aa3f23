"""The facade does what a person at a prompt expects, in the foreground and in the background."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.errors import ConfigError, EndOfRecording, HandFault, LinkTimeout
from allegro_twin.files.first_error import message_of
from allegro_twin.hands.description.calibration import Version
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp, load_posture, load_trajectory
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import angle_between
from allegro_twin.sim.engine.hand_guiding import HandGuide
from allegro_twin.spec import Side
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.grasps import aperture, for_width
from allegro_twin.surfaces.hand.motion import Kind
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import HandState, Sample, Vector
from tests.conftest import can_config
from tests.patience import wait_for


def config(side: str = "right", **blocks: object) -> RunConfig:
    return RunConfig.model_validate(
        {"hand": {"side": side}, "backend": {"kind": "sim"}, "controller": {"kind": "pid"}} | blocks
    )


OTHERS: tuple[Version, ...] = ("v2", "v3", "v5")


@pytest.fixture(params=["sim", "v4", *(pytest.param(version, marks=pytest.mark.long) for version in OTHERS)])
def hand(request: pytest.FixtureRequest) -> Iterator[Hand]:
    """In simulation, and the same hand at the other end of a bus."""
    with Hand.open(config() if request.param == "sim" else can_config(request.param)) as opened:
        yield opened


def test_it_opens_limp_and_lets_no_time_pass(hand: Hand) -> None:
    assert hand.controller == "torque"
    assert hand.controllers == ("torque", "gravity", "pd", "pid")
    assert hand.state.t == 0.0
    time.sleep(0.02)
    assert hand.state.t == 0.0


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_posture_is_reached_by_name_on_either_hand(side: str) -> None:
    with Hand.open(config(side)) as hand:
        hand.move_to("home")
        np.testing.assert_allclose(hand.state.position, load_posture("home", hand.spec), atol=0.02)
        assert np.abs(hand.errors).max() < 0.02


@pytest.mark.parametrize("kind", ["torque", "gravity"])
def test_a_move_from_torque_or_gravity_compensation_changes_to_pid(hand: Hand, kind: Kind) -> None:
    hand.set_controller(kind)
    hand.move_to("open")
    kinds: list[str] = [hand.controller]
    hand.set_controller("pd")
    hand.move_to("home")
    assert [*kinds, hand.controller] == ["pid", "pd"]


def test_it_moves_at_the_speed_that_was_asked_for(hand: Hand) -> None:
    hand.move_to("open")
    seen: list[tuple[float, Vector]] = []
    hand.listen(lambda sample: seen.append((sample.state.t, sample.state.position)))
    hand.move_to("home", speed=0.5)
    t, position = (np.array(column) for column in zip(*seen, strict=True))
    # Over 30 ms, in which v5's coarse encoder has more than one count to tell.
    speed = np.abs(position[10:] - position[:-10]).max(axis=1) / (t[10:] - t[:-10])
    assert speed.max() == pytest.approx(0.5, rel=0.15)


def late(kind: Kind, *, fed: bool) -> float:
    """How far joints of the first finger are from where they should be on the way to a posture, rms, rad."""
    errors = list[float]()
    with Hand.open(config(controller={"kind": "pid", "inverse_dynamics": fed})) as hand:
        hand.set_controller(kind)
        with hand.listening(lambda _: errors.append(float(np.square(hand.errors[:4]).mean()))):
            hand.move_to("ok", 2.0)
    return float(np.sqrt(np.mean(errors)))


@pytest.mark.parametrize("kind", ["pd", "pid"])
def test_motions_of_a_config_with_inverse_dynamics_are_followed_closer(kind: Kind) -> None:
    assert late(kind, fed=True) < late(kind, fed=False) / 5.0


def test_in_the_foreground_a_script_repeats_itself_bit_for_bit() -> None:
    def script() -> HandState:
        with Hand.open(config()) as hand:
            hand.move_to("home", 2.0)
            hand.set_controller("gravity")
            hand.wait(0.2)
            hand.move_to("rock", 2.0)
            return hand.state

    first, second = script(), script()
    assert first.t == second.t
    np.testing.assert_array_equal(first.position, second.position)


def test_changing_the_controller_never_jumps_the_torque(hand: Hand) -> None:
    sent: list[Vector] = []
    hand.listen(lambda sample: sent.append(sample.command.torque))  # type: ignore[union-attr]  # A torque hand.
    hand.move_to("home", 2.0)
    limit = hand.spec.actuation.torque_limit
    kinds: list[Kind] = ["gravity", "pd", "torque", "pid", "gravity"]
    for kind in kinds:
        before = len(sent)
        hand.set_controller(kind)
        hand.wait(0.3)
        assert (np.abs(sent[before] - sent[before - 1]) <= 0.05 * limit).all(), kind


def test_without_gravity_from_the_hand_it_must_be_given_and_may_be_replaced(hand: Hand) -> None:
    np.testing.assert_allclose(hand.gravity, [0, 0, -9.81], atol=1e-9)
    hand.gravity = [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(hand.gravity, np.zeros(3))
    hand.gravity = None
    np.testing.assert_allclose(hand.gravity, [0, 0, -9.81], atol=1e-9)
    for bad in ([1.0, 2.0], [0.0, np.nan, 0.0]):
        with pytest.raises(ConfigError, match="gravity needs three finite numbers"):
            hand.gravity = bad
    with pytest.raises(ConfigError, match=r"is 98 m/s² strong, and on no planet it is more than 30 .*give it in m/s²"):
        hand.gravity = [0, 0, -98]


def test_the_gravity_of_a_configs_controller_counts_from_the_beginning() -> None:
    config = load_config("sim_right").changed(controller={"kind": "pid", "gravity": [0.0, 9.81, 0.0]})
    with Hand.open(config) as opened:
        np.testing.assert_array_equal(opened.gravity, [0.0, 9.81, 0.0])
        opened.gravity = None
        np.testing.assert_allclose(opened.gravity, [0, 0, -9.81], atol=1e-9)


def test_a_gravity_that_is_set_while_compensating_takes_effect_at_once(hand: Hand) -> None:
    hand.move_to("open")
    hand.set_controller("gravity")
    hand.wait(0.5)
    still = hand.state.position
    hand.gravity = [9.81, 0.0, 0.0]
    hand.wait(0.8)
    assert np.abs(hand.state.position - still).max() > 0.05


@pytest.mark.parametrize(
    ("posture", "message"),
    [
        ("hom", "no posture named 'hom'; did you mean 'home'"),
        (np.zeros(15), "one value or 16"),
        (np.full(16, 0.6), r"index_0 = 0\.6000 rad is 0\.1300 rad outside its limits"),
    ],
)
def test_a_bad_posture_is_refused_before_anything_moves(hand: Hand, posture: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        hand.move_to(posture)  # type: ignore[arg-type]  # That is the point.
    assert (hand.controller, hand.state.t) == ("torque", 0.0)
    with pytest.raises(ConfigError, match="speed must be positive"):
        hand.move_to("home", speed=-1.0)
    assert hand.controller == "torque"


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        (
            lambda hand: hand.move_to("home", profile="cubic"),
            "no profile named 'cubic'; there are: linear, minimum_jerk",
        ),
        (lambda hand: hand.move_to("home", speed="fast"), "speed, in rad/s, is a number; not 'fast'"),
        (lambda hand: hand.move_to("home", speed=10**400), "speed, in rad/s, is a number; not 1000"),
        (lambda hand: hand.move_to("home", speed=None), "speed, in rad/s, is a number; not None"),
        (lambda hand: hand.move_fingertips({}, speed="fast"), "speed, in m/s, is a number; not 'fast'"),
        (lambda hand: hand.play("ripple", speed="fast"), "speed is a number; not 'fast'"),
        (lambda hand: hand.direct.steer(hand.state.position, speed="fast"), "speed, in rad/s, is a number"),
        (lambda hand: hand.wait("long"), "a time to wait is a number; not 'long'"),
    ],
)
def test_a_speed_or_a_profile_that_is_none_is_refused_in_a_line(wish: Callable[[Any], object], message: str) -> None:
    with Hand.open(config()) as hand:
        with pytest.raises(ConfigError, match=message):
            wish(hand)
        assert hand.state.t == 0.0


def test_a_margin_keeps_away_from_the_limits_and_can_be_turned_off(hand: Hand) -> None:
    lower, upper = hand.limits
    hand.set_margin(0.1)
    np.testing.assert_allclose(hand.limits[0], lower + 0.1)
    with pytest.raises(ConfigError, match=r"index_1 = -0\.1745 rad is 0\.0785 rad inside the margin"):
        hand.move_to("home")
    hand.use_margin = False
    hand.move_to("home", 3.0)
    hand.set_margin(percent=10)
    np.testing.assert_allclose(hand.limits[1], upper - 0.1 * (upper - lower))
    hand.set_margin(per_joint=np.linspace(0, 0.1, 16))
    np.testing.assert_allclose(hand.limits[0] - lower, np.linspace(0, 0.1, 16))
    for bad in ({"general": 1.0}, {"general": -0.1}, {}, {"general": 0.1, "percent": 5}):
        with pytest.raises(ConfigError, match=r"margin|set_margin takes one"):
            hand.set_margin(**bad)


def test_what_a_person_shows_is_repeated_within_a_fiftieth_of_a_radian(
    hand: Hand, request: pytest.FixtureRequest
) -> None:
    # rad and s; v5 has counts of 0.0015 rad, and speeds so noisy that stillness is hard to see.
    bound, trimmed = (0.04, 0.5) if "v5" in request.node.name else (0.02, 0.3)
    hand.move_to("open", 2.0)
    start = hand.state.position
    reach = np.clip(start + np.tile([0.1, 0.5, 0.4, 0.3], 4), *hand.limits)
    shown_path = Moves([Waypoint(reach, seconds=1.2), Waypoint(start, seconds=0.9)]).begin(start)
    began = hand.state.t + 0.4
    assert hand.sim is not None
    guide = HandGuide(hand.sim, lambda t: shown_path(max(t - began, 0.0)).position)
    shown: list[tuple[float, Vector]] = []
    with (
        hand.listening(guide),
        hand.teach() as demonstration,
        hand.listening(lambda sample: shown.append((sample.state.t, sample.state.position))),
    ):
        hand.wait(3.2)
    guide.let_go()
    motion = demonstration.motion()
    assert 4 < len(motion.times) < 60
    assert motion.times[-1] == pytest.approx(1.9, abs=trimmed)
    repeated: list[tuple[float, Vector]] = []

    def keep(sample: Sample) -> None:
        repeated.append((sample.state.t, sample.state.position))

    hand.move_to(motion.positions[0])
    with hand.listening(keep):
        hand.play(motion)
    offset = _alignment(shown, motion.positions[0])
    path = motion.path()
    for t, row in shown:
        if 0 <= t - offset <= motion.times[-1]:
            assert np.abs(path(t - offset).position - row).max() < bound
    late = repeated[-1][1]
    assert np.abs(late - motion.positions[-1]).max() < 0.02
    assert hand.controller == "pid"


def _alignment(shown: list[tuple[float, Vector]], first: Vector) -> float:
    return next(t for t, row in shown if np.array_equal(row, first))


def test_a_posture_is_taught_by_leaving_the_fingers_there(hand: Hand) -> None:
    hand.move_to("open", 2.0)
    goal = np.clip(hand.state.position + 0.3, *hand.limits)
    assert hand.sim is not None
    guide = HandGuide(hand.sim, lambda t: goal)
    with hand.teach() as demonstration:
        with hand.listening(guide):
            hand.wait(1.5)
        guide.let_go()
        hand.wait(0.3)
    np.testing.assert_allclose(demonstration.posture(), goal, atol=0.03)
    np.testing.assert_allclose(hand.state.position, demonstration.posture(), atol=0.01)


def test_a_demonstration_without_time_or_motion_says_so(hand: Hand) -> None:
    with hand.teach() as demonstration:
        pass
    with pytest.raises(ConfigError, match=r"no time has passed in the demonstration; hand\.wait"):
        demonstration.posture()
    hand.move_to("home")
    with hand.teach() as demonstration:
        hand.wait(0.3)
    with pytest.raises(ConfigError, match="no joint moved"):
        demonstration.motion()


def test_every_way_out_leaves_the_hand_limp() -> None:
    opened = Hand.open(config())
    sim = opened.sim
    assert sim is not None
    with pytest.raises(KeyboardInterrupt), opened as hand:
        hand.move_to("home", wait=False)
        hand.wait(0.3)
        assert sim.data.ctrl.any()
        raise KeyboardInterrupt
    assert not sim.data.ctrl.any()
    with pytest.raises(HandFault, match="the hand is closed"):
        _ = opened.state
    opened.close()


@pytest.mark.parametrize("background", [False, True])
def test_a_hand_that_loses_its_power_ends_the_program_with_that_and_then_with_what_it_did_not_confirm(
    background: bool,
) -> None:
    lost = r"no report from the hand for 0\.1 s .* is it powered and plugged in\?; the hand has not confirmed that"
    faults = {"script": [{"at": 0.3, "what": "power_cut"}]}
    wired = can_config("v4", timeout=0.1, faults=faults)
    with pytest.raises(LinkTimeout, match=lost), Hand.open(wired, background=background) as hand:
        hand.move_to("home")
    with pytest.raises(LinkTimeout, match=lost), Hand.open(wired, background=background) as hand:  # noqa: SIM117
        with pytest.raises(LinkTimeout, match=lost):  # Told to a program that goes on, and again when it ends.
            hand.wait(3.0)
    with pytest.raises(ZeroDivisionError) as caught, Hand.open(wired, background=background) as hand:
        with pytest.raises(LinkTimeout):
            hand.wait(3.0)
        raise ZeroDivisionError("of the program")
    assert re.match(f"of the program; {lost}", message_of(caught.value))
    with pytest.raises(LinkTimeout, match=lost), Hand.open(wired, background=background) as hand:
        with pytest.raises(LinkTimeout):
            hand.wait(3.0)
        raise KeyboardInterrupt  # Who stops a program knows that; that the hand may not be limp he does not.


def test_in_the_background_time_passes_on_its_own_and_stop_stays_there() -> None:
    with Hand.open(config(), background=True) as hand:
        first = hand.state.t
        wait_for(lambda: hand.state.t > first, "time")
        hand.move_to("home", 0.5, wait=False)
        begun = hand.state.t
        wait_for(lambda: hand.state.t > begun + 0.3, "the hand's time")
        hand.stop()
        hand.wait()
        here = hand.state.position
        time.sleep(0.2)
        np.testing.assert_allclose(hand.state.position, here, atol=0.01)
    assert not [thread for thread in threading.enumerate() if thread.name == "allegro_twin"]


def test_a_fault_in_the_background_reaches_whoever_asks_next() -> None:
    with Hand.open(config(limits={"velocity": 0.2}), background=True) as hand:
        hand.set_controller("torque", torque=0.1)
        with pytest.raises(HandFault, match=r"over its limit of 0\.20 rad/s"):
            hand.wait(3.0)
        with pytest.raises(HandFault):
            _ = hand.state


def test_it_works_on_a_recording_until_that_ends(recording_path: Path) -> None:
    replay = config(backend={"kind": "replay", "file": str(recording_path)})
    with Hand.open(replay) as hand:
        assert hand.spec.name == "allegro_right"
        assert hand.fingertips()["index"].position.shape == (3,)
        hand.wait(0.5)
        with pytest.raises(EndOfRecording):
            hand.wait(1.0)
        assert hand.sim is None


def test_the_spec_is_the_configs(hand: Hand) -> None:
    assert hand.spec.name == load_spec().name


def test_a_fingertip_goes_straight_to_a_point(hand: Hand) -> None:
    hand.move_to("home")
    start = hand.fingertips()["index"].position
    goal = start + np.array([0.015, 0.0, -0.02])
    seen: list[Vector] = []
    model = hand_kinematics(hand.spec)
    with hand.listening(lambda sample: seen.append(model.fingertips(sample.state.position)["index"].position)):
        hand.move_fingertips({"index": goal}, speed=0.05)
    np.testing.assert_allclose(hand.fingertips()["index"].position, goal, atol=1e-3)
    direction = (goal - start) / np.linalg.norm(goal - start)
    away = np.array(seen) - start
    assert np.linalg.norm(away - (away @ direction)[:, None] * direction, axis=1).max() < 2e-3


def test_a_point_out_of_reach_says_how_far_and_nothing_moves(hand: Hand) -> None:
    before = hand.state.t
    with pytest.raises(
        ConfigError, match=r"index: the tip cannot be at .* nearest point in reach is [\d.]+ mm from there"
    ):
        hand.move_fingertips({"index": [0.3, 0.0, 0.0]})
    with pytest.raises(ConfigError, match="no finger named 'pinky'"):
        hand.move_fingertips({"pinky": [0.0, 0.0, 0.1]})
    with pytest.raises(ConfigError, match="three finite numbers"):
        hand.move_fingertips({"index": [0.0, 0.1]})
    assert hand.state.t == before


def test_a_point_that_is_in_reach_behind_one_that_is_not_is_named_as_it_was_asked_for(hand: Hand) -> None:
    """Around the palm's edge: the tip can be there, but not on the way of a straight line."""
    hand.move_to("open", 3.0)
    spec = hand.spec
    joints = list(spec.finger("index").joints)
    folded = ClosedFormFinger(spec, "index").fk([0.0, *spec.upper[joints][1:]]).position
    place = r"index: \[" + ", ".join(f"{value:.4f}" for value in folded).replace(".", r"\.") + r"\] m is in reach, but"
    with pytest.raises(ConfigError, match=place + " not on a straight line from here: .* cannot go on past"):
        hand.move_fingertips({"index": folded})


@pytest.mark.parametrize("finger", ["index", "thumb"])
def test_a_fingertip_arrives_turned_as_it_was_asked_to_be(hand: Hand, finger: str) -> None:
    hand.move_to("home", 3.0)
    joints = list(hand.spec.finger(finger).joints)
    start = hand.state.position[joints]
    kinematics = ClosedFormFinger(hand.spec, finger)
    wanted = kinematics.fk(start + np.array([0.05, 0.15, -0.1, 0.2]))
    hand.move_fingertips({finger: wanted.position}, euler={finger: wanted.euler})
    now = hand.fingertips()[finger]
    np.testing.assert_allclose(now.position, wanted.position, atol=1e-3)
    assert angle_between(now.rotation, wanted.rotation) < 0.02
    hand.move_fingertips({finger: wanted.position}, euler={finger: wanted.euler})  # It is there: nothing to do.


def test_a_tip_that_stays_in_its_place_can_be_turned(hand: Hand) -> None:
    """A finger with a bent elbow has another posture for the same point."""
    hand.move_to("home", 3.0)
    kinematics = ClosedFormFinger(hand.spec, "index")
    place = hand.fingertips()["index"].position
    turned = kinematics.ik(place, pitch=float(hand.state.position[1:4].sum()) + 0.1).best()
    assert turned.reached
    hand.move_fingertips({"index": place}, euler={"index": kinematics.fk(turned.posture).euler})
    np.testing.assert_allclose(hand.state.position[:4], turned.posture, atol=0.02)


def test_an_orientation_that_a_tip_cannot_have_is_refused_with_the_nearest(hand: Hand) -> None:
    hand.move_to("home", 3.0)
    before, tip = hand.state.t, hand.fingertips()["index"]
    sideways = tip.euler + np.array([0.5, 0.0, 0.0])
    with pytest.raises(
        ConfigError, match=r"index: at .* cannot have euler .* the nearest .* is (\[.*\]), \d\.\d\d rad"
    ) as e:
        hand.move_fingertips({"index": tip.position}, euler={"index": sideways})
    assert f"euler [{', '.join(f'{angle:.4f}' for angle in sideways)}] rad" in str(e.value)
    with pytest.raises(ConfigError, match=r"cannot have euler \[0.0000, 90.0000, 0.0000\] rad; .*: 90° is 1.5708 rad$"):
        hand.move_fingertips({"index": tip.position}, euler={"index": [0, 90, 0]})
    found = re.search(r"there is \[(.*)\]", str(e.value))
    assert found is not None
    assert hand.state.t == before
    hand.move_fingertips({"index": tip.position}, euler={"index": [float(v) for v in found[1].split(",")]})
    for targets, euler, message in (
        ({"index": tip.position}, {"ring": [0, 0, 0]}, "euler is given for ring, which has no target"),
        ({"index": tip.position}, {"index": [0, 0]}, "index: euler is roll, pitch and yaw, rad; not"),
        ({"index": ["a", 0, 0]}, None, r"three finite numbers, m, palm frame; not \['a', 0, 0\]"),
    ):
        with pytest.raises(ConfigError, match=message):
            hand.move_fingertips(targets, euler=euler)  # type: ignore[arg-type]  # That is the point.


def test_a_trajectory_of_the_library_is_performed_by_name_on_either_hand(side: Side) -> None:
    with Hand.open(config(side)) as hand:
        motion = load_trajectory("ripple", hand.spec)
        seen: list[Sample] = []
        with hand.listening(seen.append):
            hand.play("ripple", speed=1.5)
        began = seen[-1].state.t - motion.seconds / 1.5 - 0.2
        away = [np.abs(s.state.position - motion.path(1.5)(s.state.t - began - 0.2).position).max() for s in seen]
        assert np.median(away[len(away) // 2 :]) < 0.05
        np.testing.assert_allclose(hand.state.position, motion.positions[-1], atol=0.02)
        with pytest.raises(ConfigError, match="no trajectory named 'rippel'; did you mean 'ripple'"):
            hand.play("rippel")


@pytest.mark.parametrize(
    "name",
    [
        "grasp_3",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("envelop", "grasp_4", "pinch_index", "pinch_middle")),
    ],
)
def test_the_manufacturers_grasps_close_on_a_hand_in_the_air(name: str, hand: Hand) -> None:
    hand.move_to("ready")
    felt = hand.grasp(name)
    assert felt.name == name
    assert hand.controller == f"grasp {name}"
    hand.move_to("home")
    assert np.abs(hand.errors).max() < 0.03


@pytest.mark.slow
def test_a_force_grasp_can_ask_the_mirror_of_a_hand_on_a_bus_what_its_fingers_touch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Mirror] = []

    def contacts(mirror: Mirror) -> tuple[str, ...]:
        asked.append(mirror)
        return ("index", "thumb")

    monkeypatch.setattr(Mirror, "contacts", property(contacts))
    with Hand.open(can_config("v4")) as hand:
        hand.move_to("ready")
        hand.grasp("pinch_index")
        assert not asked
        hand.grasp("pinch_index", by_mirror=True)
        assert asked[0] is hand.mirror
        with pytest.raises(ConfigError, match="grasp tip_pinch asks nobody what its fingers touch; a centroid grasp"):
            hand.grasp("tip_pinch", by_mirror=True)
    with Hand.open(config()) as hand, pytest.raises(ConfigError, match="a simulated hand is its own twin"):
        hand.grasp("pinch_index", by_mirror=True)


def test_a_position_grasp_closes_to_the_width_that_it_is_told(hand: Hand) -> None:
    spec = hand.spec
    model = hand_kinematics(spec)
    for width in (0.06, 0.08):
        grasp = for_width(load_grasp("sphere_4_finger", spec), width, model, spec)
        assert aperture(model, grasp.close, spec) == pytest.approx(width, abs=1.5e-3)
