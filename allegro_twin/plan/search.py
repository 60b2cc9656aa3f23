"""From proposals to grasps that hold: rounds of guessing, of closing in physics, of draws, and of whole trials."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from allegro_twin.build.trials import PERIOD, Bench, Case
from allegro_twin.evaluate.scenario import PhysicsSettings, Protocol, Scenario, load_protocol
from allegro_twin.evaluate.timeline import stage
from allegro_twin.evaluate.uncertainty import Uncertainty, draws
from allegro_twin.library.gains import load_gains
from allegro_twin.library.grasps import Grasp
from allegro_twin.plan.candidate import Candidate, different
from allegro_twin.plan.closing import COARSE, FINE
from allegro_twin.plan.confirm import grasp_of, scenario_of
from allegro_twin.plan.propose import Proposer
from allegro_twin.plan.quick import Outcome, Performer, squeezed, tried
from allegro_twin.plan.surface import Random
from allegro_twin.plan.symmetry import symmetry
from allegro_twin.sim.statics import hand_model
from allegro_twin.sim.workbench import Workbench
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

FEW, ELITE = 4, 10
"""Where fewer than the first pass in a round, half of the next one are variations of those that came furthest."""
TIMESTEP = 0.002
"""s, the physics step of what is only a search."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much a round looks at."""

    guessed: int = 192
    """Proposals."""
    closed: int = 48
    """The best of them, which physics closes."""
    drawn: int = 10
    """The best of those that hold, which are tried under draws."""
    squeezes: tuple[float, ...] = (1.2, 1.7)
    """Factors on the squeeze among which draws choose: little slips, much rolls the object out of the fingers."""
    first: int = 2
    """Draws that everybody gets."""
    more: int = 6
    """Draws that the best few get after them."""


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A grasp that held in the whole trial."""

    candidate: Candidate
    scenario: Scenario
    grasp: Grasp
    success: float
    """Share of the search's own draws in which it held."""
    margin: float
    """Of the whole trial."""
    stall: float
    """Share of the time that its most loaded joint spends at its torque limit."""


