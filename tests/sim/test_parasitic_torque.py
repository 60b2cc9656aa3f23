"""Torque that a motor was not told to give: constant, with the speed, with the angle; and a palm that leans."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.sim.drivetrain.parasitic_torque import torque
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.observer.observer import StateObserver
from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.types import TorqueCommand, frozen
from tests.conftest import MakeSim
from tests.sim.test_windows import MIDDLE, duties, parameters, piece, simulated

DOWN = np.array([0.0, 0.0, -9.81])
STRAY = {
    "bias_torque": np.tile([0.01, -0.02, 0.015, -0.005], 4), "stiffness": np.tile([0.02, 0.01, 0.0, 0.005], 4),
    "uneven_damping": np.tile([0.01, -0.02, 0.02, -0.01], 4),
    "cogging_cosine": np.full(16, 0.004), "cogging_sine": np.full(16, -0.006), "cogging_periods": np.full(16, 7.0),
    "ripple_cosine": np.full(16, 0.1), "ripple_sine": np.full(16, -0.05), "ripple_periods": np.full(16, 5.0),
}  # fmt: skip


def driven(spec: HandSpec, **drive: Any) -> HandSpec:
    rows = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in drive.items()}
    return replace(spec, drive=Drive.from_values(rows, 16))


def moved(backend: SimBackend, torque: float) -> np.ndarray:
    backend.reset()
    for _ in range(100):
        backend.write(TorqueCommand(np.full(16, torque)))
        state = backend.read()
    return state.position


def test_a_constant_torque_moves_a_hand_as_motors_would_that_give_it(spec: HandSpec, make_sim: MakeSim) -> None:
    alone, told = moved(make_sim(driven(spec, bias_torque=0.04)), 0.0), moved(make_sim(driven(spec)), 0.04)
    np.testing.assert_allclose(alone, told, atol=1e-9)
    assert np.abs(told - moved(make_sim(spec), 0.0)).max() > 0.1


def test_a_motor_at_its_limit_feels_it_all_the_same(spec: HandSpec, make_sim: MakeSim) -> None:
    free, held = (moved(make_sim(driven(spec, bias_torque=bias)), 9.0) for bias in (0.0, -0.2))
    assert (held < free - 1e-3).sum() >= 8


def test_damping_by_direction_holds_back_forwards_and_pushes_on_backwards() -> None:
    terms = parameters_of(uneven_damping=np.full(16, 0.02))
    np.testing.assert_allclose(torque(terms, MIDDLE, np.full(16, 2.0)), -0.04)
    np.testing.assert_allclose(torque(terms, MIDDLE, np.full(16, -2.0)), -0.04)


def test_a_spring_pulls_in_proportion_to_the_angle_and_rests_where_the_constant_torque_holds_it() -> None:
    terms, rest = parameters_of(stiffness=np.full(16, 0.02), bias_torque=np.full(16, 0.01)), np.full(16, 0.5)
    np.testing.assert_allclose(torque(terms, rest, np.ones(16)), 0.0, atol=1e-15)
    np.testing.assert_allclose(torque(terms, rest + 0.3, np.ones(16)), -0.006)


def test_ripple_is_a_share_of_what_the_motor_gives() -> None:
    terms = parameters_of(**{name: STRAY[name] for name in ("ripple_cosine", "ripple_sine", "ripple_periods")})
    still, pull = np.zeros(16), np.full(16, 0.3)
    np.testing.assert_allclose(torque(terms, still, still, pull), 0.03)
    np.testing.assert_allclose(torque(terms, MIDDLE, still, -2.0 * pull), -2.0 * torque(terms, MIDDLE, still, pull))
    assert not torque(terms, MIDDLE, still).any()


def test_cogging_comes_again_with_the_angle() -> None:
    terms = parameters_of(**{name: STRAY[name] for name in ("cogging_cosine", "cogging_sine", "cogging_periods")})
    still, turn = np.zeros(16), 2.0 * np.pi / 7.0
    np.testing.assert_allclose(torque(terms, MIDDLE + turn, still), torque(terms, MIDDLE, still), atol=1e-12)
    opposite = torque(terms, MIDDLE + turn / 2.0, still)
    np.testing.assert_allclose(opposite, -torque(terms, MIDDLE, still), atol=1e-12)
    assert np.abs(opposite).max() <= np.hypot(0.004, 0.006)


def parameters_of(**terms: np.ndarray) -> Any:
    from allegro_twin.hands.description.specs import load_spec

    return parameters(load_spec(), **terms)


@pytest.mark.parametrize("bristly", [False, True])
def test_the_model_that_is_fitted_feels_it_as_the_simulation_does(
    spec: HandSpec, make_sim: MakeSim, *, bristly: bool
) -> None:
    shape = {"stiction": 1.4, "stribeck_speed": 0.1, "bristle": 1e-3} if bristly else {}
    rows = {name: np.full(16, value) for name, value in shape.items()}
    player = OpenLoopPlayer(spec, 0.003, 0.001, bristly=bristly, parasitic=True)
    drive = parameters(spec, **STRAY, **rows)
    pieces = piece(player, drive, np.concatenate([np.zeros((6, 16)), duties()]), DOWN)
    there = simulated(make_sim, driven(spec, **STRAY, **shape), duties())
    played = player.play(drive, MIDDLE[None], np.zeros((1, 16)), pieces)[0]
    apart = np.abs(played - there).max(axis=0)
    assert np.median(apart) < 1e-3
    without = OpenLoopPlayer(spec, 0.003, 0.001, bristly=bristly).play(drive, MIDDLE[None], np.zeros((1, 16)), pieces)
    assert np.median(np.abs(without[0] - there).max(axis=0)) > 0.01


def test_a_palm_that_leans_says_what_it_believes_of_gravity_and_feels_what_is(
    spec: HandSpec, make_sim: MakeSim
) -> None:
    lean = np.array([0.1, -0.2, 0.15])
    leaning, upright = make_sim(driven(spec, tilt=lean)), make_sim(spec)
    said, nominal = leaning.reset().gravity, upright.reset().gravity
    np.testing.assert_allclose(said, nominal, atol=1e-12)
    palm = leaning.data.xmat[leaning.model.body(spec.root).id].reshape(3, 3)
    np.testing.assert_allclose(leaning.model.opt.gravity @ palm, rotate_vector(nominal, lean), atol=1e-12)


@pytest.mark.parametrize("bristly", [False, True])
def test_friction_falls_while_a_hand_warms_up_in_the_simulation_and_in_the_model(
    spec: HandSpec, make_sim: MakeSim, *, bristly: bool
) -> None:
    shape = {"stiction": 1.4, "stribeck_speed": 0.1, "bristle": 1e-3} if bristly else {}
    warmth = {"cold_friction": np.full(16, 1.0), "warm_up": np.full(16, 0.1)}
    rows = {name: np.full(16, value) for name, value in shape.items()}
    drive = parameters(spec, **warmth, **rows)
    cold, warm = (
        played_at(OpenLoopPlayer(spec, 0.003, 0.001, bristly=bristly, warming=True), drive, time)
        for time in (0.0, 10.0)
    )
    there = simulated(make_sim, driven(spec, **warmth, **shape), duties())
    assert np.median(np.abs(cold - there).max(axis=0)) < 1e-3
    ever = played_at(OpenLoopPlayer(spec, 0.003, 0.001, bristly=bristly), parameters(spec, **rows), 0.0)
    np.testing.assert_allclose(warm, ever, atol=1e-9)
    assert np.median(np.abs(cold - ever).max(axis=0)) > 0.01


def played_at(player: OpenLoopPlayer, drive: Any, time: float) -> np.ndarray:
    pieces = piece(player, drive, np.concatenate([np.zeros((6, 16)), duties()]), DOWN)
    pieces = pieces._replace(time=np.array([time]))
    played: np.ndarray = player.play(drive, MIDDLE[None], np.zeros((1, 16)), pieces)[0]
    return played


def test_a_hand_that_begins_anew_is_cold_again(spec: HandSpec, make_sim: MakeSim) -> None:
    backend = make_sim(driven(spec, cold_friction=0.5, warm_up=0.1))
    first, again = moved(backend, 0.1), moved(backend, 0.1)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(backend.model.dof_damping[:16], spec.actuation.damping, rtol=0.05)


def test_a_joint_without_a_time_to_warm_up_in_is_never_cold(spec: HandSpec, make_sim: MakeSim) -> None:
    some = driven(spec, cold_friction=0.5, warm_up=np.where(np.arange(16) == 5, 0.2, 0.0))
    backend = make_sim(some)
    moved(backend, 0.0)
    parameters_ = drive_parameters(some, np.ones(16), np.zeros(16))
    np.testing.assert_array_equal(np.flatnonzero(parameters_.warmth(0.0) != 1.0), [5])
    changed = backend.model.dof_damping[:16] != spec.actuation.damping
    np.testing.assert_array_equal(np.flatnonzero(changed), [5])


def test_a_mirror_that_begins_anew_beside_a_hand_that_runs_knows_how_warm_it_is(
    spec: HandSpec, make_sim: MakeSim
) -> None:
    warming = driven(spec, cold_friction=1.0, warm_up=0.5)
    felt = []
    for time in (True, False):
        backend = make_sim(warming, posture=MIDDLE)
        observer = StateObserver(spec, drive_parameters(warming, np.ones(16), np.zeros(16)), 0.003)
        state = backend.reset()
        for number, row in enumerate(np.tile(duties(), (10, 1))):
            if number == 600:
                observer.reset(state.position, *([state.t] if time else []))
            backend.write(TorqueCommand(frozen(row)))
            state = backend.read()
            if number >= 600:
                estimate = observer.step(state.torque, state.gravity, state.position)
        felt.append(float(np.median(np.abs(estimate.disturbance))))
    assert felt[0] < 0.5 * felt[1]


def test_a_mirror_that_knows_it_feels_nothing_from_outside(spec: HandSpec, make_sim: MakeSim) -> None:
    known = driven(spec, **STRAY, tilt=np.array([0.3, -0.2, 0.1]), cold_friction=0.5, warm_up=1.0)
    backend = make_sim(known, posture=MIDDLE)
    felt = {}
    for name, own in (("knows", known), ("does not", spec)):
        observer = StateObserver(spec, drive_parameters(own, np.ones(16), np.zeros(16)), 0.003)
        state = backend.reset()
        observer.reset(state.position)
        for row in np.concatenate([duties(), duties()]):
            backend.write(TorqueCommand(frozen(row)))
            state = backend.read()
            estimate = observer.step(state.torque, state.gravity, state.position)
        felt[name] = np.abs(estimate.disturbance)
    assert np.median(felt["knows"]) < 1e-3
    assert np.median(felt["does not"]) > 5e-3


def test_a_tilt_is_three_numbers_and_a_cogging_needs_no_sign() -> None:
    with pytest.raises(Exception, match="tilt needs one number or 3, not 16"):
        Drive.from_values({"tilt": [0.1] * 16}, 16)
    for name in ("cogging_sine", "stiffness", "ripple_cosine", "ripple_sine"):
        assert Drive.from_values({name: -0.01}, 16).parasitic
    assert not Drive.from_values({"tilt": [0.1, 0.0, 0.0]}, 16).parasitic
