"""Files of found grasps: a scenario for each, and the grasp that it names."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from allegro_twin.errors import ConfigError
from allegro_twin.files import yaml_edit
from allegro_twin.files.assets import refuse_shipped
from allegro_twin.files.atomic_write import check_place
from allegro_twin.grasping.evaluation.outcomes import make_rate
from allegro_twin.grasping.plan.validate import SEARCHED, PlannedGrasp
from allegro_twin.grasping.scenario import Scenario, ScenarioObject, load_protocol
from allegro_twin.grasping.statistics import wilson
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.hands.library.entries import GraspFile, PlanRecord
from allegro_twin.hands.library.entry_files import check_free, check_name, read_all
from allegro_twin.hands.library.grasps import Grasp, entry_from_grasp
from allegro_twin.hands.library.library import Library
from allegro_twin.spec import HandSpec

_FROM = {"above": "from above", "side": "from its side", "oblique": "from above its side"}
GRASPS = "grasps"
"""The folder beside the scenarios."""


def save_grasps(
    found: Sequence[PlannedGrasp], name: str, folder: Path, spec: HandSpec, uncertainty: Uncertainty = SEARCHED,
    read_in: Path | None = None,
) -> list[Path]:  # fmt: skip
    """Write <folder>/<name>_1.yaml …, best first, with their grasps; the scenarios. `read_in`: where they will lie,
    from which they name meshes and cards; by default the folder. Raises ConfigError for a name that is none,
    RecordingError when the disk does not let it."""
    return [
        save_grasp(
            planned.scenario, planned.grasp, f"{name}_{number}", folder, spec, describe(planned, spec),
            make_proof(planned, uncertainty), read_in,
        )
        for number, planned in enumerate(found, 1)
    ]  # fmt: skip


def check_names(name: str, n: int) -> None:
    """Raise ConfigError unless `save_grasps` may use the names of so many grasps for an object."""
    for number in range(1, n + 1):
        check_free(check_name(f"{name}_{number}", "library"))


def check_store(name: str, n: int, folder: Path) -> None:
    """Raise ConfigError or RecordingError unless so many grasps of an object can be stored in a library's folder, where
    nothing is replaced: an entry may be another hand's, or changed by hand."""
    files = [folder / f"{name}_{number}.yaml" for number in range(1, n + 1)]
    for file in files:
        refuse_shipped(file)
        check_place(file)
    there = read_all([folder])
    if taken := next((there[file.stem] for file in files if file.stem in there), None):
        raise ConfigError(f"{taken.name!r} is in {taken.path} already; delete it there, or use another folder")


def written_out(
    found: Sequence[PlannedGrasp], name: str, folder: Path, spec: HandSpec, uncertainty: Uncertainty
) -> list[tuple[Path, str]]:
    """The files that `save_grasps` would write into a folder, each with its text, for a disk that takes none."""
    files = []
    for number, planned in enumerate(found, 1):
        scenario, grasp = f"{name}_{number}", f"{GRASPS}/{name}_{number}.yaml"
        entry = _entry(planned.grasp, spec, describe(planned, spec), scenario, make_proof(planned, uncertainty))
        contents = {
            f"{scenario}.yaml": _plain(planned.scenario, grasp, folder, describe(planned, spec)),
            grasp: {"kind": entry.kind} | entry.model_dump(mode="json", exclude_unset=True),
        }
        files += [(folder / file, yaml_edit.replace_document("", each, file)) for file, each in contents.items()]
    return files


def save_grasp(
    scenario: Scenario, grasp: Grasp, name: str, folder: Path, spec: HandSpec, description: str,
    proof: PlanRecord | None = None, read_in: Path | None = None,
) -> Path:  # fmt: skip
    """Write <folder>/<name>.yaml, a scenario, and <folder>/grasps/<name>.yaml, the grasp that it names; the first.
    `read_in` as of `save_grasps`."""
    store_grasp(grasp, name, folder / GRASPS / f"{name}.yaml", spec, description, evidence=name, proof=proof)
    path = folder / f"{name}.yaml"
    content = _plain(scenario, f"{GRASPS}/{name}.yaml", read_in or folder, description)
    with yaml_edit.lock_file(path):
        yaml_edit.write_text(path, yaml_edit.replace_document("", content, str(path)))
    return path


def store_grasp(
    grasp: Grasp,
    name: str,
    path: Path,
    spec: HandSpec,
    description: str,
    evidence: str,
    proof: PlanRecord | None = None,
) -> None:
    """Store a grasp under a name in a library file; the other hand's is its mirror image. Raises ConfigError or
    RecordingError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    library = Library(path.parent)
    library.add(name, _entry(grasp, spec, description, evidence, proof), spec)
    library.store(name, path)


def _entry(grasp: Grasp, spec: HandSpec, description: str, evidence: str, proof: PlanRecord | None) -> GraspFile:
    entry = entry_from_grasp(grasp, spec, description, evidence)
    return entry.model_copy(update={} if proof is None else {"planned": proof})


def describe(planned: PlannedGrasp, spec: HandSpec) -> str:
    """What was shown of it, and with which hand where that was one by its own file."""
    planned_for, left = planned.scenario.objects[0].name, f"{100 * planned.margin:.0f} % of the drift limits left"
    if spec.serial:
        planned_for += f" and the hand of {Path(spec.serial).name}"
    said = [f"{left} without noise"]
    if planned.judged:
        drawn = make_rate("", planned.judged_held, planned.judged)
        said.insert(0, f"held in {drawn} draws that it was not chosen on")
    begun = f"begun as {planned.candidate.template}, seed {planned.seed}, {planned.candidates} candidates"
    return f"Planned for {planned_for}, {_FROM[planned.candidate.direction]}: {', '.join(said)}; {begun}"


def make_proof(planned: PlannedGrasp, uncertainty: Uncertainty) -> PlanRecord:
    """Record of a grasp's validation for programs; without draws, an interval that says nothing."""
    protocol = load_protocol(planned.scenario.protocol)
    low, high = wilson(planned.judged_held, planned.judged)
    return PlanRecord(
        seed=planned.seed, candidates=planned.candidates, held=planned.judged_held, draws=planned.judged,
        low=round(low, 4), high=round(high, 4), protocol=f"{Path(planned.scenario.protocol).stem} {protocol.version}",
        uncertainty=", ".join(f"{name} {value}" for name, value in uncertainty.model_dump().items()),
    )  # fmt: skip


def _plain(scenario: Scenario, grasp: str, folder: Path, description: str) -> dict[str, Any]:
    """What a file says of a scenario, and no default."""
    content = scenario.model_dump(mode="json", exclude_defaults=True)
    content["objects"] = [_object(scenario_object, folder) for scenario_object in scenario.objects]
    if scenario.hand.endswith(".yaml"):
        content["hand"] = os.path.relpath(scenario.hand, folder)
    content |= {"description": description, "friction": scenario.friction, "grasp": grasp}
    return {key: content[key] for key in ("description", "objects", *content) if key in content}


def _object(scenario_object: ScenarioObject, folder: Path) -> dict[str, Any]:
    content = scenario_object.model_dump(mode="json", exclude_defaults=True)
    if scenario_object.file is not None:
        content["file"] = os.path.relpath(scenario_object.file, folder)
    return content
