"""A grasp made better where it is: wrist, postures and squeeze, under draws of what the hand is not told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError, HandError
from allegro_twin.grasping.batch.trials import PERIOD, TrialCase, TrialRunner
from allegro_twin.grasping.plan.candidate import (
    SHARE,
    check_efforts,
    check_stiffness,
    limit_squeeze,
    rest_positions,
    round_posture,
    round_vector,
)
from allegro_twin.grasping.plan.ease import ease_squeeze
from allegro_twin.grasping.plan.proposals.poses import closing_directions
from allegro_twin.grasping.scenario import Scenario, load_protocol
from allegro_twin.grasping.statistics import PairedCounts, count_pairs
from allegro_twin.grasping.uncertainty import Perturbation, SampleStream, Uncertainty, sample_perturbations
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import GraspFile
from allegro_twin.hands.library.grasps import Grasp, build_grasp, entry_from_grasp
from allegro_twin.hands.library.taxonomy import claim_observed
from allegro_twin.kinematics.orientation import matrix_facing, matrix_from_quaternion, quaternion_from_vector
from allegro_twin.spec import HandSpec
from allegro_twin.sweep.jobs import Sweep
from allegro_twin.sweep.local import Local, SweepEngine
from allegro_twin.sweep.runner import run
from allegro_twin.types import Array

TRIED = "allegro_twin.grasping.plan.improve:run_variants"
UNIT = 32
"""Trials in a unit at most, as they go side by side."""


@dataclass(frozen=True, slots=True, eq=False)
class GraspVariant:
    """A grasp and where its wrist is."""

    scenario: Scenario
    grasp: Grasp


class VariantResult(NamedTuple):
    """Result of a variant's trial; 0 and 1 for one that was stopped."""

    held: bool
    margin: float
    stall: float
    """Share of the time in which the joint that pushes hardest is at its torque limit."""
    sustained: float
    """Share of its limit that the hottest joint sustains."""


@dataclass(frozen=True, slots=True)
class VariantWorkers:
    """Workers that try variants: `at_once` processes of an engine, or, with one, all threads of this process."""

    engine: SweepEngine
    at_once: int
    folder: Path
    """Where the scenario's own files are looked for."""


