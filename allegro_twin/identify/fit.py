"""Output error: the drive with which the model, given the recorded commands, moves as the hand did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares  # type: ignore[import-untyped]  # Its types are a package of their own.

from allegro_twin.identify.motion import Motion, noise_floor
from allegro_twin.identify.problem import Masses, Problem, at_model, index
from allegro_twin.identify.spread import Spread, mass_variance, spread
from allegro_twin.sim.windows import Parameters, Player
from allegro_twin.types import Array, Vector

COARSE = 3
"""First only every third piece."""
COARSELY, FINELY = 4, 8
"""Evaluations at most, of which the later ones need no derivatives."""


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


def fit(motions: list[Motion], player: Player, start: Parameters, nominal: Parameters, masses: Masses) -> Fit:
    """From where the regression ended; first roughly on some pieces, then on all."""
    floor = np.median([noise_floor(motion) for motion in motions], axis=0)
    center, drive = at_model(nominal, start), start
    for every in (COARSE, 1):
        problem = Problem(motions, player, floor, center, masses, every)
        problem.shooting.prepare(drive)
        problem.shooting.better_starts(drive)
        first = problem.x_of(drive)
        jacobian = problem.jacobian if every > 1 else _kept(problem.jacobian(first))
        found = least_squares(
            problem.residuals,
            first,
            jacobian,
            bounds=(problem.least, np.inf),
            max_nfev=COARSELY if every > 1 else FINELY,
            xtol=1e-5,
            ftol=1e-7,
        )
        drive = problem.drive_of(found.x)
    spreads = spread(problem, drive, found.jac, found.fun, masses)
    whole = spreads.covariance + mass_variance(problem, spreads)
    return Fit(drive, start, spreads, whole, floor, masses, len(problem.cuts.recording), player.bristly)


def _kept(jacobian: Array) -> Callable[[Vector], Array]:
    """The same derivatives everywhere: near the solution they hardly change, and they cost all the time."""
    return lambda x: jacobian
