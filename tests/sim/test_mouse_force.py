"""The mouse pulls a body by a spring of bounded strength, and the simulation without it is what it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from allegro_twin.grasping.evaluation.rejudge import rejudge
from allegro_twin.grasping.trial import Trial, make_trial
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.engine.mouse_force import LARGEST, SECONDS, STIFFNESS, MouseDrag, drag_force
from allegro_twin.types import TorqueCommand, Vector

ZERO = np.zeros(3)


def beside(place: Vector, *way: float) -> Vector:
    """A place so many metres from another."""
    return np.asarray(place + np.array(way))


@pytest.fixture
def trial() -> Trial:
    """A lemon on its table, before the hand comes."""
    found = make_trial("lemon", load_spec(), 0.003)
    assert found is not None
    found.backend.drive = found.backend.drive[:1]
    found.backend.reset()
    return found


def read(trial: Trial, periods: int) -> Vector:
    """Where the lemon is after so many periods of a limp hand, m."""
    for _ in range(periods):
        trial.backend.write(TorqueCommand(np.zeros(16)))
        trial.backend.read()
    return np.array(trial.backend.data.body("lemon").xpos)


def test_a_body_at_rest_is_pulled_with_stiffness_times_distance_and_never_with_more_than_the_largest_force(
    trial: Trial,
) -> None:
    model, data = trial.backend.model, trial.backend.data
    read(trial, 100)
    data.qvel[:] = 0.0
    data.cvel[:] = 0.0
    body = model.body("lemon").id
    at = np.array(data.xpos[body])
    point, force = drag_force(model, data, MouseDrag(body, ZERO, beside(at, 0.01, 0.0, 0.0)))
    np.testing.assert_allclose(point, at)
    np.testing.assert_allclose(force, [0.01 * STIFFNESS, 0.0, 0.0], atol=1e-12)
    _, force = drag_force(model, data, MouseDrag(body, ZERO, beside(at, 3.0, 0.0, 4.0)))
    np.testing.assert_allclose(force, [0.6 * LARGEST, 0.0, 0.8 * LARGEST], rtol=1e-12)


def test_a_body_that_is_pulled_at_its_middle_hangs_under_the_mouse_by_its_weight(trial: Trial) -> None:
    begin, mouse = read(trial, 100), trial.backend.mouse
    target = beside(begin, 0.0, 0.0, 0.015)
    for _ in range(4):
        trial.backend.drag("lemon", ZERO, target)
        read(trial, 150)
    assert mouse.now is not None
    _, point, force = mouse.now
    weight = 9.81 * float(trial.backend.model.body("lemon").mass[0])
    np.testing.assert_allclose(force, [0.0, 0.0, weight], atol=0.01 * weight)
    np.testing.assert_allclose(point, target - [0.0, 0.0, weight / STIFFNESS], atol=1e-4)
    assert LARGEST >= mouse.largest > weight


def test_a_body_that_is_pulled_at_its_side_turns(trial: Trial) -> None:
    read(trial, 100)
    data = trial.backend.data
    trial.backend.drag("lemon", np.array([0.0, 0.02, 0.0]), beside(np.array(data.body("lemon").xpos), 0.0, 0.0, 1.0))
    read(trial, 1)
    assert trial.backend.mouse.now is not None
    turn = data.body("lemon").xmat.reshape(3, 3)
    _, _, force = trial.backend.mouse.now
    dof = trial.backend.model.body("lemon").dofadr[0]
    np.testing.assert_allclose(data.qfrc_applied[dof : dof + 3], force, atol=1e-9)
    torque = np.cross([0.0, 0.02, 0.0], turn.T @ force)
    np.testing.assert_allclose(data.qfrc_applied[dof + 3 : dof + 6], torque, atol=2e-3)


def test_who_lets_go_leaves_no_force_behind_and_a_mouse_of_which_nothing_is_heard_lets_go(trial: Trial) -> None:
    begin = read(trial, 50)
    for let_go in (trial.backend.let_go, lambda: read(trial, round(SECONDS / 0.003) + 1)):
        trial.backend.drag("lemon", ZERO, beside(begin, 0.0, 0.0, 0.3))
        read(trial, 5)
        assert trial.backend.data.qfrc_applied.any()
        let_go()
        read(trial, 1)
        assert not trial.backend.data.qfrc_applied.any()
        assert trial.backend.mouse.now is None
    trial.backend.drag("lemon", ZERO, begin)
    trial.backend.reset()
    assert not trial.backend.mouse.active
    assert trial.backend.mouse.largest == 0.0


def test_a_simulation_in_which_the_mouse_has_let_go_before_it_began_is_the_same_to_the_bit(trial: Trial) -> None:
    plain = read(trial, 200)
    trial.backend.drag("lemon", ZERO, plain)
    trial.backend.let_go()
    trial.backend.reset()
    np.testing.assert_array_equal(read(trial, 200), plain)


def test_a_recorded_trial_in_which_the_mouse_pulled_has_no_verdict(trial: Trial, tmp_path: Path) -> None:
    meta = trial.meta()
    n = 500
    t = np.linspace(0.0, trial.seconds, n)
    pose = np.tile([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], (n, 1))
    columns = {"t": t, "palm": pose, "object": pose, "contact_force": np.ones((n, 5)), "on_table": np.zeros((n, 1)),
               "torque": np.zeros((n, 16)), "mouse_force": np.zeros((n, 3))}  # fmt: skip
    spec = trial.backend.spec
    assert rejudge(spec, columns, meta) is not None
    columns["mouse_force"][1] = [0.0, 0.0, 1.0]
    assert rejudge(spec, columns, meta) is None
