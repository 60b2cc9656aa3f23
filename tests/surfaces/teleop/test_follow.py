"""A tracked hand leads a robot's: fingertips follow, and a tracker that fails moves nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.orientation import matrix_from_euler
from allegro_twin.spec import HandSpec, Side
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.teleop.session import live
from allegro_twin.surfaces.teleop.targets import FingertipTargets
from allegro_twin.types import Array, Vector
from tests.conftest import can_config
from tests.surfaces.teleop.conftest import led, sim_config
from tests.surfaces.teleop.synthetic import CLOSED, OPEN, hand, performed

RATE = 30.0


def still(seconds: float, bend: float = OPEN) -> tuple[Vector, Array]:
    times = np.arange(round(seconds * RATE)) / RATE
    return times, np.repeat(hand(bend)[None], len(times), axis=0)


def gap(at: Hand) -> float:
    """Between the tips of thumb and index finger, m."""
    tips = at.fingertips()
    return float(np.linalg.norm(tips["thumb"].position - tips["index"].position))


@pytest.mark.slow
@pytest.mark.parametrize(
    "config",
    [sim_config(), sim_config("left"), can_config("v4")],
    ids=["simulation", "left hand", "virtual hand on CAN"],
)
def test_a_file_opens_closes_and_pinches_a_hand(config: RunConfig) -> None:
    times, frames = performed(RATE)
    heights: dict[float, float] = {}
    with led(config) as it:
        for begin, end in ((0.0, 1.0), (1.0, 2.1), (2.1, 3.3), (3.3, 4.9)):
            part = (times >= begin) & (times < end)
            it.play(times[part], frames[part])
            heights[end] = float(it.hand.fingertips()["middle"].position[2])
        assert heights[1.0] > 0.12  # The longest finger is straight up,
        assert heights[2.1] < 0.07  # bent,
        assert heights[3.3] > 0.12  # and straight again;
        assert gap(it.hand) < 0.03  # and the tips, spheres of 12 mm, are together.
        assert it.follower.tally.jumps == it.follower.tally.unseen == 0


def test_fingertips_go_to_where_the_persons_are_times_the_length_of_the_fingers() -> None:
    with led(sim_config()) as it:
        it.play(*still(2.0, 0.5))
        targets = it.targets(hand(0.5))
        tips = it.hand.fingertips()
        assert it.targets.scale == pytest.approx(0.1354 / 0.101, rel=0.02)  # m, of both middle fingers.
        for name, target in zip(("index", "middle"), targets, strict=False):
            assert np.linalg.norm(tips[name].position - target) < 0.005


def test_a_straight_finger_is_a_straight_finger_however_large_the_hand_is(spec: HandSpec) -> None:
    straight = ClosedFormFinger(spec, "middle").tip(np.zeros(4))
    for size in (0.8, 1.0, 1.2):
        target = FingertipTargets(spec, "right")(size * hand(0.0))[1]
        np.testing.assert_allclose(target, straight, atol=1e-9)


def test_how_the_arm_is_turned_and_where_it_is_does_not_matter(spec: HandSpec) -> None:
    here = FingertipTargets(spec, "right")(hand(0.4))
    turned = hand(0.4) @ matrix_from_euler(np.array([0.3, -1.0, 2.0])).T + [0.3, -0.2, 1.0]
    np.testing.assert_allclose(FingertipTargets(spec, "right")(turned), here, atol=1e-12)


@pytest.mark.parametrize("tracked", ["right", "left"])
def test_either_hand_of_a_person_leads_either_of_the_robots(tracked: Side, side: Side, spec: HandSpec) -> None:
    """The left hand of each is the right one's mirror image."""
    from allegro_twin.hands.description.specs import load_spec

    shown = hand(0.4) * [1.0, 1.0 if tracked == "right" else -1.0, 1.0]
    expected = FingertipTargets(spec, "right")(hand(0.4)) * [1.0, 1.0 if side == "right" else -1.0, 1.0]
    np.testing.assert_allclose(FingertipTargets(load_spec(side=side), tracked)(shown), expected, atol=1e-12)


def test_when_frames_stop_the_hand_holds_and_says_so_once() -> None:
    times, frames = performed(RATE)
    closing = (times >= 1.0) & (times < 1.5)
    again = times >= 2.5
    with led(sim_config()) as it:
        it.play(times[closing | again] - 1.0, frames[closing | again])
        assert [line.split(": ")[1] for line in it.said] == [
            "a hand is seen, and followed",
            "no hand is followed since 0.5 s (no frame came); the hand holds",
            "a hand is seen, and followed",
        ]
        assert np.abs(it.at(1.4) - it.at(1.0)).max() < 0.03  # Held, in the second without a frame.
        assert np.abs(it.at(2.2) - it.at(1.4)).max() > 0.3  # And followed again.


