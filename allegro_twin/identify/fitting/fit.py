"""Output error: the drive with which the model, given the recorded commands, moves as the hand did."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from allegro_twin.identify.fitting.descent import descend
from allegro_twin.identify.fitting.problem import Masses, Problem, at_model, index
from allegro_twin.identify.fitting.shooting import PIECE
from allegro_twin.identify.fitting.spread import Spread, mass_variance, spread
from allegro_twin.identify.motions.motion import Motion, noise_floor
from allegro_twin.sim.windows import STEP, Parameters, Player
from allegro_twin.types import Array, Vector

Friction: TypeAlias = Literal["coulomb", "lugre", "auto"]
FEW = 30
"""Pieces to begin with."""
COARSE, BREAKING = 2, 8
"""Rounds of new derivatives at most: roughly, and the same where friction breaks away."""
FINE = {False: 1, True: 3}
"""In the end, by whether friction breaks away: where it does not the rough solution is near enough for one."""
ROUGHLY, FINELY = 0.1, 0.05
"""The share of its cost that a round must gain some finger for another one."""
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
    motions: list[Motion],
    start: Parameters,
    slow: Parameters,
    nominal: Parameters,
    masses: Masses,
    friction: Friction = "auto",
) -> Fit:
    """From where the regression ended, for friction that breaks away from `slow`; first roughly on some pieces, with
    either friction, then on all."""
    floor = np.median([noise_floor(motion) for motion in motions], axis=0)
    center, spec, period = at_model(nominal, start), motions[0].spec, motions[0].period

    coarse = max(1, round(sum(len(motion.position) for motion in motions) / PIECE / FEW))

    def problem(bristly: bool, every: int) -> Problem:
        step = STEP[False] if every > 1 else None  # Roughly in longer steps.
        return Problem(motions, Player(spec, period, step, bristly=bristly), floor, center, masses, every)

    rough, bristly = descend(problem(False, coarse), start, COARSE, ROUGHLY), False
    if friction == "lugre" or (friction == "auto" and rough.left > SUSPICIOUS):
        other = descend(problem(True, coarse), slow, BREAKING, ROUGHLY)
        bristly = friction == "lugre" or other.left < rough.left
        rough = other if bristly else rough
    whole = problem(bristly, 1)
    last = descend(whole, rough.drive, FINE[bristly], FINELY)
    spreads = spread(whole, last, rough.drive, masses)
    covariance = spreads.covariance + mass_variance(whole, spreads)
    return Fit(last.drive, start, spreads, covariance, floor, masses, len(whole.cuts.recording), bristly)
