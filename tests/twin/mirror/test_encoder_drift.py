"""An encoder that drifts is told from gravity, over half a minute and more, and is not taken for anything else."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from allegro_twin.sim.observer.observer import CREEP, Estimate, StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.twin.mirror.encoder_drift import BLOCK, SPANS, DriftDetector
from allegro_twin.twin.mirror.fault_detection import EVERY, ROWS, WAIT, FaultDetector, LinkWeights, Thresholds
from allegro_twin.twin.mirror.faults import ROW as ROW_PERIODS
from allegro_twin.types import HandState, Vector

N, ROW = 16, 0.03
DOWN = np.array([6.0, 0.0, -7.7])
ALL = np.ones(N, dtype=bool)
OWN = np.kron(np.eye(4), np.ones((4, 4)))
PULL = np.random.default_rng(4).uniform(-1.0, 1.0, (N, N)) * OWN  # Any will do.


def test_how_gravity_turns_with_the_joints_is_what_differences_of_its_torques_say(spec: HandSpec) -> None:
    observer = StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), 0.003)
    where = (spec.lower + 2.0 * spec.upper) / 3.0
    observer.reset(where)
    here = observer.step(np.zeros(N), DOWN, where).position
    model, data = observer._model, observer._data
    mujoco.mj_forward(model, data)
    lean, step = observer.lean(), 1e-5

    def weight(position: Vector) -> Vector:
        data.qpos[:], data.qvel[:] = position, 0.0
        mujoco.mj_forward(model, data)
        return np.asarray(-data.qfrc_bias)

    columns = [(weight(here + step * e) - weight(here - step * e)) / (2.0 * step) for e in np.eye(N)]
    np.testing.assert_allclose(lean, np.array(columns).T, atol=1e-7)
    assert np.abs(lean).max() > 0.03


def seen(
    spec: HandSpec, seconds: float, wrong: str, at: float = 0.4
) -> tuple[DriftDetector, list[tuple[int, float] | None]]:
    """Rows that are made up: every joint moves at a pace of its own, and something grows, or comes at once, after a
    share `at` of the time."""
    each, said = DriftDetector(spec, ROW), []
    rng = np.random.default_rng(2)
    usual = rng.uniform(-1.5, 1.5, (N, N))
    pace, phase = rng.uniform(2.0, 6.0, N), rng.uniform(0.0, 6.0, (2, N, N))
    for row in range(round(seconds / ROW)):
        t = row * ROW
        angle = np.sin(pace * t + phase[0]) + usual
        lean = 0.02 * OWN * (angle + angle.T)
        torque, side = 0.1 * np.sin(2.3 * pace * t + phase[1][0]), np.sign(np.cos(pace * t + phase[1][1]))
        pushes: dict[str, Vector] = {
            "nothing": np.zeros(N),
            "drift": -lean[:, 6] * 1e-3 * t,
            "step": -lean[:, 6] * 0.1 * (t > at * seconds),
            "payload": 0.01 * PULL[6] * (t > at * seconds),
            "weak": -torque * (np.arange(N) == 6) * 0.2 * (t > at * seconds),
            "fading": -torque * (np.arange(N) == 6) * 2e-3 * t,
        }
        d = 5e-4 * rng.standard_normal(N) + pushes[wrong]
        each.add(d, np.array([torque, side]), ALL, lean, PULL)
        said += [each.check()] if row % EVERY == 0 else []
    return each, said


def test_a_drift_is_known_with_its_joint_and_its_rate(spec: HandSpec) -> None:
    _, said = seen(spec, 60.0, "drift")
    known = [each for each in said if each is not None]
    assert known
    joint, rate = known[-1]
    assert joint == 6
    assert rate == pytest.approx(1e-3, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["nothing", "step", "fading"])
def test_a_step_a_motor_that_fades_and_nothing_at_all_are_no_drift(spec: HandSpec, wrong: str) -> None:
    _, said = seen(spec, 150.0, wrong)
    assert len(said) > 100
    assert said == [None] * len(said)


def test_what_touches_a_finger_is_no_drift_of_its_encoders(spec: HandSpec) -> None:
    each = DriftDetector(spec, ROW)
    lean = np.asarray(0.03 * np.kron(np.eye(4), np.ones((4, 4))), dtype=np.float64)
    for row in range(SPANS[0] * BLOCK):
        free = np.arange(N) // 4 != 1
        each.add(-lean[:, 6] * 1e-3 * row * ROW, np.zeros((2, N)), free, lean, PULL)
    assert not each.explains_more("payload", 6, 1e-9)
    assert [each.check() for _ in range(4 * len(SPANS))] == [None] * 4 * len(SPANS)


def test_what_came_at_once_is_not_taken_for_something_that_grew(spec: HandSpec) -> None:
    came = {name: seen(spec, 40.5, name, 0.94)[0] for name in ("payload", "weak")}
    grew = seen(spec, 40.5, "drift")[0]
    for name, each in came.items():
        assert not each.explains_more(name, 6, 1e-6)
        assert grew.explains_more(name, 6, 1e-6)


def test_a_drift_that_is_little_beside_what_a_name_explains_is_not_in_its_way(spec: HandSpec) -> None:
    grew = seen(spec, 40.5, "drift")[0]
    assert [grew.explains_more("weak", 6, gain) for gain in (1e-6, 1.0)] == [True, False]


def test_a_name_waits_as_long_as_a_drift_explains_more(spec: HandSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    periods = ROW_PERIODS * (ROWS + WAIT + 3 * EVERY)
    found = []
    for grew in (False, True):
        monkeypatch.setattr(DriftDetector, "explains_more", lambda self, name, joint, gain, much=grew: much)
        each = FaultDetector(spec, Thresholds(np.full((2, N), 0.02), np.full(4, 1e-4)), 0.003)
        for tick in range(periods):
            t = 0.003 * tick
            torque, speed = 0.1 * np.sin(7.0 * t + np.arange(N)), 0.9 * np.cos(3.0 * t + np.arange(N))
            state = HandState(t, tick, 0.3 * np.sin(3.0 * t + np.arange(N)), speed, torque, np.full(N, np.nan), DOWN)
            push = np.where(np.arange(N) == 7, -0.5 * torque, 0.0)
            estimate = Estimate(state.position, state.position, push, speed, np.tanh(speed / CREEP))
            weights = LinkWeights(np.zeros((N, N)), None, ALL, DOWN) if each.row_due else None
            each.add(state, estimate, torque, np.zeros(N), weights)
        found.append([one.name for one in each.faults.active])
    assert found == [["weak"], []]
