"""Levenberg-Marquardt method, finger by finger: one that is stuck does not hold up the others.

Fingers share nothing but the delay and the tilt of the palm. A step is solved for all at once, with damping for each
finger; where a finger's cost rises its old parameters stay. A piece in which a finger slips where the model sticks is
off by tens of the noise, which no derivative shows. Its weight is w = 1 / (1 + c / (LARGE² median c)), c: its mean
square (Cauchy's). A piece that is about to slip responds to the smallest change, so also to every error of the model.
It has a further weight of 1 / (1 + s / (LARGE² median s)), s: the mean square of its derivatives, parameters in their
units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.open_loop import DriveParameters
from allegro_twin.twin.identify.fitting.problem import Problem
from allegro_twin.types import Array, Vector

LARGE = 3.0
"""Times the root mean square of the median piece: a piece that is off by more counts less."""
STEPS = 5
"""Steps with the same derivatives: near the solution they hardly change, and they cost most of the time."""
LONGEST = 1.0
"""Longest step, in the units of the parameters: further away derivatives say little, and a narrow valley is left."""
_FIRST, _MORE, _LESS = 1e-3, 8.0, 0.2  # Initial damping, and its factor after a worse or a better step.


class DescentResult(NamedTuple):
    """Result of a descent."""

    drive: DriveParameters
    jacobian: Array
    """Jacobian of the residuals, (rows, p), where the last steps began, times `weight`."""
    residuals: Vector
    """Without weights, (rows,)."""
    weight: Vector
    """Weight of each row of the jacobian, (rows,)."""
    left: float
    """Weighted root mean square of the residuals, in standard deviations of the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class _Costs:
    """Mean squares of each piece's fingers, and the scale above which they count less."""

    pieces: tuple[Vector, ...]
    """One row per finger, (w,)."""
    scale: Vector
    """(fingers,)"""
    calm: tuple[Vector, ...]
    """Weights of pieces that are about to slip, (w,) each."""
    prior: Vector
    """What the prior charges, (fingers,), in the unit of `total`."""

    @property
    def weights(self) -> list[Vector]:
        each = zip(self.pieces, self.scale, self.calm, strict=True)
        return [calm / (1.0 + mean / scale) for mean, scale, calm in each]

    def total(self) -> Vector:
        """Cost of each finger, (fingers,): the mean over its rows."""
        each = zip(self.pieces, self.scale, self.calm, strict=True)
        data = np.array([float((scale * calm * np.log1p(mean / scale)).mean()) for mean, scale, calm in each])
        return data + self.prior

    @property
    def left(self) -> float:
        weight = np.concatenate(self.weights)
        return float(np.sqrt((weight * np.concatenate(self.pieces)).sum() / weight.sum()))


def descend(
    problem: Problem, drive: DriveParameters, rounds: int, enough: float, *, anew: bool = False
) -> DescentResult:
    """Descend for at most `rounds` rounds of new derivatives and new starts of the pieces; stop where a round gains no
    finger the share `enough` of its cost. `anew`: derivatives joint by joint in every round."""
    damping = np.full(len(problem.fingers), _FIRST)
    for number in range(rounds):
        if anew:
            problem.shooting.reset_sensitivities()
        problem.shooting.prepare(drive)
        problem.shooting.improve_starts(drive)
        x = problem.x_of(drive)
        J, r = problem.jacobian(x), problem.residuals(x)
        costs = _costs(problem, r, _calm(problem, J))
        before, weight = costs.total(), _rows(problem, costs)
        x, r, costs = _steps(problem, x, r, J * weight[:, None], weight, costs, damping)
        drive = problem.drive_of(x)
        if number + 1 == rounds or not (costs.total() < (1.0 - enough) * before).any():
            break
    weight = _rows(problem, costs)
    return DescentResult(drive, J * weight[:, None], r, weight, costs.left)


def standing_cost(problem: Problem, drive: DriveParameters, scale: Vector | None = None) -> tuple[float, Vector]:
    """The cost of a drive as it is, with the best starts of the pieces; and each finger's scale above which its pieces
    count less. Costs are comparable with the same scale only."""
    problem.shooting.prepare(drive)
    problem.shooting.improve_starts(drive)
    problem.shooting.prepare(drive)
    residuals = problem.residuals(problem.x_of(drive))
    costs = _costs(problem, residuals, tuple(np.ones((len(problem.fingers), len(problem.cuts.recording)))), scale)
    return float(costs.total().sum()), costs.scale


