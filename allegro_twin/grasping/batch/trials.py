"""Trials by the hundred, described by plain data: what sweeps, comparisons and searches are made of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from allegro_twin.control.controllers import PD, GravityFeedforward, PositionControl
from allegro_twin.errors import ConfigError, HandFault, TooFast
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.grasping.batch.batched_trials import Measure, Verdict, run_trials
from allegro_twin.grasping.controller import TimedGrasp, make_grasp_controller
from allegro_twin.grasping.interchange.read import import_grasp
from allegro_twin.grasping.metrics.trial_metrics import NAMES, trial_metrics
from allegro_twin.grasping.scenario import (
    Scenario,
    TrialProtocol,
    load_protocol,
    load_scenario,
    load_scenario_for,
    scenario_protocol,
    turn_pushes,
)
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.uncertainty import Perturbation
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.description.specs import card_side, load_spec
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.library.gains import load_gains, protocol_gains
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.limits import check_period, hand_limits
from allegro_twin.hands.settings import LimitSettings, scenario_side
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard
from allegro_twin.sim.model.compiled_scenes import CompiledScenes
from allegro_twin.sim.model.fingerprint import hand_fingerprint

if TYPE_CHECKING:
    from allegro_twin.spec import HandSpec, Side

AXES = {f"{sign}{axis}": (k, value) for k, axis in enumerate("xyz") for sign, value in (("+", 1.0), ("-", -1.0))}
PERIOD = 0.003
"""s, the hand's."""
WIDTH = 64
"""Trials side by side at most: more gain nothing, and cost memory."""
MEMORY, FEWEST = 384_000_000, 8
"""Bytes that their models take at most, two for each trial, but for so few trials: that of a hand with many fine meshes
takes 15 MB (the Allegro Hand's 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class TrialCase:
    """One trial that is to be made."""

    scenario: Scenario
    grasp: Grasp
    draw: Perturbation | None = None
    protocol: TrialProtocol | None = None
    """None: the scenario's."""
    folder: Path = Path()
    """Where the scenario's own files are looked for."""
    rules: str | None = None
    """The protocol's name, where it is not the scenario's."""
    typed: bool = True
    """Whether its report has the type that its contacts show."""

    @property
    def ruled(self) -> TrialProtocol:
        """The protocol that it is tried under."""
        return load_protocol(self.scenario.protocol) if self.protocol is None else self.protocol

    def directions(self) -> list[TrialCase]:
        """The trials that it takes: one, or one for each axis and sign."""
        protocol = self.ruled
        if protocol.directions == 1:
            return [self]
        return [replace(self, protocol=turn_pushes(protocol, *way)) for way in AXES.values()]


