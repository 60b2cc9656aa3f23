"""The command that writes a JSON Schema for each kind of YAML file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.surfaces.cli import options

if TYPE_CHECKING:
    from allegro_twin.files.schema import Settings

PLACES = {
    "config": "conf/*.yaml",
    "scenario": "scenarios/**/*.yaml",
    "protocol": "conf/protocols/*.yaml",
    "posture": "conf/postures/*.yaml",
    "grasp": "conf/grasps/*.yaml",
    "trajectory": "conf/trajectories/*.yaml",
    "recipe": "conf/training/*.yaml",
    "pick": "conf/pick/*.yaml",
    "mpc": "conf/mpc/*.yaml",
    "lab": "conf/lab_*.yaml",
}
"""Where the shipped files of each kind are."""


def schemas(
    folder: Annotated[Path, typer.Argument(help="Folder for the .schema.json files.", callback=options.folder)],
) -> None:
    """Write JSON Schemas of the YAML files, for an editor."""
    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.files.schema import json_schema
    from allegro_twin.surfaces.cli import console

    for kind, model in models().items():
        text = json.dumps(json_schema(model, f"allegro-twin: {kind}"), indent=2, ensure_ascii=False)
        with atomic_file(folder / f"{kind}.schema.json") as temporary:
            temporary.write_text(text + "\n")
    settings = {str(folder / f"{kind}.schema.json"): place for kind, place in PLACES.items()}
    console.say(f"{len(settings)} schemas in {folder}; for VS Code's YAML extension, in settings.json:")
    console.console.print_json(json.dumps({"yaml.schemas": settings}))


def models() -> dict[str, type[Settings]]:
    """The settings class of each kind of file."""
    from allegro_twin.app.config import RunConfig
    from allegro_twin.cell.settings import LabSettings
    from allegro_twin.grasping.scenario import Scenario, TrialProtocol
    from allegro_twin.hands.library.entries import GraspFile, PostureFile, TrajectoryFile
    from allegro_twin.learning.mpc.settings import MpcSettings
    from allegro_twin.learning.training.settings import Recipe
    from allegro_twin.pick.recipe import PickRecipe

    return {
        "config": RunConfig,
        "scenario": Scenario,
        "protocol": TrialProtocol,
        "posture": PostureFile,
        "grasp": GraspFile,
        "trajectory": TrajectoryFile,
        "recipe": Recipe,
        "pick": PickRecipe,
        "mpc": MpcSettings,
        "lab": LabSettings,
    }