def _steps(
    problem: Problem, x: Vector, r: Vector, J: Array, weight: Vector, costs: _Costs, damping: Vector
) -> tuple[Vector, Vector, _Costs]:
    """STEPS steps from `x`, with the weights and derivatives of its beginning. `damping`, of each finger, is
    updated."""
    normal, now = _normal(problem, J), costs.total()
    for _ in range(STEPS):
        gradient = J.T @ (weight * r)
        tried = x + _step(problem, x, normal, gradient, damping)
        residuals = problem.residuals(tried)
        found = _costs(problem, residuals, costs.calm, costs.scale)
        better = found.total() <= now
        damping *= np.where(better, _LESS, _MORE)
        if not better.any():
            continue
        for finger in np.flatnonzero(~better):
            own = problem.columns(int(finger))
            tried[own] = x[own]
        residuals = residuals if better.all() else problem.residuals(tried)
        found = _costs(problem, residuals, costs.calm, costs.scale)
        if len(problem.shared) > 1 and found.total().sum() > now.sum():
            damping *= _MORE  # A lean that suits one finger has to suit the others, too.
            continue
        x, r, costs, now = tried, residuals, found, found.total()
    return x, r, costs


def _normal(problem: Problem, J: Array) -> Array:
    """JᵀJ, (p, p); rows of one finger have columns of their own and those that all share."""
    found: Array = problem.prior.T @ problem.prior
    for number, rows in problem.parts():
        columns = np.concatenate([problem.columns(number), problem.shared])
        own = J[rows][:, columns]
        found[np.ix_(columns, columns)] += own.T @ own
    return found


def _step(problem: Problem, x: Vector, normal: Array, gradient: Vector, damping: Vector) -> Vector:
    """Step of all free parameters. A parameter that would leave its range goes to its bound, and the others are solved
    for again."""
    more = np.zeros(len(x))
    for finger, own in enumerate(damping):
        more[problem.columns(finger)] = own
    if len(problem.shared) > 1:
        more[problem.shared[1:]] = damping.max()
    damped = normal + np.diag(more * np.diag(normal))
    free: NDArray[np.bool_] = np.zeros(len(x), bool)
    free[problem.active] = True
    step = np.zeros(len(x))
    for _ in range(2):
        held = np.flatnonzero(~free)
        right = -gradient[free] - damped[np.ix_(free, held)] @ step[held]
        step[free] = np.linalg.solve(damped[np.ix_(free, free)], right)
        out = free & (x + step < problem.least)
        step[out] = problem.least[out] - x[out]
        free &= ~out
        if not out.any():
            break
    step = np.maximum(x + step, problem.least) - x
    for finger in range(len(damping)):
        own = problem.columns(finger)
        step[own] *= min(1.0, LONGEST / max(float(np.abs(step[own]).max()), 1e-12))
    return np.asarray(step)


def _calm(problem: Problem, J: Array) -> tuple[Vector, ...]:
    """Weights of each finger's pieces, (w,) each, by how much they respond to its parameters."""
    w, found = len(problem.cuts.recording), []
    for number, rows in problem.parts():
        lever = np.square(J[rows][:, problem.columns(number)]).sum(axis=1).reshape(w, -1).mean(axis=1)
        found.append(1.0 / (1.0 + lever / (LARGE**2 * _usual(lever))))
    return tuple(found)


def _costs(problem: Problem, r: Vector, calm: tuple[Vector, ...], scale: Vector | None = None) -> _Costs:
    w = len(problem.cuts.recording)
    pieces = tuple(np.square(r[rows].reshape(w, -1)).mean(axis=1) for _, rows in problem.parts())
    if scale is None:
        scale = np.array([LARGE**2 * _usual(each) for each in pieces])
    known = np.square(r[len(r) - len(problem.prior) :])
    prior = np.array([known[problem.columns(k)].sum() / (rows.stop - rows.start) for k, rows in problem.parts()])
    return _Costs(pieces, scale, calm, prior)


def _usual(pieces: Vector) -> float:
    """Mean square of the median piece that is trusted at all."""
    trusted = pieces[pieces > 0.0]
    return float(np.median(trusted)) if len(trusted) else 1.0


def _rows(problem: Problem, costs: _Costs) -> Vector:
    """Square root of the piece's weight for every row, prior rows included."""
    w = len(problem.cuts.recording)
    found = []
    for weight, (number, _) in zip(costs.weights, problem.parts(), strict=True):
        found.append(np.repeat(np.sqrt(weight), problem.shooting.rows(problem.fingers[number])))
    assert all(len(each) % w == 0 for each in found)
    return np.concatenate([*found, np.ones(len(problem.prior))])