class TrialRunner:
    """Makes trials of one hand: under PD at one set of gains, as their grasp controls force, or in its own loop."""

    def __init__(self, spec: HandSpec, gains: str = "default", period: float = PERIOD, threads: int = 0) -> None:
        check_period(period, spec)
        self.spec, self.period, self._threads = spec, period, threads
        self._model = hand_kinematics(spec)
        self.gains = load_gains(gains, spec)
        self._gravity = GravityFeedforward(self._model.gravity_torque)
        self.limits = hand_limits(LimitSettings(), spec)

    def verdicts(
        self, cases: Sequence[TrialCase], measure: Measure | None = None, *, stop_early: bool = False
    ) -> Iterator[Verdict]:
        """One a case, in order. `stop_early`: what is lost has no report, and neither have the other pushes of the same
        grasp. A hand with a drive performs them one after the other: side by side there is none. Raises ConfigError for
        a scene that cannot be built."""
        if self.spec.drive is not None:
            yield from (self._alone(case, measure) for case in cases)
            return
        stems = _stems(cases)
        first = 0
        while first < len(cases):
            scenes = CompiledScenes(self.spec)
            trials = [self.trial(cases[first], scenes)]
            end = first + min(WIDTH, max(FEWEST, MEMORY // (2 * trials[0].backend.model.nbuffer)))
            while end < len(cases) and end > first + 1 and stems[end] == stems[end - 1]:
                end -= 1  # What is pushed in several ways is tried together.
            trials += [self.trial(case, scenes) for case in cases[first + 1 : end]]
            controllers = [self.controller(trial) for trial in trials]
            yield from run_trials(
                trials, controllers, self.limits, threads=self._threads, measure=measure, stop_early=stop_early,
                stems=stems[first:end],
            )  # fmt: skip
            first = end

    def _alone(self, case: TrialCase, measure: Measure | None) -> Verdict:
        trial = self.trial(case)
        check = next((window.end for window in trial.windows if window.check), trial.seconds)
        moment, measured = round(check / self.period), dict[str, float]()
        samples = run(Guard(trial.backend, self.limits), self.controller(trial))
        try:
            for sample in until(trial.seconds, trial.watched(samples)):
                if measure is not None and sample.state.tick == moment:
                    measured |= measure(trial, trial.backend.data)
        except HandFault as fault:
            return Verdict(None, str(fault), trial.mass, measured, isinstance(fault, TooFast))
        return Verdict(trial.report(), "", trial.mass, measured)

    def trial(self, case: TrialCase, scenes: CompiledScenes | None = None) -> Trial:
        """Its scene, its clock and what it is judged by. Raises ConfigError."""
        return Trial(
            case.scenario, self.spec, case.grasp, folder=case.folder, period=self.period, protocol=case.protocol,
            draw=case.draw, scenes=scenes, typed=case.typed,
        )  # fmt: skip

    def controller(self, trial: Trial) -> Any:
        """What performs a trial's grasp. Raises ConfigError for one that this hand cannot perform."""
        if "torque" not in self.spec.commands:
            if trial.grasp.grip is not None:
                raise ConfigError(f"grasp {trial.grasp.name} controls force by torques; {self.spec.name} takes none")
            return PositionControl(trial.reference)
        if trial.grasp.grip is None:
            return PD(trial.reference, self.gains, self._gravity)
        timed = TimedGrasp(trial.reference, trial.begin_of("close"), trial.begin_of("squeeze"))
        return make_grasp_controller(trial.grasp, timed, self.spec, self.gains, self._gravity, self._model)


def _stems(cases: Sequence[TrialCase]) -> list[int]:
    """A number for each, the same for those beside each other that differ in nothing but their pushes."""
    keys = [
        (id(case.scenario), id(case.grasp), id(case.draw), case.folder,
         None if case.protocol is None else turn_pushes(case.protocol, 0, 0.0))
        for case in cases
    ]  # fmt: skip
    return list(accumulate((one != other for one, other in pairwise(keys)), initial=0))[: len(cases)]


_RUNNERS: dict[tuple[object, ...], TrialRunner] = {}
_KEPT = 8


def _runner(spec: HandSpec, gains: str, period: float, threads: int) -> TrialRunner:
    """A process has many units of a hand. One whose files have changed since is another."""
    key = hand_fingerprint(spec), fingerprint(load_gains(gains, spec)), gains, period, threads
    if key not in _RUNNERS:
        while len(_RUNNERS) >= _KEPT:
            del _RUNNERS[next(iter(_RUNNERS))]
        _RUNNERS[key] = TrialRunner(spec, gains, period, threads)
    return _RUNNERS[key]


def hand_name(item: Mapping[str, Any]) -> str:
    """The model of hand that an item is of: its `hand`, its scenario's, or, of a file, that of such files."""
    if "hand" in item:
        return str(item["hand"])
    return HAND if "file" in item else load_scenario(item["scenario"])[0].hand


def run_cases(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A unit of a sweep. `shared`: `serial`, `gains`, `threads`, `metrics` (true: those of the contacts at the end of
    the first phase that checks; NaN where there is a draw). An item: `scenario` (a name or a path), and where they
    differ from its own `hand`, `grasp`, `object`, `protocol`, `side`; or `file`, with grasps as others write them,
    `row`, `object` and `protocol`; `draw`, the fields of a `Perturbation`. A flat row for each."""
    rows: dict[int, dict[str, Any]] = {}
    groups: dict[tuple[str, Side, str, float], list[tuple[int, TrialCase]]] = {}
    specs: dict[tuple[str, Side], HandSpec] = {}
    serial = shared.get("serial", "")
    for index, item in enumerate(items):
        hand = hand_name(item)
        side: Side = item.get("side") or scenario_side([item.get("scenario")]) or card_side(hand) or "right"
        spec = specs.setdefault((hand, side), load_spec(hand, side, serial))
        case = load_case(item, spec)
        gains = protocol_gains(case.ruled.gains or shared.get("gains"), spec)
        groups.setdefault((hand, side, gains, case.ruled.period or PERIOD), []).append((index, case))
    for (hand, side, gains, period), members in groups.items():
        bench = _runner(specs[hand, side], gains, period, shared.get("threads", 0))
        split = [case.directions() for _, case in members]
        measure = _nominal if shared.get("metrics") else None
        verdicts = bench.verdicts([case for cases in split for case in cases], measure)
        for (index, case), cases in zip(members, split, strict=True):
            rows[index] = result_row(case, side, [next(verdicts) for _ in cases], metrics=measure is not None)
    return [rows[index] for index in range(len(items))]


def load_case(item: Mapping[str, Any], spec: HandSpec) -> TrialCase:
    """From plain data. Raises ConfigError."""
    protocol = None if item.get("protocol") is None else load_protocol(item["protocol"])
    draw = None if item.get("draw") is None else Perturbation(**item["draw"])
    if "file" in item:
        made = import_grasp(Path(item["file"]), item["row"], spec, item.get("object"))
        return TrialCase(made.scenario, made.grasp, draw, protocol, made.folder, item.get("protocol"))
    scenario, path, grasp = load_scenario_for(
        item["scenario"], spec, grasp=item.get("grasp"), object_name=item.get("object")
    )
    if protocol is None:
        scenario_protocol(scenario, path)
    return TrialCase(scenario, grasp, draw, protocol, path.parent, item.get("protocol"))


def result_row(case: TrialCase, side: str, verdicts: Sequence[Verdict], *, metrics: bool = False) -> dict[str, Any]:
    """The verdicts of one case, one a direction, as one flat row: the worst of them; NaN for what a trial that was
    stopped has not shown. `type` is the one that its contacts show, `claimed` the grasp's own.
    `metrics`: with those of the contacts, of the first direction that has them."""
    worst = min(verdicts, key=lambda v: (v.held, -np.inf if v.report is None else v.report.margin))
    seen = None if worst.report is None else worst.report.observed
    named = Path(case.scenario.protocol if case.rules is None else case.rules).stem
    row: dict[str, Any] = {
        "object": case.scenario.objects[0].name, "grasp": case.grasp.name,
        "type": "not seen" if seen is None else seen.name, "claimed": case.grasp.taxonomy.name,
        "virtual_fingers": "" if seen is None else seen.virtual_fingers,
        "carries": "" if seen is None else seen.carries,
        "hand": case.scenario.model, "side": side, "protocol": f"{named} {case.ruled.version}",
        "held": all(verdict.held for verdict in verdicts),
        "reason": worst.stopped if worst.report is None else worst.report.reason,
    } | _numbers(worst.report)  # fmt: skip
    if len(verdicts) == len(AXES):
        for name, verdict in zip(AXES, verdicts, strict=True):
            row[f"margin_{name}"] = float("nan") if verdict.report is None else verdict.report.margin
            row[f"strength_{name}"] = _strength(case, verdict)
        row["strength_n"] = min(row[f"strength_{name}"] for name in AXES)
    if metrics:
        measured = next((verdict.measured for verdict in verdicts if verdict.measured), {})
        row |= {name: measured.get(name, float("nan")) for name in NAMES}
    return row


def _nominal(trial: Trial, data: Any) -> Mapping[str, float]:
    """Metrics cost up to 0.4 s a grasp, so those of draws are left out."""
    return {} if trial.draw is not None else trial_metrics(trial, data)


def _strength(case: TrialCase, verdict: Verdict) -> float:
    """The largest push that it held, N: that of the last phase before the first one in which it did not."""
    mass = case.ruled.mass
    held = 0.0
    if verdict.report is None:
        return held
    pushes = {phase.name: float(np.abs(phase.push).max()) for phase in case.ruled.phases}
    for phase in verdict.report.phases:
        if phase.check and not phase.held:
            break
        held = max(held, pushes[phase.name])
    return held * (verdict.mass if mass is None else mass)


def _numbers(report: TrialReport | None) -> dict[str, float]:
    nan = float("nan")
    if report is None:
        names = ("drift_mm", "rotation_deg", "margin", "lift_mm", "penetration_mm", "contacts", "torque_share", "stall")
        return dict.fromkeys(names, nan)
    checks = [phase for phase in report.phases if phase.check]
    return {
        "drift_mm": 1000.0 * max((phase.drift for phase in checks), default=nan),
        "rotation_deg": max((phase.rotation for phase in checks), default=nan),
        "margin": report.margin,
        "lift_mm": 1000.0 * report.lift,
        "penetration_mm": 1000.0 * report.penetration,
        "contacts": float(np.mean([phase.contacts for phase in checks])) if checks else nan,
        "torque_share": report.peak_torque,
        "stall": report.stall,
    }
