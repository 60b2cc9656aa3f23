"""Objects of environments, as a user names them: from the catalogue, a scenario, a mesh, or a description."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import BeforeValidator

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import parse_settings
from allegro_twin.grasping.scenario import Scenario, ScenarioObject, load_protocol, load_scenario
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.settings import scenario_files
from allegro_twin.sim.objects import catalogue as objects
from allegro_twin.sim.objects.catalogue import GraspObject

FOLDERS: dict[str, tuple[str, ...]] = {HAND: ("demo", "more")}
"""Folders of scenarios with one object each. Folders of other hands have the hand's name."""
MESHES = (".obj", ".stl")


class OwnObject(ScenarioObject):
    """An object as in a scenario, and the catalogue's object that it is grasped like. A relative path starts at the
    current folder."""

    like: str | None = None
    """An object of the catalogue: the hand approaches and grasps this one in the same way."""


def _read(value: Any) -> Any:
    """Read a mapping, or the path of a mesh."""
    if isinstance(value, dict):
        return parse_settings(OwnObject, value, "objects")
    if isinstance(value, str) and Path(value).suffix.lower() in MESHES:
        return OwnObject(name=Path(value).stem, shape="mesh", file=Path(value))
    return value


ObjectChoice: TypeAlias = Annotated[str | OwnObject, BeforeValidator(_read)]
"""A name in the catalogue, the path of a scenario, or an object."""


def object_scenarios(hand: str = HAND) -> dict[str, str]:
    """The scenario of every object that the package can grasp with a model of hand. It says where the palm goes."""
    folders = [data_root() / "scenarios" / name for name in FOLDERS.get(hand, (hand,))]
    files = [file for folder in folders for file in sorted(folder.glob("*.yaml"))]
    return {load_scenario(file)[0].objects[0].name: str(file) for file in files}


def object_name(choice: ObjectChoice) -> str:
    """Name of the object in reports."""
    if isinstance(choice, OwnObject):
        return choice.name
    return load_scenario(choice)[0].objects[0].name if _is_scenario(choice) else choice


def scenario_of(choice: ObjectChoice, known: dict[str, str]) -> tuple[Scenario, Path]:
    """The scenario of an object, which says where the palm goes and how it grasps; and the folder of the files named
    there. `known`: scenarios of the catalogue. Raises ConfigError for an object without a scenario."""
    if isinstance(choice, OwnObject):
        if choice.like is None:
            raise ConfigError(
                f"how the hand should grasp {choice.name} is not said: give it like='an object of the catalogue', or "
                "instead of it a scenario (allegro-twin plan makes one)"
            )
        scenario, _ = load_scenario(_catalogue_scenario(choice.like, known))
        return scenario.model_copy(update={"objects": (choice,)}), Path.cwd()
    found, path = load_scenario(choice if _is_scenario(choice) else _catalogue_scenario(choice, known))
    return found, path.parent


def load_object(choice: ObjectChoice) -> GraspObject:
    """The object itself. Raises ConfigError."""
    if isinstance(choice, str) and not _is_scenario(choice):
        return objects.load_object(choice)
    if isinstance(choice, OwnObject) and choice.like is None:
        choice = choice.model_copy(update={"like": "rubiks_cube"})
    scenario, folder = scenario_of(choice, object_scenarios())
    return make_stage(scenario, load_protocol(scenario.protocol), "right", folder).objects[0].grasp_object


def _is_scenario(choice: str) -> bool:
    return bool(scenario_files((choice,)))


def _catalogue_scenario(name: str, known: dict[str, str]) -> str:
    if not known:
        raise ConfigError(f"the package has no scenario of this hand for {name}: give a scenario instead "
                          "(allegro-twin plan makes one)")  # fmt: skip
    if name not in known:
        raise ConfigError(unknown("object", name, known))
    return known[name]
