"""A motion that the guard would stop is refused before it begins, by the `limits.velocity` of the session."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.control.trajectory import KnownPath, Moves, Path, Profile, TimedPath, Waypoint
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.library import load_posture, load_trajectory
from allegro_twin.loop import run
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.external_setpoints import ExternalSetpoints
from allegro_twin.types import Array

STOPS = r"would move at [0-9.]+ rad/s; 0\.6 is where the guard stops: slow down to 0\.[0-9]+ of that, or raise limits"

TIP = np.array([-0.01, 0.0, 0.005])


def config(velocity: float | list[float], **blocks: object) -> RunConfig:
    given_ = {"backend": {"kind": "sim"}, "controller": {"kind": "pd"}, "limits": {"velocity": velocity}}
    return RunConfig.model_validate(given_ | blocks)


def follow(hand: Hand) -> None:
    home = load_posture("home", hand.spec)
    ExternalSetpoints(hand, 0.5).follow(np.array([0.5]), home[None])


@pytest.mark.parametrize(
    ("wish", "what"),
    [
        (lambda hand: hand.move_to("home", 2.0), "home: "),
        (lambda hand: hand.move_to(np.full(16, 0.3), 0.7), "the posture: "),
        (lambda hand: hand.play("ripple", 3.0, approach=0.5), "ripple: "),
        (lambda hand: hand.grasp("grasp_3"), "grasp grasp_3: "),
        (lambda hand: hand.move_fingertips({"index": hand.fingertips()["index"].position - TIP}, 0.3), "fingertip"),
        (lambda hand: hand.direct.steer(np.full(16, 0.3), 2.0), "the goal: "),
        (lambda hand: ExternalSetpoints(hand, 2.0), "set-points: "),
        (follow, "joint_trajectory: "),
    ],
)
def test_a_motion_that_the_guard_would_stop_is_refused_before_it_begins(
    wish: Callable[[Hand], object], what: str
) -> None:
    with Hand.open(config(0.6)) as hand:
        with pytest.raises(ConfigError, match=f"^{what}.*{STOPS}"):
            wish(hand)
        assert hand.state.t == 0.0
        assert hand.controller == "torque"


def test_the_joint_with_the_lowest_limit_is_named() -> None:
    limits = [12.0] * 16
    limits[6] = 0.3
    with Hand.open(config(limits)) as hand:
        hand.wait(0.01)
        start = np.clip(hand.state.position, *hand.limits)
        goal = start.copy()
        goal[[5, 6]] += 0.6, 0.3
        with pytest.raises(ConfigError, match=r"middle_2 would move at 0\.35 rad/s; 0\.3 is where .* to 0\.85 of that"):
            hand.move_to(goal, 0.7)
        hand.move_to(goal, 0.5)


def test_within_its_limit_a_hand_arrives_and_a_person_who_asks_for_no_speed_is_given_one() -> None:
    with Hand.open(config(0.6)) as hand:
        hand.move_to("home", 0.5)
        hand.direct.steer(hand.state.position + 0.2)
        hand.wait()
        assert hand.direct.usual_speed(3.0) == pytest.approx(0.54)
        assert hand.direct.usual_speed(0.2) == 0.2


def test_a_guard_that_lets_a_hand_be_faster_lets_motions_be_faster() -> None:
    with Hand.open(config(20.0)) as hand:
        hand.move_to("home", 15.0, wait=False)
        with pytest.raises(ConfigError, match="speed must be positive, in rad/s, from 0.001 to 60; it is 61"):
            hand.move_to("home", 61.0)


@pytest.mark.parametrize(
    ("kind", "task", "what"),
    [
        ("pd", {"posture": "home"}, "home"),
        ("pid", {"posture": "home"}, "home"),
        ("pd", {}, "the motion"),
        ("pd", {"grasp": "grasp_3"}, "the motion"),
        ("pd", {"grasp": "envelop"}, "the motion"),
    ],
)
def test_a_run_whose_motion_the_guard_would_stop_is_refused_before_it_begins(
    kind: str, task: dict[str, object], what: str
) -> None:
    speed = {} if "grasp" in task else {"speed": 2.0}  # A grasp brings its own.
    rig = assemble(config(0.6, controller={"kind": kind, **speed}, task=task))
    with pytest.raises(ConfigError, match=f"^{what}: .*{STOPS}"):
        next(run(rig.backend, rig.controller))
    rig.backend.close()


def sampled(path: Path, seconds: float) -> Array:
    """The greatest speeds of joints, (n,), rad/s."""
    speeds = [path(t).velocity for t in np.linspace(0.0, seconds * (1.0 - 1e-9), 4001)]
    return np.asarray(np.abs(speeds).max(axis=0))


rows = arrays(np.float64, (4, 3), elements=st.floats(-1.0, 1.0, width=16))


@given(rows, st.sampled_from(["linear", "minimum_jerk"]), st.floats(0.1, 3.0))
def test_the_peak_of_a_trajectory_is_its_greatest_speed(postures: Array, profile: Profile, speed: float) -> None:
    path = Moves([Waypoint(row, speed=speed, profile=profile) for row in postures[1:]]).begin(postures[0])
    found = sampled(path, path.seconds)
    assert (path.peak >= found - 1e-9).all()
    np.testing.assert_allclose(path.peak, found, rtol=0.02, atol=1e-2 * speed)


@pytest.mark.slow
@given(rows, st.one_of(st.none(), rows))
def test_the_peak_of_timed_postures_is_their_greatest_speed(postures: Array, velocities: Array | None) -> None:
    path = TimedPath(np.array([0.0, 0.5, 1.3, 1.5]), postures, velocities)
    found = sampled(path, path.seconds)
    assert (path.peak >= found - 1e-9).all()
    np.testing.assert_allclose(path.peak, found, rtol=1e-3, atol=1e-3)


def test_a_trajectory_of_the_library_has_the_peak_of_its_fastest_line() -> None:
    with Hand.open(config(12.0)) as hand:
        motion = load_trajectory("ripple", hand.spec)
    rate = np.abs(np.diff(motion.positions, axis=0) / np.diff(motion.times)[:, None]).max(axis=0)
    path = KnownPath(motion.path(2.0)).path
    np.testing.assert_allclose(path.peak, 2.0 * rate)  # type: ignore[attr-defined]  # It is a trajectory.
