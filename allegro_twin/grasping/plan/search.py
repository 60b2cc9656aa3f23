"""Grasp search: rounds of proposals, closing in physics, draws and whole trials."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.grasping.plan.candidate import (
    Candidate,
    ObjectSymmetry,
    check_efforts,
    is_different,
    object_symmetry,
)
from allegro_twin.grasping.plan.close_in_simulation import (
    ClosingOutcome,
    FingerGains,
    close_candidates,
    squeeze_offsets,
)
from allegro_twin.grasping.plan.proposals.close_in_geometry import COARSE, FINE
from allegro_twin.grasping.plan.proposals.poses import Random
from allegro_twin.grasping.plan.proposals.propose import Proposer, check_region
from allegro_twin.grasping.plan.proposals.refine import Population
from allegro_twin.grasping.plan.pushing import pushed_stage, pushed_to
from allegro_twin.grasping.plan.region import GraspRegion
from allegro_twin.grasping.plan.validate import SEARCHED, GraspValidator, PlannedGrasp, validate_in_air
from allegro_twin.grasping.scenario import PhysicsSettings, Scenario, TrialProtocol, load_protocol
from allegro_twin.grasping.timeline import make_stage, place_object
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.hands.library.gains import load_gains, protocol_gains
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.sim.model.scene import Stage
from allegro_twin.spec import HandSpec, Side

FEW, ELITE = 4, 10
"""Where fewer than the first pass in a round, half of the next one are variations of those that came furthest."""
TIMESTEP = 0.002
"""s, the physics step of what is only a search."""


@dataclass(frozen=True, slots=True)
class RoundSize:
    """Size of a round of the search."""

    guessed: int = 96
    """Proposals."""
    closed: int = 48
    """The best of them, which physics closes; half as many where forces are reckoned, for most of those hold."""
    drawn: int = 20
    """The best of those that hold, which are tried under draws."""


TRIES = 400
"""Most batches of guesses in a round, `propose.BATCH` each: reached where an object leaves the hand little room."""


USUAL = 5
"""Grasps for which a round is as large as `RoundSize` says; for fewer it is smaller in proportion, for then the first
good one ends the search."""


@dataclass(frozen=True, slots=True)
class SearchBudget:
    """Budget of a search. Where little is left, a last round is smaller by the number of its candidates; one that time
    does not allow to end counts for nothing. So a search that ended after so many candidates finds the same as one that
    is told their number. The first round alone is cut short where it would take longer than all the time, in evolution
    or between two rungs of draws: `GraspSearch.cut` says so, and nobody repeats that by a number."""

    candidates: float = math.inf
    """That physics closes."""
    cpu: float = math.inf
    """s of all processors together, without what it costs to cut a mesh into pieces, once, and to judge afterwards."""


LEAST, IN_HAND = 4, 0.5
"""Candidates of a round at least, where time does not suffice for a whole one, but after a first one that was cut; and
of the time that is left, what such a round is planned for: what held before goes on under draws, whatever the round's
size."""
EVOLVING = 0.4
"""Share of the time that the first round proposes and evolves at most."""


@dataclass(slots=True)
class _Clock:
    """CPU seconds of this process."""

    budget: float
    began: float
    kept_back: float = 0.0
    """s that what comes after evolution took in the longest round so far, and that settling would take."""

    @property
    def spent(self) -> float:
        return time.process_time() - self.began

    def over(self) -> bool:
        """Whether no time is left but what is kept back."""
        return self.spent + self.kept_back >= self.budget

    def part(self, round_: float, settling: float) -> float:
        """Share of a round of so many s that fits in before settling, with a little in hand; at most all of it."""
        return min(1.0, IN_HAND * (self.budget - self.spent - settling) / max(round_, 1e-9))

    def first_over(self) -> bool:
        """Whether the first round has evolved for long enough."""
        return self.spent >= EVOLVING * self.budget


@dataclass(slots=True)
class GraspSearch:
    """Looks for grasps of one object with one hand. Raises ConfigError for one that has no surface, or none in the
    region."""

    scenario: Scenario
    spec: HandSpec
    templates: Sequence[Grasp]
    folder: Path = Path()
    seed: int = 0
    uncertainty: Uncertainty = SEARCHED
    effort: RoundSize | None = None
    """None: as large as the number of grasps needs, `RoundSize` for five and more."""
    region: GraspRegion | None = None
    """The part of the object by which it is to be held."""
    kind: int | str | None = None
    """The type of the taxonomy that its contacts have to show; None: any."""
    threads: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    """Where candidates ended."""
    drawn: Counter[str] = field(default_factory=Counter)
    """Trials that decided between them, as GraspValidator has them."""
    closed: int = 0
    """How many candidates rounds were made for, which physics has closed but where there were not so many."""
    counts: dict[int, int] = field(default_factory=dict)
    """Numbers of candidates by seed, where several searches ran in parallel."""
    cpu: float = 0.0
    """s that it took, of all processors together."""
    whole: float = math.nan
    """s of all processors that a whole trial took; NaN where none was made."""
    cut: bool = False
    """Whether its time did not suffice for one round: the same seed and as many candidates find something else."""
    interrupted: bool = False
    """Whether Ctrl-C ended it."""

    def __post_init__(self) -> None:
        if self.region is not None:
            placed = place_object(self.scenario.objects[0], self.folder)
            check_region(self.region, placed.grasp_object, np.random.default_rng(self.seed))  # As a search begins.

    def run(
        self,
        n: int,
        budget: SearchBudget,
        tell: Callable[[list[PlannedGrasp], float], None] = lambda found, share: None,
    ) -> list[PlannedGrasp]:
        """The best `n` that are apart from each other. It ends when they are good, or when the budget is spent, with
        fewer where there are fewer; at a KeyboardInterrupt, of which `interrupted` tells, with those that have held the
        whole trial by then. `tell`: what is good so far, and how much of the budget is spent. Raises ConfigError for a
        hand of which the effort of a motor is unknown."""
        check_efforts(self.spec)
        return _Rounds(self, n, budget).run(tell)

    def _proposer(self, protocol: TrialProtocol, random: Random) -> Proposer:
        reckoned = not self.spec.followers and not protocol.floating
        gains = load_gains(protocol_gains(protocol.gains, self.spec), self.spec) if reckoned else None
        at_first, stage = self._stages(protocol)
        return Proposer(
            GraspScene(self.spec, stage, at_first.objects[0].position), self.templates,
            protocol.friction or self.scenario.friction, _turns(protocol, self.spec.side), random,
            FINE if protocol.floating else COARSE, self.region, gains,
        )  # fmt: skip

    def _stages(self, protocol: TrialProtocol) -> tuple[Stage, Stage]:
        """What stands where when a trial begins, and when the hand grasps."""
        physics = protocol.physics if protocol.floating else PhysicsSettings()
        step = min(TIMESTEP, self.spec.coarsest_step)
        coarse = protocol.model_copy(update={"physics": physics.model_copy(update={"timestep": step})})
        stage = make_stage(self.scenario, coarse, self.spec.side, self.folder)
        if self.scenario.push is None:
            return stage, stage
        return stage, pushed_stage(self.scenario, stage, self.spec, self.templates[0], self.folder)


class _Candidates(NamedTuple):
    """Candidates of a round."""

    candidates: list[Candidate]
    made_for: int
    """How many it was made for: evolution may have fewer that are new."""


class _Rounds:
    """The rounds of one search, each of guesses, of what evolution makes of them, of closing, and of draws."""

    def __init__(self, search: GraspSearch, n: int, budget: SearchBudget) -> None:
        self._search, self._n, self._budget = search, n, budget
        self._protocol, self._effort = load_protocol(search.scenario.protocol), search.effort or _round_size(n)
        self._random = np.random.default_rng(search.seed)
        self._proposer = search._proposer(self._protocol, self._random)
        self._clock = _Clock(budget.cpu, time.process_time())
        self._prover = GraspValidator(
            self._proposer.bench, search.scenario, search.spec, search.templates, search.folder, search.seed,
            search.uncertainty, search_symmetry(search), search.region, search.kind, search.threads, ends=search.ends,
            drawn=search.drawn,
        )  # fmt: skip
        self._proposed, self._elite = self._proposer.fresh(), list[Candidate]()
        closed, evolves = self._effort.closed, self._proposer.gains is not None
        self._population = (
            Population(self._proposer, self._prover.symmetry, max(4, 2 * closed // 3)) if evolves else None
        )
        self._full = max(1, closed // 2 if evolves else closed)
        """Candidates that physics closes in a whole round."""
        self._dearest = self._longest = 0.0
        """s that the dearest round so far took after evolution, and the longest in all, each for a whole one."""

    def run(self, tell: Callable[[list[PlannedGrasp], float], None]) -> list[PlannedGrasp]:
        search, prover, clock = self._search, self._prover, self._clock
        try:
            self._go_round(tell)
            prover.settle(self._n, clock.over if search.cut else None)
        except KeyboardInterrupt:
            search.interrupted = True
        search.cpu = clock.spent
        if prover.drawn["whole"]:
            search.whole = prover.cpu["whole"] / prover.drawn["whole"]
        best = prover.best(self._n)
        for each in best:
            each.seed, each.candidates = search.seed, search.closed
        return best

    def _go_round(self, tell: Callable[[list[PlannedGrasp], float], None]) -> None:
        search, prover, clock, n = self._search, self._prover, self._clock, self._n
        while sum(each.good for each in prover.best(n)) < n:
            began = clock.spent
            most = self._affordable()
            if most < 1:
                break
            part = most / self._full
            clock.kept_back = part * self._dearest + prover.settling_time(n)
            found = self._candidates(most, part)
            if found is None:
                break
            if not found.candidates:
                continue  # All that evolved has been closed before: begin anew.
            evolved = clock.spent
            search.closed += found.made_for
            self._try_out(found, part)
            self._dearest = max(self._dearest, (clock.spent - evolved) / part)
            self._longest = max(self._longest, (clock.spent - began) / part)
            tell(
                [each for each in prover.ranked(prover.options, n) if each.good],
                max(clock.spent / self._budget.cpu, search.closed / self._budget.candidates),
            )

    def _affordable(self) -> int:
        """How many candidates the next round is made for; 0: the search is over."""
        left = self._budget.candidates - self._search.closed
        if not self._search.closed:
            return int(min(self._full, left))
        fits = self._full * self._clock.part(self._longest, self._prover.settling_time(self._n))
        least = 1 if self._search.cut else min(self._full, LEAST)
        return 0 if fits < least else int(min(self._full, fits, left))

    def _candidates(self, most: int, part: float) -> _Candidates | None:
        """What physics is to close; None: there are no guesses, or no time for more than a first round."""
        search, population, effort = self._search, self._population, self._effort
        over = self._clock.over if search.closed else self._clock.first_over
        begun = population is not None and len(population.elite) >= population.kept // 2
        guessed = _next(self._proposed, math.ceil(part * effort.guessed / (4 if begun else 1)), over, self._clock.over)
        ended = not over()
        if not guessed:
            return None
        varied = self._proposer.near(self._elite, math.ceil(part * effort.closed / 2))
        if population is None:
            ranked = sorted(guessed, key=lambda c: -c.score)
            closed = [*varied, *ranked[: effort.closed - len(varied)]][:most]
        else:
            ended &= population.evolve([*guessed, *varied], over, part)
            closed = population.take(most)
        if ended:
            return _Candidates(closed, most)
        if search.closed:
            return None
        search.cut, closed = True, closed[: 2 * self._n]
        return _Candidates(closed, len(closed))

    def _try_out(self, found: _Candidates, part: float) -> None:
        """Close candidates, and try what holds under draws; in the air, push it. Whose variations may be better is the
        elite of the next round."""
        search, prover, proposer, clock = self._search, self._prover, self._proposer, self._clock
        if self._protocol.floating:
            validate_in_air(prover, self._apart(self._squeezed(found.candidates)))
            return
        fingers = FingerGains(self._gains(), hand_kinematics(search.spec).gravity_torque)
        outcomes = close_candidates(
            proposer.bench, found.candidates, fingers, proposer.friction, self._random, proposer.preload
        )
        if self._population is not None:
            self._population.drop(_settled(found.candidates, outcomes))
        search.ends.update(outcome.where for outcome in outcomes)
        passed = [outcome.candidate for outcome in outcomes if outcome.passed]
        first = search.closed == found.made_for
        drawn = self._n if search.cut else math.ceil(part * self._effort.drawn)
        search.cut |= not prover.add(self._apart(passed)[:drawn], self._n, clock.over if first else lambda: False)
        self._elite = [*prover.unsure(), *(_furthest(outcomes) if len(passed) < FEW else [])]

    def _gains(self) -> Gains:
        return load_gains(protocol_gains(self._protocol.gains, self._search.spec), self._search.spec)

    def _squeezed(self, candidates: list[Candidate]) -> list[Candidate]:
        """In the air nothing holds the object while fingers close: they are told to meet it all at once."""
        spec = self._search.spec
        further = squeeze_offsets(np.array([c.closing for c in candidates]), spec, self._gains(), self._random)
        return [
            replace(c, squeeze=np.clip(c.close + more, spec.lower, spec.upper))
            for c, more in zip(candidates, further, strict=True)
        ]

    def _apart(self, passed: list[Candidate]) -> list[Candidate]:
        """The best of each place, none of which is where something good was found."""
        kept = list[Candidate]()
        taken = [option.candidate for option in self._prover.options if option.confirmed and option.good]
        for candidate in sorted(passed, key=lambda c: -c.score):
            if is_different(candidate, [*taken, *kept], self._prover.symmetry):
                kept.append(candidate)
        return kept


def search_symmetry(search: GraspSearch) -> ObjectSymmetry:
    """Turns of the object that make a grasp no other one, where the hand grasps it. At a table's edge there are none;
    in the air a ball has no way up."""
    scenario, protocol = search.scenario, load_protocol(search.scenario.protocol)
    placed = make_stage(scenario, protocol, search.spec.side, search.folder).objects[0]
    found = object_symmetry(placed)
    if protocol.floating:
        return replace(found, ball=placed.grasp_object.shape == "sphere")
    if scenario.edge is not None:
        return ObjectSymmetry(found.centre if scenario.push is None else pushed_to(scenario.push, found.centre))
    return found


def _settled(closed: list[Candidate], outcomes: list[ClosingOutcome]) -> list[Candidate]:
    """Those that evolution need not look at again: of what failed only the weak may come to something."""
    return [each for each, end in zip(closed, outcomes, strict=True) if end.passed or each.score > -1.0]


def _furthest(outcomes: list[ClosingOutcome]) -> list[Candidate]:
    """Those that came furthest."""
    order = sorted(outcomes, key=lambda o: (-o.reached, -o.candidate.score))[:ELITE]
    return [outcome.candidate for outcome in order]


def _turns(protocol: TrialProtocol, side: Side) -> list[float]:
    """Palm's angles about its z, rad, through which the protocol turns it: before, half and all of it."""
    most = sum(phase.turn[2] for phase in protocol.phases) * (-1.0 if side == "left" else 1.0)
    return [0.0, np.radians(most) / 2, np.radians(most)] if most else [0.0]


def _round_size(n: int) -> RoundSize:
    """For so many grasps."""
    usual, part = RoundSize(), min(1.0, n / USUAL)
    return RoundSize(*(math.ceil(part * most) for most in (usual.guessed, usual.closed, usual.drawn)))


def _next(
    proposed: Iterator[Candidate | None], count: int, over: Callable[[], bool], spent: Callable[[], bool]
) -> list[Candidate]:
    """The next candidates, so many or as many as come in so many tries; or, where time is `over`, as many as there
    are; none where all of it is `spent`."""
    found, tries = list[Candidate](), 0
    for candidate in proposed:
        if candidate is None:
            tries += 1
        else:
            found.append(candidate)
        if len(found) == count or tries == TRIES or (over() if found else spent()):
            break
    return found
