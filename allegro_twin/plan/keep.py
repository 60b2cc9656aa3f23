"""What was found, as files that run: a scenario each, and the grasp that it names."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from allegro_twin.evaluate.scenario import ObjectSettings, Scenario
from allegro_twin.files import edit
from allegro_twin.library.entries import GraspFile, grasp_entry
from allegro_twin.library.library import Library
from allegro_twin.plan.search import Planned
from allegro_twin.spec import HandSpec


def written(found: Sequence[Planned], name: str, folder: Path, spec: HandSpec) -> list[Path]:
    """Write <folder>/<name>_1.yaml … with the grasps in <folder>/grasps/; the scenarios, best first. Raises ConfigError
    for a name that is none, RecordingError when the disk does not let it."""
    paths = []
    for number, planned in enumerate(found, 1):
        stem = f"{name}_{number}"
        path = folder / f"{stem}.yaml"
        stored(planned, stem, folder / "grasps" / f"{stem}.yaml", spec, evidence=stem)
        _write(path, _plain(planned.scenario, f"grasps/{stem}.yaml", folder, in_words(planned)))
        paths.append(path)
    return paths


def stored(planned: Planned, name: str, path: Path, spec: HandSpec, evidence: str) -> None:
    """Store the grasp under a name in a library file. Raises ConfigError or RecordingError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    library = Library(path.parent)
    library.add(name, entry_of(planned, spec, evidence), spec)
    library.store(name, path)


def entry_of(planned: Planned, spec: HandSpec, evidence: str = "") -> GraspFile:
    """As the library stores it; the other hand's is its mirror image."""
    grasp = planned.grasp
    postures = {"preshape": grasp.preshape, "close": grasp.close, "squeeze": grasp.squeeze}
    return grasp_entry(postures, spec, grasp.taxonomy, in_words(planned), evidence)


def in_words(planned: Planned) -> str:
    """What was shown of it."""
    thing = planned.scenario.objects[0].name
    return (
        f"Planned for {thing}, from the {planned.candidate.direction}: held in {100 * planned.success:.0f} % of the "
        f"search's draws, {100 * planned.margin:.0f} % of the limits left without noise"
    )


def _plain(scenario: Scenario, grasp: str, folder: Path, description: str) -> dict[str, Any]:
    """What a file says of a scenario, and no default."""
    content = scenario.model_dump(mode="json", exclude_defaults=True)
    content["objects"] = [_object(thing, folder) for thing in scenario.objects]
    content |= {"description": description, "friction": scenario.friction, "grasp": grasp}
    return {key: content[key] for key in ("description", "objects", *content) if key in content}


def _object(thing: ObjectSettings, folder: Path) -> dict[str, Any]:
    content = thing.model_dump(mode="json", exclude_defaults=True)
    if thing.file is not None:
        content["file"] = os.path.relpath(thing.file, folder)
    return content


def _write(path: Path, content: dict[str, Any]) -> None:
    with edit.locked(path):
        edit.write_text(path, edit.with_document("", content, str(path)))
