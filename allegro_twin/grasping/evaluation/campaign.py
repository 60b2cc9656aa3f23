"""Many trials for one question: what is asked of which grasps, as the plain data of a sweep."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import read_yaml
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.grasping.batch.trials import TrialCase, hand_name, load_case
from allegro_twin.grasping.interchange.read import load_grasps, own_hand
from allegro_twin.grasping.scenario import Scenario, ScenarioObject, load_protocol, load_scenario
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.grasping.uncertainty import Uncertainty, sample_perturbations
from allegro_twin.hands.description.specs import card_side, hand_side, load_spec
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.library.gains import load_gains, protocol_gains
from allegro_twin.sim.model.fingerprint import hand_fingerprint, model_fingerprint
from allegro_twin.sim.model.scene import compile_scene
from allegro_twin.sim.objects.catalogue import load_object
from allegro_twin.sim.objects.meshes import load_mesh, mesh_report
from allegro_twin.spec import HandSpec, Side

Inputs = dict[str, str]
"""Fingerprints by name."""


SCENE = "scene of"
"""How the name of a compiled scene begins: what changes one is mostly named by another input, too."""


class InputFingerprints:
    """The inputs of many trials: what they share is looked at once."""

    def __init__(self) -> None:
        self._scenes: dict[str, str] = {}

    def __call__(self, case: TrialCase, spec: HandSpec, name: str, file: Path | None = None) -> Inputs:
        """Fingerprints of all that the trial of that name reads. `file`: a file of many grasps that holds its grasp and
        the palm's place; those of one file share their scene. Raises ConfigError for a scene that cannot be built."""
        scenario, protocol = case.scenario, case.ruled
        gains = protocol_gains(protocol.gains, spec)
        found = {
            f"hand {spec.serial or spec.name}": hand_fingerprint(spec),
            f"gains {gains} of {spec.model}": fingerprint(load_gains(gains, spec)),
            f"protocol {Path(case.rules or scenario.protocol).stem}": fingerprint(protocol),
        }
        found |= {f"object {each.name}": object_fingerprint(each, case.folder) for each in scenario.objects}
        if file is None:
            found |= {
                f"scenario {name}": scenario_fingerprint(scenario),
                f"grasp {case.grasp.name}": fingerprint(case.grasp),
            }
        else:
            found |= {f"grasps {file.name}": fingerprint(file, scenario_fingerprint(scenario), case.grasp)}
        where = name if file is None else file.name
        alike = {key: digest for key, digest in found.items() if file is None or not key.startswith("grasps")}
        return found | {f"{SCENE} {spec.name} at {where}": self._scene(case, spec, fingerprint(alike, file))}

    def _scene(self, case: TrialCase, spec: HandSpec, parts: str) -> str:
        """The compiled model: the net under the list above, for what a description includes."""
        if parts not in self._scenes:
            scene = make_stage(case.scenario, case.ruled, spec.side, case.folder)
            self._scenes[parts] = model_fingerprint(compile_scene(spec, scene))
        return self._scenes[parts]


def scenario_fingerprint(scenario: Scenario) -> str:
    """Fingerprint of a scenario's contents; the place of its files does not count, nor does its description."""
    objects = [each.model_copy(update={"file": None}) for each in scenario.objects]
    named_by = {"grasp": Path(scenario.grasp).stem, "hand": Path(scenario.hand).stem, "objects": tuple(objects)}
    return fingerprint(scenario.model_copy(update=named_by | {"description": ""}))


def object_fingerprint(settings: ScenarioObject, folder: Path) -> str:
    """Fingerprint of one object: its file, or the catalogue's entry of that name. Raises ConfigError."""
    if settings.file is not None:
        file, own = folder / settings.file, settings.model_copy(update={"file": None})
        repaired = settings.shape == "mesh" and settings.collision == "pieces" and mesh_report(file, settings.scale)
        if repaired:  # What was made of a scan counts too.
            return fingerprint(file, own, *load_mesh(file, settings.scale))
        return fingerprint(file, own)
    return fingerprint(settings, load_object(settings.name) if settings.shape is None else None)


JUDGE = "allegro_twin.grasping.batch.trials:run_cases"
FLOATING = "fc"
"""What grasps of a file are tried under unless something else is said: they know of no table."""
_NAMED = 30
"""Targets that a folder names; of more it says how many."""


@dataclass(frozen=True, slots=True)
class TargetOptions:
    """Options that hold for all targets; None: as each target says."""

    protocol: str | None = None
    sides: tuple[Side, ...] | None = None
    grasp: str | None = None
    object: str | None = None
    hand: str | None = None
    """Model of hand, or a card; of grasp files alone."""
    serial: str = ""
    """One hand's own file, of the model that each target is of."""


@dataclass(frozen=True, slots=True)
class SamplingSettings:
    """Draws for every target, the same for all."""

    n: int = 0
    seed: int = 0
    uncertainty: Uncertainty = field(default_factory=Uncertainty)


@dataclass(frozen=True, slots=True, eq=False)
class EvaluationTarget:
    """One grasp on one object with one hand."""

    name: str
    item: dict[str, Any]
    """Item of a sweep of `JUDGE`, without its draw."""
    case: TrialCase
    spec: HandSpec

    @property
    def side(self) -> Side:
        return self.spec.side


