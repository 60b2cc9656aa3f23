"""A grasp made better where it is: wrist, postures and squeeze, under draws of what the hand is not told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from allegro_twin.build.trials import PERIOD, Bench, Case
from allegro_twin.evaluate.scenario import Scenario, load_protocol
from allegro_twin.evaluate.statistics import Paired, paired
from allegro_twin.evaluate.uncertainty import Uncertainty, draws
from allegro_twin.kinematics.orientation import facing, matrix_from_quaternion, quaternion_from_vector
from allegro_twin.library.grasps import Grasp
from allegro_twin.plan.confirm import DIGITS
from allegro_twin.plan.poses import closing_of
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

METRES, TURN, JOINT, SQUEEZE = 0.004, np.radians(4.0), 0.05, 0.35
"""How far the first round looks: m, rad, rad, and the logarithm of a factor (standard deviations)."""
NARROWER = 0.7
"""Of that in each round after it."""


@dataclass(frozen=True, slots=True, eq=False)
class Version:
    """A grasp and where its wrist is."""

    scenario: Scenario
    grasp: Grasp


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
    threads: int = 0

    def run(self, tell: Callable[[int, float], None] = lambda round_, share: None) -> Improved:
        """Search, and compare. `tell`: the round and the best share of draws held in it."""
        first = Version(self.scenario, self.grasp)
        random, elite, scale = np.random.default_rng(self.seed), [first], 1.0
        for number in range(self.rounds):
            tried = [*elite, *(varied(elite[k % len(elite)], self.spec, scale, random) for k in range(self.population))]
            score = self._score(tried)
            order = np.argsort(-score, kind="stable")
            elite = [tried[k] for k in order[:4]]
            tell(number, float(np.floor(score[order[0]])) / self.draws)
            scale *= NARROWER
        best = elite[0]
        held = [self._held([version], "table_pick", self.unseen, 1_000_000) for version in (first, best)]
        comparison = paired(*(list(each[0] > 0) for each in held))
        return Improved(first, best, comparison)

    def _score(self, versions: list[Version]) -> Array:
        """How many draws each holds; among equals the one whose margins are larger, as a part of one."""
        margin = self._held(versions, "quick", self.draws, 0)
        score: Array = (margin > 0).sum(axis=1) + 0.99 * np.clip(margin, 0.0, 1.0).mean(axis=1)
        return score

    def _held(self, versions: list[Version], protocol: str, count: int, first: int) -> Array:
        """What is left of the limits in each draw, (versions, draws); -1 where it was not held."""
        rules = load_protocol(protocol)
        bench = Bench(self.spec, period=rules.period or PERIOD, threads=self.threads)
        cases = draws(self.uncertainty, count, self.seed, first)
        verdicts = bench.verdicts([Case(v.scenario, v.grasp, d, rules, self.folder) for v in versions for d in cases])
        found = [-1.0 if not v.held or v.report is None else max(v.report.margin, 1e-9) for v in verdicts]
        return np.array(found).reshape(len(versions), count)


def varied(version: Version, spec: HandSpec, scale: float, random: np.random.Generator) -> Version:
    """Another version, near: the wrist elsewhere, the joints that close elsewhere, squeezed more or less."""
    wrist, grasp = version.scenario.wrist, version.grasp
    turn = matrix_from_quaternion(quaternion_from_vector(scale * TURN * random.normal(size=3)))
    rotation = turn @ facing(wrist.facing, wrist.fingers)
    moved = wrist.model_copy(
        update={
            "position": _row(np.array(wrist.position) + scale * METRES * random.normal(size=3)),
            "facing": _row(rotation[:, 0]), "fingers": _row(rotation[:, 2]),
        }
    )  # fmt: skip
    change = scale * JOINT * random.normal(size=spec.n_joints)
    told = (grasp.squeeze - grasp.close) * np.exp(scale * SQUEEZE * random.normal())
    told = told + scale * 0.5 * JOINT * random.normal(size=spec.n_joints) * (closing_of(grasp) != 0.0)
    close = _inside(grasp.close + change, spec)
    better = replace(
        grasp, preshape=_inside(grasp.preshape + change, spec), close=close, squeeze=_inside(close + told, spec)
    )
    return Version(version.scenario.model_copy(update={"wrist": moved}), better)


def _inside(posture: Array, spec: HandSpec) -> Array:
    low, high = np.ceil(spec.lower * 10**DIGITS) / 10**DIGITS, np.floor(spec.upper * 10**DIGITS) / 10**DIGITS
    inside: Array = np.clip(np.round(posture, DIGITS), low, high)
    return inside


def _row(vector: Array) -> tuple[float, float, float]:
    x, y, z = np.round(vector, DIGITS).tolist()
    return x, y, z
