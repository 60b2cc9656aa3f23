"""Output error: the drive with which the model, given the recorded commands, moves as the hand did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from allegro_twin.sim.open_loop import STEP, DriveParameters, OpenLoopPlayer
from allegro_twin.twin.identify.fitting.levenberg_marquardt import descend, standing
from allegro_twin.twin.identify.fitting.parameterisation import index
from allegro_twin.twin.identify.fitting.problem import Masses, Problem, at_model
from allegro_twin.twin.identify.fitting.shooting import LONG, MEAN, SHORT
from allegro_twin.twin.identify.fitting.spread import Spread, mass_variance, spread
from allegro_twin.twin.identify.motions.motion import Motion, noise_floor
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
"""By whether friction breaks away or links are loose."""


class Kind(NamedTuple):
    """Of a model."""

    bristly: bool
    """Friction breaks away; otherwise it is Coulomb's."""
    loose: bool
    """There is backlash."""


COULOMB = Kind(bristly=False, loose=False)
FINE = {
    False: (Stage(1, LONG, STEP[False], 1, 0.05),),
    True: (Stage(2, SHORT, STEP[True], 2, 0.1), Stage(1, LONG, STEP[True], 2, 0.05)),
}
"""Then, by whether friction breaks away or links are loose. Coulomb's rough solution is near enough for a round. Where
friction breaks away long pieces tell most, but only of a joint that is nearly right: another slips in them where it
should stick, and no derivative knows that. Loose links take 2.3 times the time a step, but of half the pieces three
hands were two times as far off in the open loop."""
PLAIN = 1.3
"""Times the noise: with so much left over nothing more is to be explained."""
SUSPICIOUS = 3.0
"""Times the noise: with more left over, friction is not Coulomb's."""


PLAYS = (0.001, 0.004)
"""rad, tried in all joints at once: half of the first is the least that is seen."""
GAIN = 0.1
"""The share of the cost that backlash must take away before it is descended to. Ours."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What came out of it."""

    drive: DriveParameters
    start: DriveParameters
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
    loose: bool
    """Whether there is backlash."""

    def player(self, motion: Motion) -> OpenLoopPlayer:
        """What plays a motion with this drive."""
        return OpenLoopPlayer(motion.spec, motion.period, bristly=self.bristly, loose=self.loose)

    def columns(self, name: str) -> slice:
        return index(name, len(self.floor))


def fit(
    motions: list[Motion],
    start: DriveParameters,
    slow: DriveParameters,
    nominal: DriveParameters,
    masses: Masses,
    friction: Friction = "auto",
) -> Fit:
    """From where the regression ended, for friction that breaks away from `slow`; first roughly on some pieces, with
    either friction, with backlash where that tells more, then on all."""
    floor = np.median([noise_floor(motion.position) for motion in motions], axis=0)
    center, spec, period = at_model(nominal, start), motions[0].spec, motions[0].period

    few = max(1, round(sum(len(motion.position) for motion in motions) / LONG / FEW))

    def problem(kind: Kind, stage: Stage) -> Problem:
        player = OpenLoopPlayer(spec, period, stage.step, bristly=kind.bristly, loose=kind.loose)
        return Problem(motions, player, floor, center, masses, stage.every or few, stage.length)

    drive, kind = _roughly(problem, start, slow, friction)
    spreads = []
    for stage in FINE[kind.bristly or kind.loose]:
        whole = problem(kind, stage)
        # What a joint takes from others changes with the teeth that touch.
        last = descend(whole, drive, stage.rounds, stage.enough, anew=kind.loose)
        spreads.append(spread(whole, last, drive, masses))
        drive = last.drive
    covariance = spreads[-1].covariance + mass_variance(whole, spreads[-1])
    shorter = spreads[-2] if len(spreads) > 1 else None
    return Fit(drive, start, spreads[-1], shorter, covariance, floor, masses, len(whole.cuts.recording), *kind)


Problems: TypeAlias = Callable[[Kind, Stage], Problem]


class _Tried(NamedTuple):
    """A model that was descended with, on short pieces."""

    information: float
    """Schwarz's: n ln(mean square) + p ln n, of n residuals and p parameters that move; the least is the best."""
    left: float
    drive: DriveParameters
    kind: Kind

    def least(self) -> float:
        return self.information


def _roughly(
    problem: Problems, start: DriveParameters, slow: DriveParameters, friction: Friction
) -> tuple[DriveParameters, Kind]:
    """A drive by some of the motion, and of which kind its model is. By itself (`auto`) friction breaks away where
    Coulomb's leaves more than SUSPICIOUS, and links are loose where more than PLAIN is left and backlash would take
    away some of that; among what was tried, on the same pieces, Schwarz's criterion (1978) chooses."""
    stage = ROUGH[False]
    first = descend(problem(COULOMB, stage), start, stage.rounds, stage.enough)
    if first.left <= PLAIN and friction != "lugre":
        return first.drive, COULOMB
    begun = [(first.drive, COULOMB)] if friction != "lugre" else []
    if friction == "lugre" or (friction == "auto" and first.left > SUSPICIOUS):
        begun.append((slow, Kind(True, False)))
    tried = [_tried(problem, drive, kind) for drive, kind in begun]
    best = min(tried, key=_Tried.least)
    if best.left > PLAIN and (play := _play(problem, best)):
        row = np.full(len(best.drive.backlash), play)
        loose = [_tried(problem, replace(o.drive, backlash=row), Kind(o.kind.bristly, True)) for o in tried]
        best = min(best, *loose, key=_Tried.least)
    return best.drive, best.kind


def _tried(problem: Problems, drive: DriveParameters, kind: Kind) -> _Tried:
    stage = ROUGH[True]
    own = problem(kind, stage)
    last = descend(own, drive, stage.rounds, stage.enough)
    n = own.cuts.measured.size // MEAN
    information = 2.0 * n * float(np.log(last.left)) + len(own.active) * float(np.log(n))
    return _Tried(information, last.left, last.drive, kind)


def _play(problem: Problems, best: _Tried) -> float:
    """The one of PLAYS, rad, with which a drive that was fitted without is off least; 0 where none makes it better."""
    stage, costs = ROUGH[True], {}
    before, scale = standing(problem(best.kind, stage), best.drive)
    for play in PLAYS:
        drive = replace(best.drive, backlash=np.full(len(best.drive.backlash), play))
        costs[play], _ = standing(problem(best.kind._replace(loose=True), stage), drive, scale)
    least = min(costs, key=lambda play: costs[play])
    return least if costs[least] < (1.0 - GAIN) * before else 0.0
