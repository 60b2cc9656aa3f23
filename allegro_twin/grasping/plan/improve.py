"""A grasp made better where it is: wrist, postures and squeeze, under draws of what the hand is not told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from allegro_twin.grasping.batch.trials import PERIOD, Bench, Case
from allegro_twin.grasping.plan.as_scenario import rounded, row
from allegro_twin.grasping.plan.poses import closing_of
from allegro_twin.grasping.plan.reduce_squeeze import check_loop, eased, resting
from allegro_twin.grasping.plan.variants import Try, Version, Where, score, tries
from allegro_twin.grasping.scenario import Scenario, load_protocol
from allegro_twin.grasping.statistics import Paired, paired
from allegro_twin.grasping.uncertainty import Stream, Uncertainty, draws
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.taxonomy import claim_observed
from allegro_twin.kinematics.orientation import matrix_facing, matrix_from_quaternion, quaternion_from_vector
from allegro_twin.spec import HandSpec
from allegro_twin.sweep.local import Local, SweepEngine
from allegro_twin.types import Array

METRES, TURN, JOINT, SQUEEZE = 0.004, np.radians(4.0), 0.05, 0.35
"""How far the first round looks: m, rad, rad, and the logarithm of a factor (standard deviations)."""
NARROWER = 0.7
"""Of that in each round after it."""
ELITE, EASED = 4, 2
"""How many the next round varies, and how many of them are tried with less squeeze, too."""


@dataclass(frozen=True, slots=True, eq=False)
class Improved:
    """The better version, and both on draws that it was not chosen on."""

    before: Version
    after: Version
    comparison: Paired
    """The first is the version before."""


@dataclass(slots=True)
class Improvement:
    """A search by chance around the best so far: each round tries variations of the elite on the same draws."""

    scenario: Scenario
    grasp: Grasp
    spec: HandSpec
    folder: Path = Path()
    seed: int = 0
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    rounds: int = 3
    population: int = 16
    draws: int = 8
    unseen: int = 40
    """On which both versions are compared in the end."""
    engine: SweepEngine = field(default_factory=lambda: Local(0))
    at_once: int = 1
    """How many processes the engine has."""

    def run(self, tell: Callable[[int, float], None] = lambda round_, share: None) -> Improved:
        """Search, and compare. `tell`: the round and the best share of draws held in it. Raises HandError."""
        check_loop(self.spec)
        first = Version(self.scenario, self.grasp)
        random, scale = np.random.default_rng(self.seed), 1.0
        elite = [(float(self._score([first])[0]), first)]
        for number in range(self.rounds):
            parents = [version for _, version in elite]
            new = [varied(parents[k % len(parents)], self.spec, scale, random) for k in range(self.population)]
            tried = [*self._eased(parents[:EASED]), *new]
            elite = sorted([*elite, *zip(self._score(tried).tolist(), tried, strict=True)], key=lambda e: -e[0])[:ELITE]
            tell(number, float(np.floor(elite[0][0])) / self.draws)
            scale *= NARROWER
        best = elite[0][1]
        before, after = self._tried([first, best], "table_pick", self.unseen, "judge")
        comparison = paired([each.held for each in before], [each.held for each in after])
        return Improved(first, self._seen(best), comparison)

    def _seen(self, version: Version) -> Version:
        """With the type that its contacts show in the whole trial without a draw."""
        case = Case(version.scenario, version.grasp, folder=self.folder)
        (verdict,) = Bench(self.spec).verdicts([case])
        shown = None if verdict.report is None else verdict.report.observed
        if shown is None:
            return version
        return Version(version.scenario, replace(version.grasp, observed=shown, taxonomy=claim_observed(shown)))

    def _eased(self, versions: list[Version]) -> list[Version]:
        """The same grasps with no more squeeze than they need where nothing is amiss."""
        rules = load_protocol("quick")
        bench = Bench(self.spec, period=rules.period or PERIOD, threads=0 if self.at_once == 1 else 1)
        cases = [Case(v.scenario, v.grasp, None, rules, self.folder) for v in versions]
        found = []
        for version, verdict in zip(versions, bench.verdicts(cases, resting), strict=True):
            if verdict.measured:
                rest = np.array([verdict.measured[joint] for joint in self.spec.joints])
                found.append(Version(version.scenario, eased(version.grasp, rest, bench.gains, self.spec)))
        return found

    def _score(self, versions: list[Version]) -> Array:
        return np.array([score(row) for row in self._tried(versions, "quick", self.draws, "search")])

    def _tried(self, versions: list[Version], protocol: str, count: int, stream: Stream) -> list[list[Try]]:
        """The first draws of a stream, a row for each version."""
        where = Where(self.engine, self.at_once, self.folder)
        return tries(versions, self.spec, protocol, draws(self.uncertainty, count, self.seed, stream=stream), where)


def varied(version: Version, spec: HandSpec, scale: float, random: np.random.Generator) -> Version:
    """Another version, near: the wrist elsewhere, the joints that close elsewhere, squeezed more or less."""
    wrist, grasp = version.scenario.wrist, version.grasp
    turn = matrix_from_quaternion(quaternion_from_vector(scale * TURN * random.normal(size=3)))
    rotation = turn @ matrix_facing(wrist.facing, wrist.fingers)
    moved = wrist.model_copy(
        update={
            "position": row(np.array(wrist.position) + scale * METRES * random.normal(size=3)),
            "facing": row(rotation[:, 0]), "fingers": row(rotation[:, 2]),
        }
    )  # fmt: skip
    change = scale * JOINT * random.normal(size=spec.n_joints)
    told = (grasp.squeeze - grasp.close) * np.exp(scale * SQUEEZE * random.normal())
    told = told + scale * 0.5 * JOINT * random.normal(size=spec.n_joints) * (closing_of(grasp, spec) != 0.0)
    close = rounded(grasp.close + change, spec)
    better = replace(
        grasp,
        preshape=rounded(grasp.preshape + change, spec),
        close=close,
        squeeze=rounded(close + told, spec),
        observed=None,
    )
    return Version(version.scenario.model_copy(update={"wrist": moved}), better)
