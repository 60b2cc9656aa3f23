"""Output error fit: the drive with which the model, given the recorded commands, moves as the hand did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from allegro_twin.sim.open_loop import BEFORE, STEP, DriveParameters, OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.extra_terms import NO_EXTRAS, ExtraTerms, screen_terms
from allegro_twin.twin.identify.fitting.levenberg_marquardt import DescentResult, descend, standing_cost
from allegro_twin.twin.identify.fitting.parameterisation import index
from allegro_twin.twin.identify.fitting.problem import Masses, Problem, prior_center
from allegro_twin.twin.identify.fitting.regress import regress_presliding
from allegro_twin.twin.identify.fitting.shooting import LONG, MEAN, SHORT
from allegro_twin.twin.identify.fitting.spread import NORMAL, Spread, mass_variance, spread
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.types import Array, Vector

Friction: TypeAlias = Literal["coulomb", "lugre", "auto"]
FEW = 30
"""Times 0.3 s: the motion to begin with."""


class FitStage(NamedTuple):
    """A part of the descent, on some pieces of the motions."""

    every: int
    """Uses one of this many pieces; 0: as many pieces as make FEW × 0.3 s."""
    length: int
    """Length of the pieces, periods."""
    step: float
    """Time step, s."""
    rounds: int
    """Most rounds of new derivatives."""
    enough: float
    """Share of its cost that some finger must gain in a round for another round."""


ROUGH = {False: FitStage(0, LONG, STEP[False], 2, 0.1), True: FitStage(0, SHORT, 0.00075, 6, 0.1)}
"""First stage, by whether friction breaks away or links are loose."""
NEAR = FitStage(0, SHORT, STEP[False], 6, 0.1)
"""First stage with extra terms: in long pieces a joint with another torque slips where it should stick."""


class ModelKind(NamedTuple):
    """Kind of model."""

    bristly: bool
    """Friction breaks away; otherwise it is Coulomb's."""
    loose: bool
    """Links have backlash."""
    extras: ExtraTerms = NO_EXTRAS
    """Terms that some joints have besides."""
    elastic: bool = False
    """Teeth bend."""
    far: bool = False
    """Friction gives far before it slides (Dahl 1968)."""

    def player(self, spec: HandSpec, period: float, step: float | None = None) -> OpenLoopPlayer:
        """The model that plays motions."""
        parasitic, warming = self.extras.parasitic, self.extras.warming
        return OpenLoopPlayer(
            spec, period, step, bristly=self.bristly, loose=self.loose, parasitic=parasitic, warming=warming
        )


COULOMB = ModelKind(bristly=False, loose=False)
FINE = {
    False: (FitStage(1, LONG, STEP[False], 1, 0.05),),
    True: (FitStage(2, SHORT, STEP[True], 2, 0.1), FitStage(1, LONG, STEP[True], 2, 0.05)),
}
"""Later stages, by whether friction breaks away or links are loose. Coulomb's rough solution is near enough for one
round. With breakaway friction long pieces say most, but only of a joint that is nearly right: a wrong one slips in them
where it should stick, and no derivative shows that. Loose links take 2.3 times the time per step; with half the pieces
three hands were twice as far off in the open loop."""
FURTHER = FitStage(1, LONG, STEP[False], 3, 0.05)
"""Later stage of Coulomb's friction with extra terms, whose rough solution is from short pieces."""
PLAIN = 1.3
"""Times the noise: with this much left over there is nothing more to explain."""
SUSPICIOUS = 3.0
"""Times the noise: with more left over, friction is not Coulomb's."""


OTHER_DELAYS = (-0.002, -0.001, -0.0005, 0.0005, 0.001, 0.002)
"""s, beside the one that was found."""
UNSEEN_BUMPS = 2.0
"""Times the roughness that shows at so few delays. Ours."""
PLAYS = (0.001, 0.004)
"""rad, tried in all joints at once: half of the first is the least that is visible."""
BENT = 0.05
"""rad/(N·m), of teeth that bend, to begin with."""
GAIN = 0.1
"""Share of the cost that backlash must remove before the fit includes it. Ours."""


@dataclass(frozen=True, slots=True, eq=False)
class DriveFit:
    """A fitted drive."""

    drive: DriveParameters
    start: DriveParameters
    """From the regression."""
    spread: Spread
    shorter: Spread | None
    """From the stage before the last, on shorter pieces, which say less and are misled less; where there was one."""
    covariance: Array
    """(p, p), in the order of `index`; includes the uncertainty of masses that were only assumed."""
    floor: Vector
    """Noise of the reported positions, (n,), rad."""
    masses: Masses
    segments: int
    bristly: bool
    """Friction breaks away; otherwise it is Coulomb's."""
    loose: bool
    """Links have backlash."""
    extras: ExtraTerms
    """Terms that some joints have besides."""
    elastic: bool
    """Teeth bend."""
    far: bool
    """Friction gives far before it slides."""

    def player(self, motion: RecordedMotion) -> OpenLoopPlayer:
        """The model that plays a motion with this drive."""
        return ModelKind(self.bristly, self.loose, self.extras).player(motion.spec, motion.period)

    def columns(self, name: str) -> slice:
        return index(name, len(self.floor))