class Campaign(NamedTuple):
    """Items of a sweep of `JUDGE`, with their inputs."""

    items: list[dict[str, Any]]
    shared: dict[str, Any]
    stamps: dict[str, str]
    """What is asked: of which targets, under which rules, with which draws."""
    inputs: list[Mapping[str, str]]
    """Inputs of each item: all that its trial reads, by name and fingerprint."""


def find_targets(paths: Iterable[Path], options: TargetOptions = TargetOptions()) -> list[EvaluationTarget]:
    """A target for every scenario and every grasp of a file, and each side. Raises ConfigError, also for targets that
    are under different protocols: their results do not compare."""
    found = [target for path in paths for target in _targets(path.resolve(), options)]
    check_one_protocol(found)
    places = [(str(target.item.get("scenario")), target.item.get("row"), target.side) for target in found]
    twice = next((t.name for t, place in zip(found, places, strict=True)
                  if "scenario" in t.item and places.count(place) > 1), None)  # fmt: skip
    if twice is not None:
        raise ConfigError(f"{twice}: asked for twice")
    return found


def check_one_protocol(targets: Iterable[EvaluationTarget]) -> None:
    """Raises ConfigError for targets under different ones."""
    rules = {target.case.rules or target.case.scenario.protocol: target.name for target in targets}
    if len(rules) > 1:
        said = ", ".join(f"{protocol} ({name})" for protocol, name in rules.items())
        raise ConfigError(f"results under different protocols do not compare: {said}; say --protocol")


def make_campaign(targets: Sequence[EvaluationTarget], noise: SamplingSettings, *, metrics: bool = False) -> Campaign:
    """A trial without a draw of every target and one for each draw, in that order. Other targets, another protocol,
    seed or uncertainty make another sweep; more draws go on with the same one; changed inputs are tried again. Raises
    ConfigError."""
    each = [None, *(asdict(draw) for draw in sample_perturbations(noise.uncertainty, noise.n, noise.seed))]
    items = [target.item | {"draw": draw} for target in targets for draw in each]
    inputs_of, inputs = InputFingerprints(), list[Mapping[str, str]]()
    for target in targets:
        file = Path(target.item["file"]) if "file" in target.item else None
        inputs += [inputs_of(target.case, target.spec, target.name, file)] * len(each)
    shared: dict[str, Any] = {"threads": 1, "metrics": metrics}
    if targets and targets[0].spec.serial:
        shared["serial"] = targets[0].spec.serial
    return Campaign(items, shared, _stamps(targets, noise), inputs)


def _targets(path: Path, options: TargetOptions) -> Iterator[EvaluationTarget]:
    if path.suffix == ".npy" or "grasps" in read_yaml(path):
        yield from _of_file(path, options)
        return
    scenario, _ = load_scenario(path)
    named = {"protocol": options.protocol, "grasp": options.grasp, "object": options.object}
    for side in options.sides or (_own_side(options) or scenario.side,):
        item = {"scenario": str(path), "side": side, **{k: v for k, v in named.items() if v is not None}}
        spec = load_spec(hand_name(item), side, options.serial)
        yield EvaluationTarget(path.stem, item, load_case(item, spec), spec)


def _of_file(path: Path, options: TargetOptions) -> Iterator[EvaluationTarget]:
    if options.sides is not None and len(options.sides) > 1:
        raise ConfigError(f"{path}: its grasps are of one hand; say --side right or --side left")
    if options.grasp is not None:
        raise ConfigError(f"{path}: holds its own grasps; --grasp is for scenarios")
    protocol = options.protocol or FLOATING
    if not load_protocol(protocol).floating:
        raise ConfigError(f"{path}: its grasps know of no table, which {protocol} has: say --protocol fc or strength")
    own = own_hand(path)
    hand = options.hand or own.model or HAND
    side = options.sides[0] if options.sides else own.side or _own_side(options) or card_side(hand) or "right"
    spec = load_spec(hand, side, options.serial)
    for row in range(len(load_grasps(path, spec))):
        item: dict[str, Any] = {"file": str(path), "row": row, "side": side, "protocol": protocol}
        item |= {} if hand == HAND else {"hand": spec.model_reference}
        item |= {} if options.object is None else {"object": options.object}
        yield EvaluationTarget(f"{path.stem}_{row}", item, load_case(item, spec), spec)


def _own_side(options: TargetOptions) -> Side | None:
    return hand_side(options.serial) if options.serial else None


def _stamps(targets: Sequence[EvaluationTarget], noise: SamplingSettings) -> dict[str, str]:
    rules, serial = targets[0].case, targets[0].spec.serial
    return ({"hand": Path(serial).stem} if serial else {}) | {
        "targets": _named(targets),
        "protocol": f"{Path(rules.rules or rules.scenario.protocol).stem} {rules.ruled.version}",
        "seed": str(noise.seed),
        "uncertainty": _said(noise.uncertainty),
    }


def _named(targets: Sequence[EvaluationTarget]) -> str:
    """Each as it was asked for; of many, how many and their fingerprint."""
    names = []
    for target in targets:
        item = target.item
        other = " ".join(f"{key}={item[key]}" for key in ("grasp", "object") if item.get(key) is not None)
        names.append(f"{target.name} {target.side}{' ' if other else ''}{other}")
    return ", ".join(names) if len(names) <= _NAMED else f"{len(names)} of {fingerprint(names)}"


def _said(uncertainty: Uncertainty) -> str:
    """Every digit, since it is compared: m, degrees, fractions."""
    return ", ".join(f"{name} {value}" for name, value in uncertainty.model_dump().items())
