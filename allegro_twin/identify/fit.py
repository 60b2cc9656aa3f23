"""Output error: the drive with which the model, given the recorded commands, moves as the hand did."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from scipy.optimize import least_squares  # type: ignore[import-untyped]  # Its types are a package of their own.

from allegro_twin.identify.motion import Motion, noise_floor
from allegro_twin.identify.problem import Masses, Problem, at_model, index
from allegro_twin.identify.shooting import PIECE
from allegro_twin.identify.spread import Spread, mass_variance, spread
from allegro_twin.sim.windows import Parameters, Player
from allegro_twin.types import Array, Vector

Friction: TypeAlias = Literal["coulomb", "lugre", "auto"]
FEW = 40
"""Pieces to begin with."""
COARSELY, BRISTLY, FINELY = 5, 30, 7
"""Evaluations at most: roughly, the same where friction breaks away, and in the end, when derivatives are held."""
EXPLAINED, AGAIN = 1.3, 2
"""Times the noise: with more left over it is tried again, at most so often, as long as that helps."""
LARGE = 5.0
"""Times the noise: residuals of friction that breaks away count less from here on, for who starts in the wrong place
sticks when the hand slips."""
SUSPICIOUS = 3.0
"""Times the noise: with more left over, friction is not Coulomb's."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What came out of it."""

    drive: Parameters
    start: Parameters
    """Of the regression."""
    spread: Spread
    covariance: Array
    """(p, p), in the order of `index`; that of masses which were only assumed is in it."""
    floor: Vector
    """Noise of the reported positions, (n,), rad."""
    masses: Masses
    pieces: int
    bristly: bool
    """Whether friction breaks away; otherwise it is Coulomb's."""

    def columns(self, name: str) -> slice:
        return index(name, len(self.floor))


def fit(
    motions: list[Motion], start: Parameters, nominal: Parameters, masses: Masses, friction: Friction = "auto"
) -> Fit:
    """From where the regression ended; first roughly on some pieces, with either friction, then on all."""
    floor = np.median([noise_floor(motion) for motion in motions], axis=0)
    center, spec, period = at_model(nominal, start), motions[0].spec, motions[0].period

    coarse = max(1, round(sum(len(motion.position) for motion in motions) / PIECE / FEW))

    def problem(bristly: bool, every: int) -> Problem:
        return Problem(motions, Player(spec, period, bristly=bristly), floor, center, masses, every)

    rough, bristly = _solved(problem(False, coarse), start, hold=False), False
    if friction == "lugre" or (friction == "auto" and rough.left > SUSPICIOUS):
        other = _solved(problem(True, coarse), start, hold=False)
        bristly = friction == "lugre" or other.left < rough.left
        rough = other if bristly else rough
    whole = problem(bristly, 1)
    last = _solved(whole, rough.drive, hold=True)
    for _ in range(AGAIN):
        if last.left < EXPLAINED:
            break
        more = _solved(whole, last.drive, hold=True)  # With derivatives and starts of where it is now.
        last, gained = (more, last.left - more.left) if more.left < last.left else (last, 0.0)
        if gained < 0.05 * last.left:
            break
    spreads = spread(whole, last.drive, last.jacobian, last.residuals, masses)
    covariance = spreads.covariance + mass_variance(whole, spreads)
    return Fit(last.drive, start, spreads, covariance, floor, masses, len(whole.cuts.recording), bristly)


class _Solved(NamedTuple):
    drive: Parameters
    jacobian: Array
    residuals: Vector
    left: float
    """Root mean square of what is left over, in standard deviations of the noise."""


def _solved(problem: Problem, drive: Parameters, *, hold: bool) -> _Solved:
    """`hold` keeps the first derivatives: near the solution they hardly change, and they cost all the time."""
    problem.shooting.prepare(drive)
    problem.shooting.better_starts(drive)
    first = problem.x_of(drive)
    active, least = problem.active, problem.least[problem.active]
    held = problem.jacobian(first)[:, active] if hold else None

    most = FINELY if hold else BRISTLY if problem.player.bristly else COARSELY

    def whole(moving: Vector) -> Vector:
        x = first.copy()
        x[active] = moving
        return x

    found = least_squares(
        lambda moving: problem.residuals(whole(moving)),
        np.maximum(first[active], least + 1e-6),
        lambda moving: problem.jacobian(whole(moving))[:, active] if held is None else held,
        bounds=(least, np.inf), max_nfev=most, xtol=1e-5, ftol=1e-7 if hold else 1e-3,
        loss="soft_l1" if problem.player.bristly else "linear", f_scale=LARGE,
    )  # fmt: skip
    data = len(found.fun) - len(problem.prior)
    left = float(np.sqrt(np.square(found.fun[:data]).mean()))
    jacobian = np.zeros((len(found.fun), len(first)))
    jacobian[:, active] = found.jac
    return _Solved(problem.drive_of(whole(found.x)), jacobian, found.fun, left)