def fit_drive(
    motions: list[RecordedMotion],
    start: DriveParameters,
    slow: DriveParameters,
    nominal: DriveParameters,
    masses: Masses,
    friction: Friction = "auto",
) -> DriveFit:
    """Fit a drive, from the regression's result `start`, or `slow` for friction that breaks away. The fit is first
    rough, on some pieces, with either friction, and with backlash where that explains more; then on all pieces."""
    floor = np.median([motion.noise for motion in motions], axis=0)
    center, spec, period = prior_center(nominal, start), motions[0].spec, motions[0].period

    few = max(1, round(sum(len(motion.position) for motion in motions) / LONG / FEW))

    def problem(kind: ModelKind, stage: FitStage, residual: Vector | None = None) -> Problem:
        player = kind.player(spec, period, stage.step)
        middle = prior_center(nominal, presliding() or start) if kind.far else center
        return Problem(
            motions, player, floor, middle, masses, stage.every or few, stage.length, kind.extras,
            elastic=kind.elastic, far=kind.far, residual=residual,
        )  # fmt: skip

    links = COULOMB.player(spec, period)
    presliding = cache(partial(regress_presliding, motions, links, start))
    rough = _rough_fit(problem, start, slow, friction, partial(screen_terms, motions, links), presliding)
    drive, kind = rough.drive, rough.kind
    spreads, residual = [], np.full(len(floor), rough.left)
    plain = not (kind.bristly or kind.loose)
    for stage in (FURTHER,) if plain and kind.extras else FINE[not plain]:
        whole = problem(kind, stage, np.where(residual > PLAIN, residual, 1.0))
        # What a joint takes from others changes with the teeth in contact.
        last = descend(whole, drive, stage.rounds, stage.enough, anew=kind.loose)
        spreads.append(spread(whole, last, drive, masses))
        drive, residual = last.drive, spreads[-1].residual
    covariance = spreads[-1].covariance + mass_variance(whole, spreads[-1])
    covariance = _widen_by_delay(covariance, drive, rough.vague)
    shorter = spreads[-2] if len(spreads) > 1 else None
    return DriveFit(drive, start, spreads[-1], shorter, covariance, floor, masses, len(whole.cuts.recording), *kind)


Problems: TypeAlias = Callable[[ModelKind, FitStage], Problem]


class _RoughFit(NamedTuple):
    """A fit to some of the motion."""

    drive: DriveParameters
    kind: ModelKind
    left: float
    """Times the noise."""
    vague: float = 0.0
    """Half of an interval of the delay, s, in which the cost rises by less than it is rough; 0 where it only rises."""


class _Candidate(NamedTuple):
    """A model that was fitted on short pieces."""

    information: float
    """Schwarz's criterion: n ln(mean square) + p ln n, of n residuals and p free parameters; the least is the best."""
    left: float
    drive: DriveParameters
    kind: ModelKind

    def least(self) -> float:
        return self.information


def _rough_fit(
    problem: Problems,
    start: DriveParameters,
    slow: DriveParameters,
    friction: Friction,
    screen: Callable[[DriveParameters], ExtraTerms],
    presliding: Callable[[], DriveParameters | None],
) -> _RoughFit:
    """A drive from some of the motion. Where Coulomb's friction leaves no more than PLAIN, other delays are tried.
    Where it leaves more, the terms that `screen` finds are added. With `auto`, breakaway friction is tried
    where SUSPICIOUS is still left, and where that leaves as much, friction that gives far before it slides, by
    `presliding`, with the terms found beside. Backlash is tried where more than PLAIN is left and backlash
    would remove some of that; with it, teeth that bend. Schwarz's criterion (1978) chooses among the models, on
    the same pieces."""
    stage, kind = ROUGH[False], COULOMB
    coulomb = problem(COULOMB, stage)
    first = descend(coulomb, start, stage.rounds, stage.enough)
    if first.left <= PLAIN and friction != "lugre":
        return _from_other_delays(coulomb, first, stage)
    extras = screen(start)
    if extras:
        kind = ModelKind(False, False, extras)
        first = descend(problem(kind, NEAR), extras.add_to(start), NEAR.rounds, NEAR.enough)
        if first.left <= PLAIN and friction != "lugre":
            return _RoughFit(first.drive, kind, first.left)
    begun = [(first.drive, kind)] if friction != "lugre" else []
    if friction == "lugre" or (friction == "auto" and first.left > SUSPICIOUS):
        begun.append((extras.add_to(slow), kind._replace(bristly=True)))
    tried = [_try(problem, drive, each) for drive, each in begun]
    best = min(tried, key=_Candidate.least)
    if best.left > SUSPICIOUS and friction != "coulomb" and (far := presliding()) is not None:
        own = screen(far)
        tried.append(_try(problem, own.add_to(far), ModelKind(True, False, own, far=True)))
        best = min(tried, key=_Candidate.least)
    if best.left > PLAIN and (play := _find_backlash(problem, best)):
        row = np.full(len(best.drive.backlash), play)
        loose = [_try(problem, replace(o.drive, backlash=row), o.kind._replace(loose=True)) for o in tried]
        best = min(best, *loose, key=_Candidate.least)
        if best.kind.loose and best.left > PLAIN:
            bent = replace(best.drive, gear_compliance=np.full(len(row), BENT))
            best = min(best, _try(problem, bent, best.kind._replace(elastic=True)), key=_Candidate.least)
    return _RoughFit(best.drive, best.kind, best.left)


