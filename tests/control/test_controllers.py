"""The default gains keep their promises at 333 Hz with the official clip, in every palm orientation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from allegro_twin.control.controllers import PD, PID, ConstantTorque, GravityCompensation, GravityFeedforward
from allegro_twin.control.trajectory import Hold
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard, Limits
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array, Vector, frozen
from tests.conftest import MakeSim
from tests.test_safety import state

ORIENTATIONS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
UPRIGHT, HANGING = (0, 0, 1), (0, 0, -1)


def gravity_of(spec: HandSpec, vector: Vector | None = None) -> GravityFeedforward:
    return GravityFeedforward(hand_kinematics(spec).gravity_torque, vector)


def settle(backend: Any, controller: Any, seconds: float) -> tuple[Array, Array]:
    """Times (k,) and joint positions (k, n) of a run."""
    rows = [(s.state.t, s.state.position) for s in until(seconds, run(backend, controller))]
    return np.array([t for t, _ in rows]), np.array([q for _, q in rows])


def step_start(spec: HandSpec, sign: float) -> Vector:
    """A posture from which a step of ±0.5 rad on every joint stays inside the limits and touches nothing."""
    low = np.tile([-0.2, 0.2, 0.2, 0.2], 4)
    low[12] = 0.4
    return frozen(low if sign > 0 else low + 0.5)


def steps() -> list[Any]:
    """Every way to face, with every kind, compensated or not, up or down; in the fast tier each two of these together
    at least once."""
    return [
        pytest.param(facing, compensated, kind, sign,
                     marks=() if k == (at + c) % 2 and s == (at // 2 + c) % 2 else pytest.mark.slow)
        for at, facing in enumerate(ORIENTATIONS)
        for c, compensated in enumerate((True, False))
        for k, kind in enumerate(("pd", "pid"))
        for s, sign in enumerate((1.0, -1.0))
    ]  # fmt: skip


@pytest.mark.parametrize(("facing", "compensated", "kind", "sign"), steps())
def test_a_step_settles_in_time_without_overshoot_error_or_limit_cycle(
    facing: tuple[float, float, float], compensated: bool, kind: str, sign: float, spec: HandSpec, make_sim: MakeSim
) -> None:
    fingers = (1.0, 0.0, 0.0) if facing[2] else UPRIGHT
    start = step_start(spec, sign)
    goal = spec.posture(start + 0.5 * sign)
    gains, gravity = load_gains("default", spec), gravity_of(spec) if compensated else None
    controller = (
        PD(Hold(goal), gains, gravity) if kind == "pd" else PID(Hold(goal), gains, spec.actuation.torque_limit, gravity)
    )
    limits = Limits(spec.actuation.torque_limit, frozen(np.full(16, 12.0)), spec.lower, spec.upper)
    backend = Guard(make_sim(spec, facing=facing, fingers=fingers, posture=start), limits)
    t, position = settle(backend, controller, 1.5)
    error = position - goal
    assert np.abs(error[t >= 0.3]).max() <= 0.05 * 0.5  # Settled: inside 5 % and staying there.
    assert (error * sign).max() <= 0.05 * 0.5  # Overshoot.
    late = error[t > 1.1]
    assert np.abs(late.mean(axis=0)).max() <= (0.002 if kind == "pid" else 0.015)
    assert late.std(axis=0).max() <= 0.0005


@pytest.mark.parametrize("kind", ["pd", "pid"])
def test_gains_for_hands_with_play_settle_a_hand_without_as_fast_with_a_little_overshoot(
    kind: str, spec: HandSpec, make_sim: MakeSim
) -> None:
    start, gains, gravity = step_start(spec, 1.0), load_gains("loose", spec), gravity_of(spec)
    hold = Hold(spec.posture(start + 0.5))
    controller = PD(hold, gains, gravity) if kind == "pd" else PID(hold, gains, spec.actuation.torque_limit, gravity)
    limits = Limits(spec.actuation.torque_limit, frozen(np.full(16, 12.0)), spec.lower, spec.upper)
    t, position = settle(Guard(make_sim(spec, posture=start), limits), controller, 1.5)
    error = position - hold.posture
    assert np.abs(error[t >= 0.3]).max() <= 0.05 * 0.5
    assert error.max() <= 0.1 * 0.5
    assert error[t > 1.1].std(axis=0).max() <= 0.0005


@pytest.mark.parametrize("facing", ORIENTATIONS)
def test_gravity_compensation_lets_no_finger_sink(
    facing: tuple[float, float, float], side: Side, make_sim: MakeSim
) -> None:
    spec = load_spec(side=side)
    fingers = (1.0, 0.0, 0.0) if facing[2] else UPRIGHT
    start = step_start(spec, 1.0) + 0.1
    start = spec.posture(start if side == "right" else spec.mirror_posture(start))
    _, position = settle(
        make_sim(spec, facing=facing, fingers=fingers, posture=start), GravityCompensation(gravity_of(spec)), 1.0
    )
    assert np.abs(position - start).max() < 1e-3


def test_without_compensation_the_same_hand_sinks(spec: HandSpec, make_sim: MakeSim) -> None:
    start = spec.posture(step_start(spec, 1.0) + 0.1)
    _, position = settle(
        make_sim(spec, facing=(0, 0, 1), fingers=(1, 0, 0), posture=start), ConstantTorque(np.zeros(16)), 1.0
    )
    assert np.abs(position - start).max() > 0.1


def test_a_given_gravity_vector_replaces_what_the_hand_reports(spec: HandSpec, make_sim: MakeSim) -> None:
    start = spec.posture(step_start(spec, 1.0) + 0.1)
    wrong = GravityCompensation(gravity_of(spec, frozen([0.0, 0.0, 9.81])))
    right = GravityCompensation(gravity_of(spec, frozen([0.0, 0.0, -9.81])))
    _, sunk = settle(make_sim(spec, fingers=UPRIGHT, posture=start), wrong, 1.0)
    _, held = settle(make_sim(spec, fingers=UPRIGHT, posture=start), right, 1.0)
    assert np.abs(held - start).max() < 1e-3 < 0.05 < np.abs(sunk - start).max()


def test_a_hand_that_reports_no_gravity_is_not_compensated_with_a_guess(spec: HandSpec) -> None:
    blind = state(gravity=np.full(3, np.nan))
    with pytest.raises(
        ConfigError, match=r"IMU tell it \(`backend.imu: 0.05`.* its backend or the controller `gravity`"
    ):
        GravityCompensation(gravity_of(spec)).start(blind)
    GravityCompensation(gravity_of(spec, frozen([0.0, 0.0, -9.81]))).start(blind)


def test_unknown_gains_are_named_with_the_nearest(spec: HandSpec) -> None:
    with pytest.raises(ConfigError, match="no gains named 'defalt'; did you mean 'default'"):
        load_gains("defalt", spec)


def test_a_joint_whose_speed_is_unknown_is_not_damped_and_the_others_are(spec: HandSpec) -> None:
    gains = load_gains("default", spec)
    velocity = np.ones(spec.n_joints)
    velocity[3] = np.nan
    at = state(position=np.zeros(spec.n_joints), velocity=velocity)
    damped = -gains.kd.copy()
    damped[3] = 0.0
    pd = PD(Hold(at.position), gains)
    np.testing.assert_allclose(pd(at, pd.start(at))[0].torque, damped)
    pid = PID(Hold(at.position), gains, spec.actuation.torque_limit)
    np.testing.assert_allclose(pid(at, pid.start(at))[0].torque, damped)
