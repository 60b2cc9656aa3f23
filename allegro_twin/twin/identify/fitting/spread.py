"""Uncertainty of a fit: over pieces, over recordings, over time steps, and over masses that were only assumed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.sim.open_loop import DriveParameters
from allegro_twin.twin.identify.fitting.levenberg_marquardt import DescentResult
from allegro_twin.twin.identify.fitting.parameterisation import index, scaling_jacobian, to_scaled
from allegro_twin.twin.identify.fitting.problem import Masses, Problem, mass_covariance
from allegro_twin.types import Array, Vector

NORMAL = 1.96  # Standard deviations on either side of 95 %.


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Uncertainties of the p parameters in the order of `index`, in their own units."""

    covariance: Array
    """(p, p): the larger of what the noise and what the scatter of the pieces gives."""
    by_recording: Array
    """Change by leaving each recording out, (recordings, p)."""
    step: Vector
    """Change by halving the time step, (p,)."""
    path: Vector
    """Change from the rough solution to the last one, (p,). Where steps ended early, or valleys lie next to each other,
    a linear estimate at the last one is too small."""
    rest: Vector
    """Change by one more step, undamped, (p,): where the descent ended early."""
    mass: Array
    """Derivative by the masses of the links, as factors, (p, n); zero where they are known or found."""
    correlation: Array
    """Correlation from the data alone, in scaled parameters, (p, p)."""
    residual: Vector
    """Root mean square of each joint's residuals in standard deviations of the noise, (n,)."""


def spread(problem: Problem, last: DescentResult, rough: DriveParameters, masses: Masses) -> Spread:
    """Uncertainties from the last derivatives and residuals with their weights; prior rows are at their end. `rough`:
    where the descent on all pieces began."""
    drive, data, w = last.drive, len(last.residuals) - len(problem.prior), len(problem.cuts.recording)
    J, weight = last.jacobian[:data], last.weight[:data]
    r = weight * last.residuals[:data]
    information = J.T @ J + problem.prior.T @ problem.prior
    inverse: Array = np.asarray(np.linalg.inv(information), np.float64)
    gradient = _by_piece(problem, J, r)
    by_pieces = inverse @ (gradient.T @ gradient) @ inverse * w / max(w - 1, 1)
    left = max(float(r @ r) / max(data - len(inverse), 1), 1.0)
    by_noise = np.asarray(np.linalg.inv(J.T @ J / left + problem.known.T @ problem.known), np.float64)
    # The correlation of the one, the larger spread of both.
    larger = np.sqrt(np.maximum(np.diag(by_pieces) / np.diag(by_noise), 1.0))
    by = scaling_jacobian(drive)
    still = np.setdiff1d(np.arange(len(by)), problem.active)
    by[np.ix_(problem.active, still)] = 0.0  # A fixed parameter adds no uncertainty to a free one.
    raw = problem.shooting.residuals(drive)
    fine = problem.shooting.residuals(drive, problem.player.finer())
    step = -inverse @ (J.T @ (weight * problem.flat(fine - raw)))
    recordings = np.unique(problem.cuts.recording)
    without = np.array([_without_recording(problem, J, r, information, int(k)) for k in recordings])
    sd = np.sqrt(np.diag(inverse))
    return Spread(
        covariance=by @ (by_noise * np.outer(larger, larger)) @ by.T,
        by_recording=without @ by.T,
        step=by @ step,
        path=by @ (to_scaled(drive) - to_scaled(rough)),
        rest=-by @ inverse @ (J.T @ r + problem.prior.T @ last.residuals[data:]),
        mass=_mass_effect(problem, last, inverse, raw) if masses == "assumed" else np.zeros((len(by), problem.n)),
        correlation=inverse / np.outer(sd, sd),
        residual=_rms(problem, last.residuals),
    )


def _by_piece(problem: Problem, J: Array, r: Vector) -> Array:
    """Jᵀr of every piece, (w, p)."""
    w = len(problem.cuts.recording)
    total = np.zeros((w, J.shape[1]))
    for _, rows in problem.parts():
        total += np.einsum("wmp,wm->wp", J[rows].reshape(w, -1, J.shape[1]), r[rows].reshape(w, -1))
    return total


def _without_recording(problem: Problem, J: Array, r: Vector, information: Array, number: int) -> Vector:
    """Change of the parameters when one recording is left out, to first order."""
    w, chosen = len(problem.cuts.recording), problem.cuts.recording == number
    left, gradient = information.copy(), np.zeros(J.shape[1])
    for _, rows in problem.parts():
        own = J[rows].reshape(w, -1, J.shape[1])[chosen].reshape(-1, J.shape[1])
        left -= own.T @ own
        gradient += own.T @ r[rows].reshape(w, -1)[chosen].ravel()
    return np.asarray(np.linalg.solve(left, gradient))


def _mass_effect(problem: Problem, last: DescentResult, inverse: Array, raw: Array) -> Array:
    """How the best parameters follow the masses: -(JᵀJ)⁻¹ Jᵀ ∂r/∂m."""
    data = len(last.residuals) - len(problem.prior)
    J, by_mass = last.jacobian[:data], np.zeros((data, len(inverse)))
    problem.write_derivatives(last.drive, raw, "mass_scale", by_mass)
    by_mass *= last.weight[:data, None]
    part = index("mass_scale", problem.n)
    effect = -inverse @ (J.T @ by_mass[:, part]) / problem.unit[part]
    return np.asarray(scaling_jacobian(last.drive) @ effect)


def mass_variance(problem: Problem, found: Spread) -> Array:
    """What the masses add to the covariance, (p, p)."""
    return np.asarray(found.mass @ mass_covariance(problem) @ found.mass.T)


def _rms(problem: Problem, r: Vector) -> Vector:
    w, found = len(problem.cuts.recording), np.zeros(problem.n)
    for number, rows in problem.parts():
        finger = problem.fingers[number]
        own = r[rows].reshape(w, -1)[:, : problem.shooting.moments * len(finger)].reshape(-1, len(finger))
        found[finger] = np.sqrt(np.square(own).mean(axis=0))
    return found