def test_where_the_hand_was_going_when_frames_stopped_it_does_not_go() -> None:
    times, frames = still(0.2, CLOSED)
    with led(sim_config(), speed=0.3) as it:
        it.play(np.append(times, 3.0), np.append(frames, frames[:1] * np.nan, axis=0))
        assert np.abs(it.at(2.9) - it.at(0.8)).max() < 0.01  # It would be 0.6 rad further.


def test_a_track_begins_at_once_whatever_its_clock_says() -> None:
    times, frames = still(0.5)
    with led(sim_config()) as it:
        begin = it.hand.state.t
        it.play(times + 20.0, frames)
        assert it.hand.state.t - begin == pytest.approx(1.5, abs=0.05)  # And a second in which it arrives.


def test_frames_without_a_hand_are_not_followed() -> None:
    times, frames = still(1.0)
    frames[10:] = hand(CLOSED)
    frames[10:, 7] = np.nan
    with led(sim_config()) as it:
        it.play(times, frames)
        assert it.follower.tally.unseen == len(times) - 10
        assert "(no whole hand in the frames)" in it.said[-1]
        assert it.hand.fingertips()["middle"].position[2] > 0.12


def test_frames_of_another_clock_are_refused_for_the_hand_would_go_on_when_they_stop() -> None:
    with led(sim_config()) as it:
        it.hand.wait(0.5)
        now = it.hand.state.t
        it.follower.see(now, hand(OPEN))
        wrong = ((1.8e9, "ahead of it"), (now + 0.31, "ahead of it"), (now - 0.1, "goes back"),
                 (np.nan, "is not finite"), (np.inf, "is not finite"), (None, "is a number"))  # fmt: skip
        for t, words in wrong:
            with pytest.raises(ConfigError, match=words) as refused:
                it.follower.see(t, hand(OPEN))  # type: ignore[arg-type]  # That is what is tried.
            assert "\n" not in str(refused.value)
            assert t is None or "the hand's clock (hand.state.t, now 0.5" in str(refused.value)
        with pytest.raises(ConfigError, match="ahead of it"):
            it.follower.look(1.8e9)
        assert it.follower.tally.followed == 1
        it.follower.see(now + 0.29, hand(OPEN))
        it.hand.wait(0.7)
        it.follower.look(it.hand.state.t)
        assert "the hand holds" in it.said[-1]


def test_a_patience_that_never_ends_is_refused() -> None:
    for patience in (np.inf, np.nan, 0.0, -1.0):
        with (
            pytest.raises(ConfigError, match="patience must be positive and finite"),
            led(sim_config(), patience=patience),
        ):
            pass


def test_landmarks_of_another_shape_are_refused_in_one_line_and_lists_are_read() -> None:
    points = hand(OPEN)
    with led(sim_config()) as it:
        shapes: list[Any] = [points[:20], points[None], points.reshape(-1), points[:, :2], np.c_[points, np.ones(21)],
                             None, [], "hand", [{}], [[10**400] * 3] * 21]  # fmt: skip
        for wrong in shapes:
            with pytest.raises(ConfigError, match=r"landmarks (have shape \(21, 3\)|are 21 points)") as refused:
                it.follower.see(it.hand.state.t, wrong)
            assert "\n" not in str(refused.value)
        it.follower.see(it.hand.state.t, points.tolist())
        assert it.follower.tally.followed == 1


def test_a_tracker_in_mm_is_told_the_unit_once() -> None:
    times, frames = still(0.3)
    with led(sim_config()) as it:
        it.play(times, frames * 1000.0)
        assert it.follower.tally.unseen == len(times)
        (said,) = it.said
        assert "90 m from the wrist to the middle knuckle is no hand's: landmarks are in m" in said
        it.play(times, frames)
        it.play(times, frames * 100.0)
        assert "9 m from the wrist" in it.said[-1]
        assert "the hand holds" in it.said[-1]


