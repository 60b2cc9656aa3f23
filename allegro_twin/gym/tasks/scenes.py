"""Scenes of tasks with an object: a scenario of the package, its object presented or standing on a table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.evaluate.scenario import Scenario, load_protocol, load_scenario
from allegro_twin.evaluate.timeline import stage
from allegro_twin.files.assets import data_root
from allegro_twin.gym.settings import EnvSettings
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.library.grasps import Grasp
from allegro_twin.library.named import load_grasp
from allegro_twin.sim.batch import Worlds
from allegro_twin.sim.objects import Placement, Thing
from allegro_twin.sim.scene import Stage, compile_scene
from allegro_twin.sim.warp import WarpWorlds
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector

if TYPE_CHECKING:
    import mujoco

THING = "object"
"""What every object is called in these scenes, so that they have the same layout."""
_COARSE = (10.0, 10, 1e-5)  # impratio, iterations and tolerance of the solver.
FOLDERS = ("demo", "more")


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One object, the grasp for it, and where both are when the fingers close."""

    thing: str
    grasp: Grasp
    model: mujoco.MjModel
    pose: Vector
    """Of the object, position and quaternion in the world, (7,), m."""
    retreat: Vector
    """From the place of the grasp to where the palm waits, seen from the object, (3,), m, world axes."""


@cache
def scenarios() -> dict[str, str]:
    """For every object that the package knows how to grasp, the scenario that says where the palm goes."""
    files = [file for folder in FOLDERS for file in sorted((data_root() / "scenarios" / folder).glob("*.yaml"))]
    return {load_scenario(file)[0].objects[0].name: str(file) for file in files}


def from_above() -> tuple[str, ...]:
    """The objects that are grasped from above."""
    return tuple(name for name in scenarios() if load_scenario(scenarios()[name])[0].wrist.retreat[2] > 0)


def presented(
    name: str, spec: HandSpec, settings: EnvSettings, grasp: str | None = None, scenario: str | None = None
) -> Scene:
    """An object in somebody's fingers before a hand that stands still."""
    found, around, retreat = _found(name, spec, scenario)
    position = np.asarray(around.position) - retreat
    around = replace(around, position=position, wrist=False, table=False, stand=None, presented=True)
    return _built(name, around, retreat, spec, settings, grasp or found.grasp)


def on_table(name: str, spec: HandSpec, settings: EnvSettings, grasp: str | None = None) -> Scene:
    """An object on a table under a hand that a slide lowers. Raises ConfigError for one grasped from the side."""
    found, around, retreat = _found(name, spec, None)
    if retreat[2] <= 0:
        raise ConfigError(f"{name} is grasped from its side; the slide serves {', '.join(from_above())}")
    return _built(name, replace(around, slide=True), retreat, spec, settings, grasp or found.grasp)


def _found(name: str, spec: HandSpec, scenario: str | None) -> tuple[Scenario, Stage, Vector]:
    if scenario is None and name not in scenarios():
        raise ConfigError(unknown("object", name, scenarios()))
    settings, path = load_scenario(scenario or scenarios()[name])
    mirror = np.array([1.0, -1.0 if spec.side == "left" else 1.0, 1.0])
    return (
        settings,
        stage(settings, load_protocol(settings.protocol), spec.side, path.parent),
        mirror * settings.wrist.retreat,
    )


def _built(name: str, around: Stage, retreat: Vector, spec: HandSpec, settings: EnvSettings, grasp: str) -> Scene:
    placed = around.things[0]
    thing = replace(placed, thing=replace(placed.thing, name=THING))
    model = compiled(spec, replace(around, things=[thing]), settings)
    pose = np.concatenate([placed.position, placed.quaternion])
    return Scene(name, load_grasp(grasp, spec), model, pose, retreat)


PALM = 0.0111
"""m: the palm's surface above the palm's origin, where it looks up."""


def upturned(
    spec: HandSpec, thing: Thing, place: tuple[float, float, float], settings: EnvSettings, friction: float = 0.8
) -> mujoco.MjModel:
    """An object at a place (3,), m, over the palm that looks up. The fingers point along the world's x, so the palm's
    x is up and its y the world's y."""
    placed = Placement(replace(thing, name=THING), place, (1.0, 0.0, 0.0, 0.0))
    around = Stage(np.zeros(3), quaternion_facing((0, 0, 1), (1, 0, 0)), [placed], friction=friction)
    return compiled(spec, around, settings)


def compiled(spec: HandSpec, around: Stage, settings: EnvSettings) -> mujoco.MjModel:
    """The model of a scene, with the physics that the settings ask for."""
    model = compile_scene(spec, around)
    model.opt.timestep, model.opt.noslip_iterations = settings.timestep, settings.noslip
    if settings.coarse:
        model.geom_condim[:] = np.minimum(model.geom_condim, 3)
        model.opt.impratio, model.opt.iterations, model.opt.tolerance = _COARSE
    return model


def worlds(spec: HandSpec, model: mujoco.MjModel, n: int, threads: int, settings: EnvSettings) -> Worlds:
    """`n` simulations that begin as `model`, on the device that the settings name."""
    if settings.device == "cpu":
        return Worlds(spec, model, n, threads)
    room = {"contacts": settings.contacts, "constraints": settings.constraints}
    return WarpWorlds(spec, model, n, threads, device=settings.device, **room)
