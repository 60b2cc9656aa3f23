"""Objects as a user names them: of the catalogue, a scenario's, a mesh, or described on the spot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import BeforeValidator

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import parse_settings
from allegro_twin.grasping.scenario import ObjectSettings, Scenario, load_protocol, load_scenario
from allegro_twin.grasping.timeline import stage
from allegro_twin.hands.library.entries import HAND
from allegro_twin.sim.objects import catalogue as objects
from allegro_twin.sim.objects.catalogue import Thing

FOLDERS: dict[str, tuple[str, ...]] = {HAND: ("demo", "more")}
"""Of scenarios, an object in each; another hand's have its name."""
SCENARIOS, MESHES = (".yaml", ".yml"), (".obj", ".stl")


class OwnObject(ObjectSettings):
    """An object as a scenario has it, and what it is grasped like. A relative path is the current folder's."""

    like: str | None = None
    """An object of the catalogue: the hand comes to this one as to that, with the same grasp."""


def _read(value: Any) -> Any:
    """From what a user writes: a mapping, or the path of a mesh."""
    if isinstance(value, dict):
        return parse_settings(OwnObject, value, "objects")
    if isinstance(value, str) and Path(value).suffix.lower() in MESHES:
        return OwnObject(name=Path(value).stem, shape="mesh", file=Path(value))
    return value


Given: TypeAlias = Annotated[str | OwnObject, BeforeValidator(_read)]
"""A name of the catalogue, a path of a scenario, or an object."""


def scenarios(hand: str = HAND) -> dict[str, str]:
    """For every object that the package knows how to grasp with a model of hand, the scenario that says where the palm
    goes."""
    folders = [data_root() / "scenarios" / name for name in FOLDERS.get(hand, (hand,))]
    files = [file for folder in folders for file in sorted(folder.glob("*.yaml"))]
    return {load_scenario(file)[0].objects[0].name: str(file) for file in files}


def name_of(given: Given) -> str:
    """What it is called in reports."""
    if isinstance(given, OwnObject):
        return given.name
    return load_scenario(given)[0].objects[0].name if _is_scenario(given) else given


def scenario_of(given: Given, known: dict[str, str]) -> tuple[Scenario, Path]:
    """Where the palm goes and how it grasps, and the folder of the files named there; `known` has the catalogue's
    scenarios. Raises ConfigError for an object that nobody has said this of."""
    if isinstance(given, OwnObject):
        if given.like is None:
            raise ConfigError(
                f"how the hand should grasp {given.name} is not said: give it like='an object of the catalogue', or "
                "instead of it a scenario (allegro-twin plan makes one)"
            )
        scenario, _ = load_scenario(_of(given.like, known))
        return scenario.model_copy(update={"objects": (given,)}), Path.cwd()
    found, path = load_scenario(given if _is_scenario(given) else _of(given, known))
    return found, path.parent


def thing_of(given: Given) -> Thing:
    """The object alone. Raises ConfigError."""
    if isinstance(given, str) and not _is_scenario(given):
        return objects.named(given)
    if isinstance(given, OwnObject) and given.like is None:
        given = given.model_copy(update={"like": "rubiks_cube"})
    scenario, folder = scenario_of(given, scenarios())
    return stage(scenario, load_protocol(scenario.protocol), "right", folder).things[0].thing


def _is_scenario(given: str) -> bool:
    return Path(given).suffix in SCENARIOS


def _of(name: str, known: dict[str, str]) -> str:
    if not known:
        raise ConfigError(f"the package has no scenario of this hand for {name}: give a scenario instead "
                          "(allegro-twin plan makes one)")  # fmt: skip
    if name not in known:
        raise ConfigError(unknown("object", name, known))
    return known[name]