@pytest.mark.slow
def test_a_frame_that_jumps_is_not_followed_and_what_stays_there_is() -> None:
    times, frames = still(3.0)
    frames[30] = hand(CLOSED)
    frames[60:] = hand(CLOSED)
    with led(sim_config(), patience=10.0) as it:
        it.play(times, frames)
        assert it.follower.tally.jumps == 3  # There, back, and there again.
        assert np.abs(it.at(1.9) - it.at(1.0)).max() < 0.01
        assert it.hand.fingertips()["middle"].position[2] < 0.09


@pytest.mark.slow
def test_no_joint_is_led_faster_than_the_speed() -> None:
    times, frames = still(3.0)
    frames[30:] = hand(CLOSED)
    with led(sim_config(), speed=0.5) as it:
        it.play(times, frames)
        moving = np.abs(np.diff([row[1] for row in it.rows[350:]], axis=0)).max() / 0.003
        assert moving < 1.0  # 0.5 rad/s, and what PID overshoots.


def test_fingers_that_would_meet_stop_before_and_the_others_go_on(spec: HandSpec) -> None:
    def into_each_other(_: Array) -> Vector:
        posture = np.zeros(spec.n_joints)
        posture[list(spec.finger("thumb").joints)] = [1.3, 1.0, 0.6, 0.6]
        posture[list(spec.finger("index").joints)] = [0.0, 1.4, 0.9, 0.6]
        posture[list(spec.finger("ring").joints)] = [0.0, 0.8, 0.5, 0.5]
        return posture

    with led(sim_config(), retarget=into_each_other) as it:
        it.play(*still(2.0))
        ring = it.hand.state.position[list(spec.finger("ring").joints)]
        np.testing.assert_allclose(ring, [0.0, 0.8, 0.5, 0.5], atol=0.05)
        assert gap(it.hand) > 0.02  # Their tips are 24 mm across, and give 2 mm each.
        assert it.hand.stalled is None


def test_what_no_finger_reaches_is_led_to_the_limits(spec: HandSpec) -> None:
    with led(sim_config(), retarget=lambda _: spec.upper + 1.0) as it:
        it.hand.set_margin(0.2)
        it.play(*still(1.5))
        assert (it.hand.state.position < spec.upper - 0.1).all()


def test_a_camera_leads_as_a_file_does_and_a_late_one_lets_the_hand_hold() -> None:
    class Camera:
        count = 0

        def ask(self, question: None) -> None:
            self.count += 1

        def ready(self, seconds: float = 0.0) -> bool:
            return self.count < 100

        def answer(self) -> Array:
            return hand(0.5)

    with led(sim_config()) as it:
        end = it.hand.state.t + 3.0
        live(it.hand, Camera(), it.follower, lambda: it.hand.state.t >= end)
        assert it.follower.tally.followed == 99
        assert "the hand holds" in it.said[-1]
        assert len(it.said) == 2


def test_the_guard_stands_between() -> None:
    slow = sim_config(limits={"velocity": 1.0})
    with pytest.raises(ConfigError, match=r"would move at 2 rad/s; 1 is where the guard stops"), led(slow):
        pass
    with led(slow, speed=1.0) as it, pytest.raises(HandFault, match="rad/s"):
        it.play(*still(2.0, CLOSED))


def test_a_hand_that_does_not_know_where_down_is_is_not_led() -> None:
    config = can_config("v3", gravity=None)
    with led(config) as it, pytest.raises(ConfigError, match="gravity"):
        it.play(*still(0.5))


def test_a_tracked_hand_that_is_neither_right_nor_left_is_refused_and_not_mirrored(spec: HandSpec) -> None:
    with pytest.raises(ConfigError, match="^side is right or left, not 'Right'$"):
        FingertipTargets(spec, "Right")  # type: ignore[arg-type]  # That is what is tried.


def test_a_hand_that_is_no_persons_cannot_be_led(spec: HandSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    for names, words in ((("claw", "middle", "ring", "thumb"), "a finger 'claw'"), (("index", "middle"), "no thumb")):
        fingers = tuple(replace(finger, name=name) for finger, name in zip(spec.fingers, names, strict=False))
        with pytest.raises(ConfigError, match=words):
            FingertipTargets(replace(spec, fingers=fingers), "right")


def test_the_same_track_leads_to_the_same_motion_to_the_bit(make_rows: Callable[[], list[Vector]]) -> None:
    for a, b in zip(make_rows(), make_rows(), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.fixture
def make_rows() -> Callable[[], list[Vector]]:
    def rows() -> list[Vector]:
        times, frames = performed(RATE)
        with led(sim_config()) as it:
            it.play(times[30:60], frames[30:60])
            return [row for _, row in it.rows]

    return rows
