"""What the descent changes, and how the residuals and a drive follow it."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.sim.open_loop import DriveParameters, OpenLoopPlayer
from allegro_twin.twin.identify.fitting.parameterisation import from_scaled, index, scaling_jacobian, to_scaled
from allegro_twin.twin.identify.fitting.problem import Problem, prior_center
from allegro_twin.twin.identify.fitting.regress import regress, regress_breakaway
from allegro_twin.twin.identify.fitting.shooting import SHORT
from allegro_twin.twin.identify.motions.motion import read_motion
from allegro_twin.types import Vector
from tests.twin.identify import hidden

JOINT = 6


@pytest.fixture(scope="module")
def made() -> tuple[Problem, DriveParameters]:
    """Of a few short pieces of a hand whose friction breaks away, and a drive near it."""
    motions = [read_motion(path) for path in hidden.recordings(breaking=True)]
    player = OpenLoopPlayer(motions[0].spec, motions[0].period)
    drive = regress_breakaway(motions, player, regress(motions, player, np.ones(16)))
    bristly = OpenLoopPlayer(motions[0].spec, motions[0].period, bristly=True)
    problem = Problem(motions, bristly, np.full(16, 6e-5), prior_center(drive, drive), "known", every=40, length=SHORT)
    problem.shooting.prepare(drive)
    return problem, drive


def values(problem: Problem, x: Vector) -> Vector:
    """Of a drive, in the order of `index`."""
    drive = problem.drive_of(x)
    names = ("torque_constant", "armature", "damping", "frictionloss", "load_friction")
    return np.concatenate([getattr(drive, name) for name in names])


@pytest.mark.slow
def test_a_drive_comes_back_as_it_went(made: tuple[Problem, DriveParameters]) -> None:
    _, drive = made
    back = from_scaled(to_scaled(drive), drive)
    for name in ("torque_constant", "armature", "damping", "frictionloss", "load_friction", "delay"):
        np.testing.assert_allclose(getattr(back, name), getattr(drive, name), rtol=1e-12)


@pytest.mark.slow
def test_the_slope_is_the_derivative_of_a_drive(made: tuple[Problem, DriveParameters]) -> None:
    problem, drive = made
    x, names = to_scaled(drive), ("torque_constant", "armature", "damping", "frictionloss", "load_friction")
    rows = np.concatenate([np.arange(len(x))[index(name, 16)] for name in names])
    for name in names:
        column = index(name, 16).start + JOINT
        by = 1e-6 * np.eye(len(x))[column]
        change = (values(problem, x + by) - values(problem, x - by)) / 2e-6
        np.testing.assert_allclose(scaling_jacobian(drive)[rows, column], change, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["torque_constant", "damping", "frictionloss", "load_friction"])
def test_the_residuals_follow_the_derivatives(made: tuple[Problem, DriveParameters], name: str) -> None:
    problem, drive = made
    x = to_scaled(drive)
    column = index(name, 16).start + JOINT
    step = 0.05 * np.eye(len(x))[column]
    change = (problem.residuals(x + step) - problem.residuals(x - step)) / 0.1
    told = problem.jacobian(x)[:, column]
    assert np.linalg.norm(change - told) < 0.2 * np.linalg.norm(change)


@pytest.mark.slow
def test_where_the_model_errs_what_was_known_counts_as_much_more(made: tuple[Problem, DriveParameters]) -> None:
    plain, drive = made
    doubt = np.where(np.arange(16) == JOINT, 10.0, 1.0)
    doubted = Problem(
        plain.motions, plain.player, np.full(16, 6e-5), prior_center(drive, drive), "known", every=40, length=SHORT,
        residual=doubt,
    )  # fmt: skip
    np.testing.assert_array_equal(plain.prior, plain.known)
    np.testing.assert_array_equal(doubted.known, plain.known)
    more = np.diag(doubted.prior) / np.diag(plain.prior)
    own = [index(name, 16).start + JOINT for name in ("torque_constant", "damping", "load_friction", "offset")]
    np.testing.assert_allclose(more[own], 10.0 * np.sqrt(SHORT / 3))
    masses = index("mass_scale", 16)
    assert (more[masses] == 1.0).all()
    of_it = np.arange(len(more)) % 16 == JOINT
    of_it[index("delay", 16)] = False
    np.testing.assert_allclose(more[~of_it], 1.0)
