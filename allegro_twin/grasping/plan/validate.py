"""Validation of a candidate: draws of unknown parameters and the whole trial, or pushes in the air."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from allegro_twin.grasping.batch.batched_trials import Measure, Verdict
from allegro_twin.grasping.batch.trials import PERIOD, TrialCase, TrialRunner
from allegro_twin.grasping.plan.candidate import (
    SHARE,
    Candidate,
    ObjectSymmetry,
    candidate_grasp,
    candidate_scenario,
    is_different,
    limit_squeeze,
)
from allegro_twin.grasping.plan.region import GraspRegion, holds_in_region
from allegro_twin.grasping.scenario import Scenario, load_protocol
from allegro_twin.grasping.uncertainty import Uncertainty, sample_perturbations
from allegro_twin.hands.library.entries import LatchGrip
from allegro_twin.hands.library.gains import load_gains, protocol_gains
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import is_of_type
from allegro_twin.hands.library.taxonomy import ObservedType, claim_observed
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.spec import HandSpec

RUNGS = (2, 4, 8, 16, 32)
"""Draws: everybody gets the first so many, and the better half of those on a rung goes on to the next one."""
GOOD, SURE = 0.88, 16
"""An expected share of draws with which a grasp is good enough, and the draws that it takes to say so: of many that
hold in a few, some were lucky."""


class Squeeze(NamedTuple):
    """Squeeze of a candidate: how far its fingers are commanded to go."""

    factor: float = 1.0
    """On what the quick test had."""
    share: float = math.inf
    """Largest share of its torque limit that a joint holds with."""
    grip: LatchGrip | None = None
    """None: at a fixed posture."""


AS_IT_IS = Squeeze()
SQUEEZES = (Squeeze(1.2, SHARE), Squeeze(1.7))
"""Among which draws choose: little slips, much rolls the object out of the fingers."""
LATCHING = (
    Squeeze(1.2, 1.0, LatchGrip(kind="latch")), Squeeze(1.6, 0.7, LatchGrip(kind="latch")), Squeeze(1.0, SHARE)
)  # fmt: skip
"""Squeezes among which draws choose where torques are computed. Fingers that latch press with what was computed,
wherever they meet the object; what is heavy they may push aside while they close softly, and a fixed posture does
not."""
SPARE = 3
"""How many more than are asked for are varied."""
SEARCHED = Uncertainty(position=0.005, torque=0.0)
"""What draws of a search vary unless something else is said."""
JUDGED = 20
"""Draws on which what was chosen is judged afterwards: none of them was chosen on."""
CHOSEN, SETTLING = 16, 3
"""Draws that what is returned has had at least, where time sufficed, and how often others may step forward for
those that lose them."""
WHOLE = 4.0
"""Times as long as a draw a whole trial takes; assumed until one was made."""
WHOLE_TRIALS = 2
"""For each grasp that is asked for, when the search is over: what holds in draws but not here gives way to others."""


@dataclass(slots=True, eq=False)
class PlannedGrasp:
    """A grasp, and what has become of it so far."""

    candidate: Candidate
    scenario: Scenario
    grasp: Grasp
    tried: int = 0
    held: int = 0
    """Draws of the search."""
    judged: int = 0
    judged_held: int = 0
    """Draws that it was not chosen on, in the whole trial."""
    seed: int = 0
    candidates: int = 0
    """Seed of the search that found it, and number of candidates that physics closed there."""
    confirmed: bool | None = None
    """Whether the whole trial held; None: not tried."""
    sure: bool = False
    """Whether it needs no draws."""
    margin: float = float("nan")
    stall: float = float("nan")
    sustained: float = float("nan")
    """Loads in the whole trial: the margin that was left to its limits, the share of its time that the most loaded
    joint spent at its torque limit, and the share of its limit that the hottest joint sustains."""

    def show(self, observed: ObservedType | None) -> None:
        """Its grasp is of the type that its contacts show, and claims no other."""
        if observed is not None:
            self.grasp = replace(self.grasp, observed=observed, taxonomy=claim_observed(observed))

    @property
    def expected(self) -> float:
        """The share to expect of others: the mean of the posterior after a uniform prior."""
        return 1.0 if self.sure else (self.held + 1) / (self.tried + 2)

    @property
    def good(self) -> bool:
        return self.sure or (self.expected >= GOOD and self.tried >= SURE)


@dataclass(slots=True)
class GraspValidator:
    """Options for one object, with what is known of each."""

    bench: GraspScene
    scenario: Scenario
    spec: HandSpec
    templates: Sequence[Grasp]
    folder: Path
    seed: int
    uncertainty: Uncertainty
    symmetry: ObjectSymmetry
    """Turns of the object that make a grasp no other one."""
    region: GraspRegion | None = None
    """Where more than half of the contact force has to be."""
    kind: int | str | None = None
    """The type that the contacts have to show; None: any."""
    threads: int = 0
    options: list[PlannedGrasp] = field(default_factory=list)
    ends: Counter[str] = field(default_factory=Counter)
    drawn: Counter[str] = field(default_factory=Counter)
    """Trials so far: of `draws`, those of them that ended since a joint moved `too fast`, and `whole` ones."""
    cpu: dict[str, float] = field(default_factory=lambda: {"draws": 0.0, "whole": 0.0})
    """s that they took."""

    def add(self, candidates: Sequence[Candidate], n: int, over: Callable[[], bool] = lambda: False) -> bool:
        """Learn about some more, and about the best of all: successive halving, rung by rung, among all that stand on
        one; of those that have lost none as many as are wanted go on. `n`: how many are wanted in the end; `over`:
        whether time is up, asked before each rung but the first. Whether all rungs were climbed."""
        new = [PlannedGrasp(c, *self.as_files(c, squeeze)) for c in candidates for squeeze in self._squeezes(c)]
        self._draw(new, RUNGS[0])
        self.options += new
        for below, rung in pairwise(RUNGS):
            if over():
                return False
            standing = [o for o in self.options if o.tried == below and o.confirmed is not False]
            count = max(1, len(new) >> RUNGS.index(rung), min(n, sum(o.held == o.tried for o in standing)))
            self._draw([o for o in self.ranked(standing, count) if not o.good], rung - below)
        self._confirm([o for o in self.ranked(self.options, n) if o.good and o.confirmed is None])
        return True

    def settling_time(self, n: int) -> float:
        """CPU seconds that `settle` would take, as trials have taken so far."""
        best = self.ranked(self.options, n)
        draw = self.cpu["draws"] / max(self.drawn["draws"], 1)
        whole = self.cpu["whole"] / self.drawn["whole"] if self.drawn["whole"] else WHOLE * draw
        lacking = sum(max(CHOSEN - option.tried, 0) for option in best if not option.sure)
        return lacking * draw + sum(option.confirmed is None for option in best) * whole

    def settle(self, n: int, over: Callable[[], bool] | None = None) -> None:
        """Draw for the best until each has had as many as it takes to choose, for some hold the first by luck; and try
        them in the whole trial, and others for those that do not hold there. `over`: whether time is up; then it ends
        with the first that holds. None: time plays no part."""
        for _ in range(SETTLING):
            self._draw_enough(self.ranked(self.options, n), over)
        left = WHOLE_TRIALS * n
        while unknown := [o for o in self.ranked(self.options, n) if o.confirmed is None][:left]:
            if over is not None:
                if over() and self.best(1):
                    break
                unknown = unknown[:1]
            # Those that step forward for what the whole trial has lost may have had two draws, with luck.
            self._draw_enough(unknown, over)
            self._confirm(unknown)
            left -= len(unknown)

    def _draw_enough(self, options: Sequence[PlannedGrasp], over: Callable[[], bool] | None) -> None:
        """As many draws for each as it takes to choose, while there is time."""
        few = [option for option in options if option.tried < CHOSEN and not option.sure]
        for tried in sorted({option.tried for option in few}):
            if over is None or not over():
                self._draw([option for option in few if option.tried == tried], CHOSEN - tried)

    def best(self, n: int) -> list[PlannedGrasp]:
        """Those that hold in the whole trial, apart from each other, best first."""
        return best_grasps([option for option in self.options if option.confirmed], n, self.symmetry)

    def ranked(self, options: Sequence[PlannedGrasp], n: int) -> list[PlannedGrasp]:
        """The best of each place, of those that have not failed."""
        return best_grasps([option for option in options if option.confirmed is not False], n, self.symmetry)

    def unsure(self) -> list[Candidate]:
        """Those of the best whose variations may be better."""
        return [option.candidate for option in self.ranked(self.options, 2 * SPARE) if not option.good]

    def as_files(self, candidate: Candidate, squeeze: Squeeze) -> tuple[Scenario, Grasp]:
        """What is played of a candidate."""
        template = next(grasp for grasp in self.templates if grasp.name == candidate.template)
        grasp = candidate_grasp(candidate, template, self.spec, squeeze.factor, squeeze.grip)
        grasp = limit_squeeze(grasp, candidate.rest, load_gains("default", self.spec), self.spec, squeeze.share)
        return candidate_scenario(candidate, self.bench, self.scenario), grasp

    def _squeezes(self, candidate: Candidate) -> Sequence[Squeeze]:
        return LATCHING if candidate.torque is not None and "torque" in self.spec.commands else SQUEEZES

    def _draw(self, options: Sequence[PlannedGrasp], count: int) -> None:
        """Try each under the next draws that it has not seen."""
        protocol = load_protocol("quick")
        bench = TrialRunner(self.spec, period=protocol.period or PERIOD, threads=self.threads)
        trials = [
            TrialCase(option.scenario, option.grasp, draw, protocol, self.folder)
            for option in options
            for draw in sample_perturbations(self.uncertainty, count, self.seed, option.tried, stream="search")
        ]
        began, verdicts = time.process_time(), bench.verdicts(trials, stop_early=True)
        for option in options:
            found = [next(verdicts) for _ in range(count)]
            option.held += sum(verdict.held for verdict in found)
            option.tried += count
            self.drawn["too fast"] += sum(verdict.too_fast for verdict in found)
        self._spent("draws", len(trials), began)

    def _spent(self, what: str, trials: int, began: float) -> None:
        self.drawn[what] += trials
        self.cpu[what] += time.process_time() - began

    @property
    def measure(self) -> Measure | None:
        """What tells whether an object is held where it is to be."""
        return None if self.region is None else self.region.share

    def _confirm(self, options: Sequence[PlannedGrasp]) -> None:
        """Try each in the whole trial."""
        began = time.process_time()
        cases = [TrialCase(option.scenario, option.grasp, folder=self.folder) for option in options]
        verdicts = TrialRunner(self.spec, threads=self.threads).verdicts(cases, self.measure, stop_early=True)
        for option, verdict in zip(options, verdicts, strict=True):
            where = "whole trial" if not verdict.held else self.amiss([verdict]) or "held"
            self.ends[where] += 1
            if verdict.report is not None:
                option.show(verdict.report.observed)
                option.margin, option.stall = verdict.report.margin, verdict.report.stall
                option.sustained = verdict.report.hottest[1]
            option.confirmed = where == "held"  # Last: an interruption leaves none that is half judged.
        self._spent("whole", len(cases), began)

    def amiss(self, verdicts: Sequence[Verdict]) -> str:
        """What is wrong with something that held: `elsewhere`, or, as the first shows, an `other type`; empty where
        nothing is."""
        if not all(holds_in_region(verdict) for verdict in verdicts):
            return "elsewhere"
        seen = [verdict.report.observed for verdict in verdicts if verdict.report is not None][:1]
        if self.kind is not None and not any(each is not None and is_of_type(each, self.kind) for each in seen):
            return "other type"
        return ""


def judge_planned(
    planned: Sequence[PlannedGrasp], spec: HandSpec, uncertainty: Uncertainty, seed: int, folder: Path,
    threads: int = 0, count: int = JUDGED,
) -> None:  # fmt: skip
    """Count how often each holds in the whole trial of its own protocol, in draws that no search has seen. A
    KeyboardInterrupt leaves those that are not judged to the end as they were."""
    drawn = sample_perturbations(uncertainty, count, seed, stream="judge")
    for each in planned:
        protocol = load_protocol(each.scenario.protocol)
        bench = TrialRunner(spec, protocol_gains(protocol.gains, spec), protocol.period or PERIOD, threads)
        split = [TrialCase(each.scenario, each.grasp, draw, folder=folder).directions() for draw in drawn]
        verdicts = bench.verdicts([case for cases in split for case in cases], stop_early=True)
        held = 0
        for cases in split:
            found = [next(verdicts).held for _ in cases]
            held += all(found)
        each.judged, each.judged_held = len(split), held


def best_grasps(options: Sequence[PlannedGrasp], n: int, symmetry: ObjectSymmetry) -> list[PlannedGrasp]:
    """So many, best first, each apart from those before it."""
    kept: list[PlannedGrasp] = []
    for option in sorted(options, key=lambda o: (-o.expected, -o.candidate.score)):
        if len(kept) < n and is_different(option.candidate, [k.candidate for k in kept], symmetry):
            kept.append(option)
    return kept


def validate_in_air(prover: GraspValidator, candidates: Sequence[Candidate]) -> None:
    """Add those that hold a floating object against a push along every axis."""
    protocol = load_protocol(prover.scenario.protocol)
    gains = protocol_gains(protocol.gains, prover.spec)
    runner = TrialRunner(prover.spec, gains, protocol.period or PERIOD, prover.threads)
    options = [
        PlannedGrasp(c, *prover.as_files(c, AS_IT_IS), confirmed=True, sure=True, margin=1.0, stall=0.0)
        for c in candidates
    ]
    cases = [
        [replace(way, typed=number == 0) for number, way in enumerate(each.directions())]
        for each in (TrialCase(o.scenario, o.grasp, folder=prover.folder) for o in options)
    ]
    verdicts = runner.verdicts([case for each in cases for case in each], prover.measure, stop_early=True)
    for option, each in zip(options, cases, strict=True):
        found = [next(verdicts) for _ in each]
        reports = [verdict.report for verdict in found if verdict.held and verdict.report is not None]
        option.confirmed = len(reports) == len(each) and not prover.amiss(found)
        if option.confirmed:
            option.show(reports[0].observed)
            option.margin = min(report.margin for report in reports)
            option.stall = max(report.stall for report in reports)
            option.sustained = max(report.hottest[1] for report in reports)
    held = [option for option in options if option.confirmed]
    prover.ends["pushed out"] += len(options) - len(held)
    prover.ends["held"] += len(held)
    prover.options += held
