"""Output error: the drive with which the model, given the recorded commands, moves as the hand did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from allegro_twin.identify.fitting.descent import Descended, descend
from allegro_twin.identify.fitting.problem import Masses, Problem, at_model, index
from allegro_twin.identify.fitting.shooting import LONG, MEAN, SHORT
from allegro_twin.identify.fitting.spread import Spread, mass_variance, spread
from allegro_twin.identify.motions.motion import Motion, noise_floor
from allegro_twin.sim.windows import STEP, Parameters, Player
from allegro_twin.types import Array, Vector

Friction: TypeAlias = Literal["coulomb", "lugre", "auto"]
FEW = 30
"""Times 0.3 s: the motion to begin with."""


class Stage(NamedTuple):
    """A part of the descent, on some pieces of the motions."""

    every: int
    """Of how many pieces one is used; 0: of so many that FEW × 0.3 s are."""
    length: int
    """Of pieces, periods."""
    step: float
    """Of time, s."""
    rounds: int
    """Of new derivatives, at most."""
    enough: float
    """The share of its cost that a round must gain some finger for another one."""


ROUGH = {False: Stage(0, LONG, STEP[False], 2, 0.1), True: Stage(0, SHORT, 0.00075, 6, 0.1)}
"""By whether friction breaks away."""
FINE = {
    False: (Stage(1, LONG, STEP[False], 1, 0.05),),
    True: (Stage(2, SHORT, STEP[True], 2, 0.1), Stage(1, LONG, STEP[True], 2, 0.05)),
}
"""Then. Coulomb's rough solution is near enough for one round. Where friction breaks away long pieces tell most, but
only of a joint that is nearly right: another slips in them where it should stick, and no derivative knows that."""
SUSPICIOUS = 3.0
"""Times the noise: with more left over, friction is not Coulomb's."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What came out of it."""

    drive: Parameters
    start: Parameters
    """Of the regression."""
    spread: Spread
    shorter: Spread | None
    """Of the stage before the last, on shorter pieces, which tell less and are misled less; where there was one."""
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

    few = max(1, round(sum(len(motion.position) for motion in motions) / LONG / FEW))

    def problem(bristly: bool, stage: Stage) -> Problem:
        player = Player(spec, period, stage.step, bristly=bristly)
        return Problem(motions, player, floor, center, masses, stage.every or few, stage.length)

    drive, bristly = _roughly(problem, start, slow, friction)
    spreads = []
    for stage in FINE[bristly]:
        whole = problem(bristly, stage)
        last = descend(whole, drive, stage.rounds, stage.enough)
        spreads.append(spread(whole, last, drive, masses))
        drive = last.drive
    covariance = spreads[-1].covariance + mass_variance(whole, spreads[-1])
    shorter = spreads[-2] if len(spreads) > 1 else None
    return Fit(drive, start, spreads[-1], shorter, covariance, floor, masses, len(whole.cuts.recording), bristly)


def _roughly(
    problem: Callable[[bool, Stage], Problem], start: Parameters, slow: Parameters, friction: Friction
) -> tuple[Parameters, bool]:
    """A drive by some of the motion, and whether its friction breaks away. By itself (`auto`) it does where Coulomb's
    leaves more than SUSPICIOUS and Schwarz's criterion (1978), on the same pieces, prefers it."""
    stage = ROUGH[False]
    first = descend(problem(False, stage), start, stage.rounds, stage.enough)
    if friction == "coulomb" or (friction == "auto" and first.left <= SUSPICIOUS):
        return first.drive, False
    stage, found = ROUGH[True], {}
    for bristly, drive in ((False, first.drive), (True, slow)):
        if bristly or friction == "auto":
            own = problem(bristly, stage)
            last = descend(own, drive, stage.rounds, stage.enough)
            found[_information(own, last)] = last.drive, bristly
    return found[min(found)]


def _information(problem: Problem, found: Descended) -> float:
    """Schwarz's: n ln(mean square) + p ln n, of n residuals and p parameters that move."""
    n = problem.cuts.measured.size // MEAN
    return 2.0 * n * float(np.log(found.left)) + len(problem.active) * float(np.log(n))
