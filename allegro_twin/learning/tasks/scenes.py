"""Scenes of tasks with an object: a scenario of the package, its object presented or standing on a table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.scenario import Scenario, load_protocol, load_scenario
from allegro_twin.grasping.timeline import stage
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.learning.environments.objects import Given, name_of, scenario_of, scenarios
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.sim.batch.warp import WarpWorlds
from allegro_twin.sim.batch.worlds import Worlds
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.objects.catalogue import N_SIZES, Placement, Thing
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector

if TYPE_CHECKING:
    import mujoco

THING = "object"
"""What every object is called in these scenes, so that they have the same layout."""
_COARSE = (10.0, 10, 1e-5)  # impratio, iterations and tolerance of the solver.


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
def known(hand: str = HAND) -> dict[str, str]:
    """The scenarios of the catalogue's objects for a model of hand, read once."""
    return scenarios(hand)


def from_above(hand: str = HAND) -> tuple[str, ...]:
    """The objects that are grasped from above."""
    return tuple(name for name, path in known(hand).items() if load_scenario(path)[0].wrist.retreat[2] > 0)


def some(names: tuple[str, ...], spec: HandSpec, task: str) -> tuple[str, ...]:
    """The objects of a task by default. Raises ConfigError for a hand that the package knows no grasps of."""
    if not names:
        raise ConfigError(f"{task}: the package has no scenarios of {spec.model}: give objects=('scenario.yaml', …) "
                          f"as allegro-twin plan OBJECT --hand {spec.model_reference} writes them")  # fmt: skip
    return names


def presented(
    given: Given, spec: HandSpec, settings: EnvSettings, grasp: str | None = None, scenario: str | None = None
) -> Scene:
    """An object in somebody's fingers before a hand that stands still."""
    found, around, retreat = _found(given if scenario is None else str(load_scenario(scenario)[1]), spec)
    position = np.asarray(around.position) - retreat
    around = replace(around, position=position, wrist=False, table=False, stand=None, presented=True)
    return _built(name_of(given), around, retreat, spec, settings, grasp or found.grasp)


def on_table(given: Given, spec: HandSpec, settings: EnvSettings, grasp: str | None = None) -> Scene:
    """An object on a table under a hand that a slide lowers. Raises ConfigError for one grasped from the side."""
    found, around, retreat = _found(given, spec)
    if retreat[2] <= 0:
        raise ConfigError(
            f"{name_of(given)} is grasped from its side; the slide serves {', '.join(from_above(spec.model))}"
        )
    return _built(name_of(given), replace(around, slide=True), retreat, spec, settings, grasp or found.grasp)


def _found(given: Given, spec: HandSpec) -> tuple[Scenario, Stage, Vector]:
    settings, folder = scenario_of(given, known(spec.model))
    if settings.model != spec.model:
        raise ConfigError(f"{name_of(given)}: its scenario is for the hand {settings.model}, and this one "
                          f"is {spec.model}: allegro-twin plan OBJECT --hand {spec.model_reference} makes one"
        )  # fmt: skip
    mirror = np.array([1.0, -1.0 if spec.side == "left" else 1.0, 1.0])
    around = stage(settings, load_protocol(settings.protocol), spec.side, folder)
    return settings, around, mirror * settings.wrist.retreat


def _built(name: str, around: Stage, retreat: Vector, spec: HandSpec, settings: EnvSettings, grasp: str) -> Scene:
    placed = around.things[0]
    thing = replace(placed, thing=replace(placed.thing, name=THING))
    # On a device a geom has the same type in all simulations.
    one_layout = settings.device != "cpu" and placed.thing.shape in N_SIZES
    model = compiled(spec, replace(around, things=[thing], every_shape=one_layout), settings)
    pose = np.concatenate([placed.position, placed.quaternion])
    return Scene(name, load_grasp(grasp, spec), model, pose, retreat)


PALM = 0.0111
"""m: the palm's surface above the palm's origin, where it looks up."""
FACING = quaternion_facing((0, 0, 1), (1, 0, 0))
"""Of the upturned palm in the world: its x points up, its fingers along the world's x."""


def upturned(
    spec: HandSpec, thing: Thing, place: tuple[float, float, float], settings: EnvSettings, friction: float = 0.8
) -> mujoco.MjModel:
    """An object at a place (3,), m, over the palm that looks up. The fingers point along the world's x, so the palm's
    x is up and its y the world's y."""
    placed = Placement(replace(thing, name=THING), place, (1.0, 0.0, 0.0, 0.0))
    around = Stage(np.zeros(3), FACING, [placed], friction=friction)
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
    return WarpWorlds(spec, model, n, device=settings.device, **room)