def try_variants(
    versions: Sequence[GraspVariant],
    spec: HandSpec,
    protocol: str,
    samples: Sequence[Perturbation],
    where: VariantWorkers,
) -> list[list[VariantResult]]:
    """A row for each version, an element for each draw. Raises HandError."""
    items = [
        {"version": variant_to_json(version, spec), "draw": asdict(draw)} for version in versions for draw in samples
    ]
    shared = {"hand": spec.model_reference, "side": spec.side, "serial": spec.serial, "protocol": protocol,
              "folder": str(where.folder.resolve()), "threads": int(where.at_once > 1)}  # fmt: skip
    unit = len(items) if where.at_once == 1 else max(1, min(UNIT, len(items) // where.at_once))
    rows = iter(run(Sweep(TRIED, items, shared, unit), engine=where.engine).to_pylist())
    return [[_checked(next(rows)) for _ in samples] for _ in versions]


def run_variants(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Units of the sweep: a row with the fields of `VariantResult` for each item's version under its draw."""
    spec, rules = load_spec(shared["hand"], shared["side"], shared["serial"]), load_protocol(shared["protocol"])
    bench = TrialRunner(spec, period=rules.period or PERIOD, threads=shared["threads"])
    return [each._asdict() for each in _made(bench, items, rules, Path(shared["folder"]))]


def variant_to_json(version: GraspVariant, spec: HandSpec) -> dict[str, Any]:
    """As JSON has it."""
    entry = entry_from_grasp(version.grasp, spec).model_dump(mode="json")
    return {"scenario": version.scenario.model_dump(mode="json"), "name": version.grasp.name, "grasp": entry}


def variant_from_json(data: Mapping[str, Any], spec: HandSpec) -> GraspVariant:
    """What `variant_to_json` has made plain."""
    grasp = build_grasp(data["name"], GraspFile.model_validate(data["grasp"]), spec, data["name"])
    return GraspVariant(Scenario.model_validate(data["scenario"]), grasp)


def _made(bench: TrialRunner, items: Sequence[Mapping[str, Any]], rules: Any, folder: Path) -> Iterator[VariantResult]:
    cases = []
    for item in items:
        version = variant_from_json(item["version"], bench.spec)
        cases.append(TrialCase(version.scenario, version.grasp, Perturbation(**item["draw"]), rules, folder))
    for verdict in bench.verdicts(cases):
        report = verdict.report
        if report is None:
            yield VariantResult(held=False, margin=0.0, stall=1.0, sustained=1.0)
        else:
            yield VariantResult(report.held, report.margin, report.stall, report.hottest[1])


def _checked(row: Mapping[str, Any]) -> VariantResult:
    if row["error"] is not None:
        raise HandError(row["error"])
    return VariantResult(bool(row["held"]), *(float(row[name]) for name in VariantResult._fields[1:]))


def score(row: Sequence[VariantResult], sustained: float = math.inf) -> float:
    """How many draws it holds with no joint that sustains more than is allowed; among equals the one with larger
    margins and less time at a torque limit, as parts of one."""
    held = [each for each in row if each.held and each.sustained <= sustained]
    margin = float(np.mean([each.margin for each in held] or 0.0))
    return len(held) + 0.49 * margin + 0.5 * (1.0 - float(np.mean([each.stall for each in held] or 1.0)))


METRES, TURN, JOINT, SQUEEZE = 0.004, np.radians(4.0), 0.05, 0.35
"""How far the first round looks: m, rad, rad, and the logarithm of a factor (standard deviations)."""
NARROWER = 0.7
"""Factor on the width of variations in each round after the first."""
ELITE, EASED = 4, 2
"""How many the next round varies, and how many of them are tried with less squeeze, too."""
FINAL = 4
"""Times as many draws as a round has, by which the last elite and the first version are told apart: the best of many by
few draws was partly lucky."""


@dataclass(frozen=True, slots=True, eq=False)
class ImprovementResult:
    """The best version that was found, and both on draws that it was not chosen on."""

    before: GraspVariant
    after: GraspVariant
    found: bool
    """The best is another one than the first."""
    comparison: PairedCounts
    """The first is the version before."""
    hottest: tuple[tuple[str, float], tuple[str, float]]
    """Hottest joint of either version in the whole trial without a draw, and the share of its limit that it
    sustains."""


@dataclass(slots=True)
class GraspImprovement:
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
    sustained: float = math.inf
    """Share of its torque limit that no joint of the better version sustains more of."""
    engine: SweepEngine = field(default_factory=lambda: Local(0))
    at_once: int = 1
    """How many processes the engine has."""

    def run(self, tell: Callable[[int, float], None] = lambda round_, share: None) -> ImprovementResult:
        """Search, and compare. `tell`: the round and the best share of draws held in it. Raises HandError, also where
        nothing holds with what joints may sustain, or the effort of a motor is unknown."""
        check_efforts(self.spec)
        check_stiffness(self.spec)
        first = GraspVariant(self.scenario, self.grasp)
        random, scale = np.random.default_rng(self.seed), 1.0
        begun = first if math.isinf(self.sustained) else self._cooler(first) or first
        elite = [(float(self._score([begun])[0]), begun)]
        for number in range(self.rounds):
            parents = [version for _, version in elite]
            new = [perturb_grasp(parents[k % len(parents)], self.spec, scale, random) for k in range(self.population)]
            tried = [*self._eased(parents[:EASED]), *new]
            elite = sorted([*elite, *zip(self._score(tried).tolist(), tried, strict=True)], key=lambda e: -e[0])[:ELITE]
            tell(number, float(np.floor(elite[0][0])) / self.draws)
            scale *= NARROWER
        best = self._best([first, *(version for _, version in elite if version is not first)])
        (_, hot), (shown, cool) = self._seen(first), self._seen(best)
        before, after = self._tried([first, best], "table_pick", self.unseen, "judge")
        comparison = count_pairs([each.held for each in before], [each.held for each in after])
        return ImprovementResult(first, shown, best is not first, comparison, (hot, cool))

    def _seen(self, version: GraspVariant) -> tuple[GraspVariant, tuple[str, float]]:
        """With the type that its contacts show in the whole trial without a draw, and its hottest joint."""
        case = TrialCase(version.scenario, version.grasp, folder=self.folder)
        (verdict,) = TrialRunner(self.spec).verdicts([case])
        if verdict.report is None or verdict.report.observed is None:
            return version, ("", math.nan) if verdict.report is None else verdict.report.hottest
        shown = verdict.report.observed
        grasp = replace(version.grasp, observed=shown, taxonomy=claim_observed(shown))
        return GraspVariant(version.scenario, grasp), verdict.report.hottest

    def _coolest(self, versions: Sequence[GraspVariant]) -> GraspVariant:
        """The first that holds the whole trial with no more than joints may sustain."""
        for version in versions:
            cooler = self._cooler(version)
            if cooler is not None:
                return cooler
        raise ConfigError(
            f"grasp {self.grasp.name}: no version holds {self.scenario.objects[0].name or 'the object'} with at most "
            f"{self.sustained:.0%} of every joint's torque limit sustained: more --rounds, or a larger --sustained"
        )

    def _cooler(self, version: GraspVariant) -> GraspVariant | None:
        """With its squeeze as small as that; None where it does not hold then."""
        eased = ease_squeeze(version.scenario, version.grasp, TrialRunner(self.spec), self.sustained, self.folder)
        return GraspVariant(version.scenario, eased.grasp) if eased.within(self.sustained) else None

    def _eased(self, versions: list[GraspVariant]) -> list[GraspVariant]:
        """Reduce the squeeze of each version to what it needs where nothing is amiss."""
        rules = load_protocol("quick")
        bench = TrialRunner(self.spec, period=rules.period or PERIOD, threads=0 if self.at_once == 1 else 1)
        cases = [TrialCase(v.scenario, v.grasp, None, rules, self.folder) for v in versions]
        found = []
        for version, verdict in zip(versions, bench.verdicts(cases, rest_positions), strict=True):
            if verdict.measured:
                rest = np.array([verdict.measured[joint] for joint in self.spec.joints])
                eased = limit_squeeze(version.grasp, rest, bench.gains, self.spec, min(SHARE, self.sustained))
                found.append(GraspVariant(version.scenario, eased))
        return found

    def _best(self, versions: list[GraspVariant]) -> GraspVariant:
        """By more draws than they were found by; the first of equals."""
        if len(versions) > 1:
            order = np.argsort(-self._score(versions, FINAL * self.draws), kind="stable")
            versions = [versions[k] for k in order]
        return versions[0] if math.isinf(self.sustained) else self._coolest(versions)

    def _score(self, versions: list[GraspVariant], draws: int = 0) -> Array:
        """By so many draws of the search; 0: as many as a round has."""
        rows = self._tried(versions, "quick", draws or self.draws, "search")
        return np.array([score(row, self.sustained) for row in rows])

    def _tried(
        self, versions: list[GraspVariant], protocol: str, count: int, stream: SampleStream
    ) -> list[list[VariantResult]]:
        """The first draws of a stream, a row for each version."""
        where = VariantWorkers(self.engine, self.at_once, self.folder)
        return try_variants(
            versions,
            self.spec,
            protocol,
            sample_perturbations(self.uncertainty, count, self.seed, stream=stream),
            where,
        )


def perturb_grasp(version: GraspVariant, spec: HandSpec, scale: float, random: np.random.Generator) -> GraspVariant:
    """Another version, near: the wrist elsewhere, the joints that close elsewhere, squeezed more or less."""
    wrist, grasp = version.scenario.wrist, version.grasp
    turn = matrix_from_quaternion(quaternion_from_vector(scale * TURN * random.normal(size=3)))
    rotation = turn @ matrix_facing(wrist.facing, wrist.fingers)
    moved = wrist.model_copy(
        update={
            "position": round_vector(np.array(wrist.position) + scale * METRES * random.normal(size=3)),
            "facing": round_vector(rotation[:, 0]), "fingers": round_vector(rotation[:, 2]),
        }
    )  # fmt: skip
    change = scale * JOINT * random.normal(size=spec.n_joints)
    told = (grasp.squeeze - grasp.close) * np.exp(scale * SQUEEZE * random.normal())
    told = told + scale * 0.5 * JOINT * random.normal(size=spec.n_joints) * (closing_directions(grasp, spec) != 0.0)
    close = round_posture(grasp.close + change, spec)
    better = replace(
        grasp,
        preshape=round_posture(grasp.preshape + change, spec),
        close=close,
        squeeze=round_posture(close + told, spec),
        observed=None,
    )
    return GraspVariant(version.scenario.model_copy(update={"wrist": moved}), better)
