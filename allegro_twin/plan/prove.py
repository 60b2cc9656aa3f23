"""What a candidate is worth: draws of what the hand is not told, and the whole trial; or pushes in the air."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from allegro_twin.build.trials import PERIOD, Bench, Case
from allegro_twin.evaluate.scenario import Scenario, load_protocol
from allegro_twin.evaluate.together import Measure
from allegro_twin.evaluate.uncertainty import Uncertainty, draws
from allegro_twin.library.gains import load_gains, ruled
from allegro_twin.library.grasps import Grasp
from allegro_twin.plan.candidate import Candidate, different
from allegro_twin.plan.confirm import grasp_of, scenario_of
from allegro_twin.plan.ease import SHARE, eased
from allegro_twin.plan.region import Region, there
from allegro_twin.sim.contact.workbench import Workbench
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

FIRST, MORE, MOST = 2, 6, 20
"""Draws that everybody gets, that the best get after them at a time, and that anybody gets at most."""
GOOD = 0.85
"""An expected share of draws with which a grasp is good enough."""


class Squeeze(NamedTuple):
    """How far the fingers of a candidate are told to go."""

    factor: float = 1.0
    """On what the quick test had."""
    share: float = math.inf
    """Of its torque limit that a joint holds with, at most."""


AS_IT_IS = Squeeze()
SQUEEZES = (Squeeze(1.2, SHARE), Squeeze(1.7))
"""Among which draws choose: little slips, much rolls the object out of the fingers."""
WHOLE = 4.5
"""What a whole trial costs, in quick ones."""
SPARE = 3
"""How many more than are asked for are looked at closely."""


@dataclass(slots=True, eq=False)
class Planned:
    """A grasp, and what has become of it so far."""

    candidate: Candidate
    scenario: Scenario
    grasp: Grasp
    tried: int = 0
    held: int = 0
    """Draws."""
    confirmed: bool | None = None
    """Whether the whole trial held; None: not tried."""
    sure: bool = False
    """Whether it needs no draws."""
    margin: float = float("nan")
    stall: float = float("nan")
    """Of the whole trial: what was left of its limits, and the share of its time that the most loaded joint spent at
    its torque limit."""

    @property
    def expected(self) -> float:
        """The share to expect of others: the mean of the posterior after a uniform prior."""
        return 1.0 if self.sure else (self.held + 1) / (self.tried + 2)

    @property
    def good(self) -> bool:
        return self.expected >= GOOD


@dataclass(slots=True)
class Prover:
    """Options for one object, with what is known of each."""

    bench: Workbench
    scenario: Scenario
    spec: HandSpec
    templates: Sequence[Grasp]
    folder: Path
    seed: int
    uncertainty: Uncertainty
    turns: Array | None
    """Rotations that leave the object as it is; None where every pose counts as its own."""
    region: Region | None = None
    """Where more than half of the contact force has to be."""
    threads: int = 0
    options: list[Planned] = field(default_factory=list)
    ends: Counter[str] = field(default_factory=Counter)
    pace: float = 0.1
    """s of a quick trial, from those made so far."""

    def add(self, candidates: Sequence[Candidate], n: int, deadline: float) -> None:
        """Learn about some more, and about the best of all; `n`: how many are wanted in the end; `deadline`: on the
        monotonic clock, s, by which it should be over."""
        fits = self._affordable(deadline, 2.5 * FIRST * len(SQUEEZES))
        new = [Planned(c, *self.as_files(c, squeeze)) for c in candidates[:fits] for squeeze in SQUEEZES]
        self._draw(new, FIRST)
        self.options += new
        looked = [o for o in self.ranked(self.options, n + SPARE) if o.tried < MOST and not o.good]
        self._draw(looked[: self._affordable(deadline, MORE)], MORE)
        self._confirm([o for o in self.ranked(self.options, n) if o.good and o.confirmed is None])

    def reserve(self, n: int) -> float:
        """How long the whole trials of so many take, s."""
        return n * WHOLE * self.pace

    def settle(self, n: int, deadline: float) -> None:
        """Try the best in the whole trial, and others for those that do not hold there, while there is time."""
        begun = False
        while unknown := [o for o in self.ranked(self.options, n) if o.confirmed is None]:
            fits = self._affordable(deadline, WHOLE)
            if begun and not fits:
                break
            self._confirm(unknown if not begun else unknown[:fits])
            begun = True

    def _affordable(self, deadline: float, each: float) -> int:
        """How many things there is time for that cost so many quick trials each."""
        return max(int((deadline - time.monotonic()) / (each * self.pace)), 0)

    def best(self, n: int) -> list[Planned]:
        """Those that hold in the whole trial, apart from each other, best first."""
        return best_of([option for option in self.options if option.confirmed], n, self.turns)

    def ranked(self, options: Sequence[Planned], n: int) -> list[Planned]:
        """The best of each place, of those that have not failed."""
        return best_of([option for option in options if option.confirmed is not False], n, self.turns)

    def unsure(self) -> list[Candidate]:
        """Those of the best whose variations may be better."""
        return [option.candidate for option in self.ranked(self.options, 2 * SPARE) if not option.good]

    def as_files(self, candidate: Candidate, squeeze: Squeeze) -> tuple[Scenario, Grasp]:
        """What is played of a candidate."""
        template = next(grasp for grasp in self.templates if grasp.name == candidate.template)
        grasp = grasp_of(candidate, template, self.spec, squeeze.factor)
        grasp = eased(grasp, candidate.rest, load_gains("default", self.spec), self.spec, squeeze.share)
        return scenario_of(candidate, self.bench, self.scenario), grasp

    def _draw(self, options: Sequence[Planned], count: int) -> None:
        """Try each under the next draws that it has not seen."""
        protocol, began = load_protocol("quick"), time.monotonic()
        bench = Bench(self.spec, period=protocol.period or PERIOD, threads=self.threads)
        trials = [
            Case(option.scenario, option.grasp, draw, protocol, self.folder)
            for option in options
            for draw in draws(self.uncertainty, count, self.seed, option.tried)
        ]
        verdicts = bench.verdicts(trials, hasty=True)
        for option in options:
            option.held += sum(next(verdicts).held for _ in range(count))
            option.tried += count
        if trials:
            self.pace = (time.monotonic() - began) / len(trials)

    @property
    def measure(self) -> Measure | None:
        """What tells whether an object is held where it is to be."""
        return None if self.region is None else self.region.share

    def _confirm(self, options: Sequence[Planned]) -> None:
        """Try each in the whole trial."""
        cases = [Case(option.scenario, option.grasp, folder=self.folder) for option in options]
        verdicts = Bench(self.spec, threads=self.threads).verdicts(cases, self.measure)
        for option, verdict in zip(options, verdicts, strict=True):
            option.confirmed = verdict.held and there(verdict)
            self.ends["held" if option.confirmed else "elsewhere" if verdict.held else "whole trial"] += 1
            if verdict.report is not None:
                option.margin, option.stall = verdict.report.margin, max(verdict.report.at_limit.values())


def best_of(options: Sequence[Planned], n: int, turns: Array | None) -> list[Planned]:
    """So many, best first, each apart from those before it. `turns`: rotations that leave the object as it is."""
    kept: list[Planned] = []
    for option in sorted(options, key=lambda o: (-o.expected, -o.candidate.score)):
        if len(kept) < n and different(option.candidate, [k.candidate for k in kept], turns):
            kept.append(option)
    return kept


def pushed(prover: Prover, candidates: Sequence[Candidate]) -> None:
    """Add those that hold a floating object against a push along every axis. What two of them move is not pushed along
    the others."""
    protocol = load_protocol(prover.scenario.protocol)
    gains = ruled(protocol.gains, prover.spec)
    runner = Bench(prover.spec, gains, protocol.period or PERIOD, prover.threads)
    options = [
        Planned(c, *prover.as_files(c, AS_IT_IS), confirmed=True, sure=True, margin=1.0, stall=0.0) for c in candidates
    ]
    for ways in (slice(0, 2), slice(2, None)):
        cases = [Case(o.scenario, o.grasp, folder=prover.folder).directions()[ways] for o in options]
        verdicts = runner.verdicts([case for each in cases for case in each], prover.measure, hasty=True)
        for option, each in zip(options, cases, strict=True):
            reports = [verdict.report for verdict in (next(verdicts) for _ in each) if verdict.held and there(verdict)]
            held = [report for report in reports if report is not None]
            option.confirmed = len(held) == len(each)
            option.margin = min([option.margin, *(report.margin for report in held)])
            option.stall = max([option.stall, *(max(report.at_limit.values()) for report in held)])
        prover.ends["pushed out"] += sum(not option.confirmed for option in options)
        options = [option for option in options if option.confirmed]
    prover.ends["held"] += len(options)
    prover.options += options