@dataclass(slots=True)
class Search:
    """Looks for grasps of one object with one hand. Raises ConfigError for one that has no surface."""

    scenario: Scenario
    spec: HandSpec
    templates: Sequence[Grasp]
    folder: Path = Path()
    seed: int = 0
    uncertainty: Uncertainty = field(default_factory=lambda: Uncertainty(position=0.005, torque=0.0))
    effort: Effort = Effort()
    threads: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    """Where candidates ended."""

    def run(
        self, n: int, seconds: float, tell: Callable[[list[Planned], float], None] = lambda found, at: None
    ) -> list[Planned]:
        """The best `n` that are apart from each other, after at most about `seconds`; fewer where there are fewer."""
        began, found = time.monotonic(), list[Planned]()
        protocol = load_protocol(self.scenario.protocol)
        bench, random = self._bench(protocol), np.random.default_rng(self.seed)
        turns, friction = _turns(protocol), protocol.friction or self.scenario.friction
        step = FINE if protocol.floating else COARSE
        proposer = Proposer(bench, self.templates, friction, turns, random, step)
        proposed, elite = proposer.fresh(), list[Outcome]()
        while len(self._best(found, bench)) < n and (left := seconds - (time.monotonic() - began)) > 0.0:
            guessed = sorted(_within(proposed, self.effort.guessed, left / 3), key=lambda c: -c.score)
            if not guessed:
                break
            varied = proposer.near([outcome.candidate for outcome in elite], self.effort.closed // 2)
            closed, prove = [*varied, *guessed[: self.effort.closed - len(varied)]], self._drawn
            if protocol.floating:
                passed, prove = self._squeezed(closed, protocol, random), self._pushed
            else:
                outcomes = tried(bench, closed, self._performer(protocol), friction, random)
                self.ends.update(outcome.where for outcome in outcomes)
                passed = [outcome.candidate for outcome in outcomes if outcome.passed]
                elite = _elite(elite, outcomes) if len(passed) < FEW else []
            found += prove(self._apart(passed, found, bench), bench, n)
            tell(self._best(found, bench), time.monotonic() - began)
        return self._best(found, bench)[:n]

    def _squeezed(self, candidates: list[Candidate], protocol: Protocol, random: Random) -> list[Candidate]:
        """In the air nothing holds the object while fingers close: they are told to meet it all at once."""
        gains = load_gains(protocol.gains or "default", self.spec)
        further = squeezed(np.array([c.closing for c in candidates]), self.spec, gains, random)
        return [
            replace(c, squeeze=np.clip(c.close + more, self.spec.lower, self.spec.upper))
            for c, more in zip(candidates, further, strict=True)
        ]

    def _bench(self, protocol: Protocol) -> Workbench:
        physics = protocol.physics if protocol.floating else PhysicsSettings()
        coarse = protocol.model_copy(update={"physics": physics.model_copy(update={"timestep": TIMESTEP})})
        return Workbench(self.spec, stage(self.scenario, coarse, self.spec.side, self.folder))

    def _performer(self, protocol: Protocol) -> Performer:
        return Performer(load_gains(protocol.gains or "default", self.spec), hand_model(self.spec).gravity_torque)

    def _apart(self, passed: list[Candidate], found: list[Planned], bench: Workbench) -> list[Candidate]:
        """The best of each place, none of which is where something was found."""
        turns, kept = self._symmetry(bench), list[Candidate]()
        taken = [each.candidate for each in found if each.success >= 0.8]
        for candidate in sorted(passed, key=lambda c: -c.score):
            if different(candidate, [*taken, *kept], turns):
                kept.append(candidate)
        return kept

    def _pushed(self, candidates: list[Candidate], bench: Workbench, n: int) -> list[Planned]:
        """Those that hold a floating object against a push along every axis."""
        templates = {grasp.name: grasp for grasp in self.templates}
        protocol = load_protocol(self.scenario.protocol)
        cases = [
            Case(scenario_of(c, bench, self.scenario), grasp_of(c, templates[c.template], bench), folder=self.folder)
            for c in candidates
        ]
        split = [case.directions() for case in cases]
        runner = Bench(self.spec, protocol.gains or "default", protocol.period or PERIOD, self.threads)
        verdicts, proven = runner.verdicts([each for directions in split for each in directions]), []
        for candidate, case, directions in zip(candidates, cases, split, strict=True):
            mine = [next(verdicts) for _ in directions]
            held = all(verdict.held for verdict in mine)
            self.ends["held" if held else "pushed out"] += 1
            if held:
                reports = [verdict.report for verdict in mine if verdict.report is not None]
                margin = min(report.margin for report in reports)
                stall = max(max(report.at_limit.values()) for report in reports)
                proven.append(Planned(candidate, case.scenario, case.grasp, 1.0, margin, stall))
        return proven

    def _drawn(self, candidates: list[Candidate], bench: Workbench, n: int) -> list[Planned]:
        """Of each candidate the squeeze that holds most draws, and of those the best in the whole trial."""
        candidates = candidates[: self.effort.drawn]
        templates = {grasp.name: grasp for grasp in self.templates}
        options = [
            (c, scenario_of(c, bench, self.scenario), grasp_of(c, templates[c.template], bench, squeeze))
            for c in candidates
            for squeeze in self.effort.squeezes
        ]
        if not options:
            return []
        first, more = self.effort.first, self.effort.more
        held = self._held(options, first, 0)
        order = np.argsort(-held, kind="stable")[: n + 3]
        again = self._held([options[i] for i in order], more, first)
        success = {int(i): (held[i] + m) / (first + more) for i, m in zip(order, again, strict=True)}
        best: dict[int, int] = {}
        for i in sorted(success, key=lambda i: -success[i]):
            best.setdefault(id(options[i][0]), i)
        chosen = sorted(best.values(), key=lambda i: -success[i])[: n + 2]
        verdicts = Bench(self.spec, threads=self.threads).verdicts(
            [Case(options[i][1], options[i][2], folder=self.folder) for i in chosen]
        )
        proven = []
        for i, verdict in zip(chosen, verdicts, strict=True):
            self.ends["held" if verdict.held else "whole trial"] += 1
            if verdict.held and verdict.report is not None:
                stall = max(verdict.report.at_limit.values())
                candidate = replace(options[i][0], score=success[i])
                proven.append(
                    Planned(candidate, options[i][1], options[i][2], success[i], verdict.report.margin, stall)
                )
        return proven

    def _held(self, options: Sequence[tuple[Candidate, Scenario, Grasp]], count: int, first: int) -> Array:
        """In how many of some draws each holds, (k,)."""
        cases = draws(self.uncertainty, count, self.seed, first)
        protocol = load_protocol("quick")
        bench = Bench(self.spec, period=protocol.period or PERIOD, threads=self.threads)
        trials = [Case(s, g, draw, protocol, self.folder) for _, s, g in options for draw in cases]
        held = np.array([float(verdict.held) for verdict in bench.verdicts(trials)])
        total: Array = held.reshape(len(options), count).sum(axis=1)
        return total

    def _symmetry(self, bench: Workbench) -> Array | None:
        """Turns that make a grasp no other one; in the air every pose of the palm is its own."""
        return None if load_protocol(self.scenario.protocol).floating else symmetry(bench.placed)

    def _best(self, found: list[Planned], bench: Workbench) -> list[Planned]:
        """In order, apart from each other."""
        turns, kept = self._symmetry(bench), list[Planned]()
        for each in sorted(found, key=lambda p: (-p.success, -p.margin)):
            if different(each.candidate, [k.candidate for k in kept], turns):
                kept.append(each)
        return kept


def _elite(before: list[Outcome], outcomes: list[Outcome]) -> list[Outcome]:
    """Those that came furthest, of which the next round tries variations."""
    return sorted([*before, *outcomes], key=lambda o: (-o.reached, -o.candidate.score))[:ELITE]


def _turns(protocol: Protocol) -> list[float]:
    """Palm's angles about its z, rad, through which the protocol turns it: before, half and all of it."""
    most = sum(phase.turn[2] for phase in protocol.phases)
    return [0.0, np.radians(most) / 2, np.radians(most)] if most else [0.0]


def _within(proposed: Iterator[Candidate], count: int, seconds: float) -> list[Candidate]:
    """The next candidates, as many as come in a time."""
    found, until = list[Candidate](), time.monotonic() + seconds
    for candidate in proposed:
        found.append(candidate)
        if len(found) == count or time.monotonic() > until:
            break
    return found