def _try(problem: Problems, drive: DriveParameters, kind: ModelKind) -> _Candidate:
    stage = ROUGH[True]
    own = problem(kind, stage)
    last = descend(own, drive, stage.rounds, stage.enough)
    n = own.cuts.measured.size // MEAN
    information = 2.0 * n * float(np.log(last.left)) + len(own.active) * float(np.log(n))
    return _Candidate(information, last.left, last.drive, kind)


def _from_other_delays(problem: Problem, last: DescentResult, stage: FitStage) -> _RoughFit:
    """Descend again from other delays with the same lag, delay + armature / damping, while one of them costs less: only
    fast commands tell these apart, and where noise in the reports makes them, the cost along that valley is rough."""
    least, scale = standing_cost(problem, last.drive)
    while True:
        tried = _at_other_delays(problem, last.drive)
        costs = [standing_cost(problem, drive, scale)[0] for drive in tried]
        if min(costs) >= least:
            break
        found = descend(problem, tried[int(np.argmin(costs))], stage.rounds, stage.enough)
        cost, _ = standing_cost(problem, found.drive, scale)
        if cost >= least:
            break
        last, least = found, cost
    away = np.array([drive.delay[0] for drive in tried]) - last.drive.delay[0]
    return _RoughFit(last.drive, COULOMB, last.left, _vagueness(away, np.array(costs) - least))


def _vagueness(away: Vector, rises: Vector) -> float:
    """Half of an interval of a delay, s, from the rises of a cost so far away from it, in order, s: where a parabola
    through the furthest ones rises by UNSEEN_BUMPS times as much as the cost falls on the way there. 0 where it only
    rises."""
    rough = 0.0
    for side in (rises[away < 0.0][::-1], rises[away > 0.0]):
        path = np.concatenate([[0.0], side])
        rough = max(rough, float((np.maximum.accumulate(path) - path).max()))
    ends = [end for end in (0, -1) if away[end] != 0.0]
    steep = max(float(np.mean([rises[end] / away[end] ** 2 for end in ends])), 1e-12)
    return min(float(np.sqrt(UNSEEN_BUMPS * rough / steep)), OTHER_DELAYS[-1])


def _at_other_delays(problem: Problem, drive: DriveParameters) -> list[DriveParameters]:
    """Drives with other delays and the same lag behind slow commands; at least half of an armature is left."""
    found, longest = [], BEFORE * problem.motions[0].period
    for delay in np.clip(drive.delay[0] + np.array(OTHER_DELAYS), 0.0, longest):
        armature = drive.armature - (delay - drive.delay) * drive.damping
        at_least = np.maximum(armature, drive.armature / 2.0)
        found.append(replace(drive, delay=np.full(len(drive.delay), delay), armature=at_least))
    return found


def _widen_by_delay(covariance: Array, drive: DriveParameters, vague: float) -> Array:
    """Widen the delay by an interval of ± `vague`, s, and the armatures that keep the lag with it."""
    n = len(drive.delay)
    along = np.zeros(len(covariance))
    along[index("delay", n)] = 1.0
    along[index("armature", n)] = -drive.damping
    return np.asarray(covariance + (vague / NORMAL) ** 2 * np.outer(along, along))


def _find_backlash(problem: Problems, best: _Candidate) -> float:
    """The one of PLAYS, rad, with which a drive that was fitted without backlash fits best; 0 where none fits
    better."""
    stage, costs = ROUGH[True], {}
    before, scale = standing_cost(problem(best.kind, stage), best.drive)
    for play in PLAYS:
        drive = replace(best.drive, backlash=np.full(len(best.drive.backlash), play))
        costs[play], _ = standing_cost(problem(best.kind._replace(loose=True), stage), drive, scale)
    least = min(costs, key=lambda play: costs[play])
    return least if costs[least] < (1.0 - GAIN) * before else 0.0
