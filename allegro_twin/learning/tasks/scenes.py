"""Scenes of tasks with an object: a scenario's object, presented, standing on a table, or over the upturned palm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.scenario import Scenario, as_written, load_protocol, load_scenario
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.kinematics.orientation import quaternion_facing, quaternion_product
from allegro_twin.learning.environments.objects import ObjectChoice, object_name, object_scenarios, scenario_of
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.tasks.vectors import rotate_vectors
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.cpu import CpuBatch
from allegro_twin.sim.batch.shared_model import SharedModelBatch
from allegro_twin.sim.batch.warp import WarpBatch
from allegro_twin.sim.model.parts import top_of_palm
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.objects.catalogue import SIZES_OF_KIND, GraspObject, PlacedObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

if TYPE_CHECKING:
    import mujoco

OBJECT = "object"
"""Name of every object in these scenes, so that they have the same layout."""
_COARSE = (10.0, 10, 1e-5)  # impratio, iterations and tolerance of the solver.


@dataclass(frozen=True, slots=True, eq=False)
class TaskScene:
    """One object, the grasp for it, and where both are when the fingers close."""

    object_name: str
    grasp: Grasp
    model: mujoco.MjModel
    pose: Vector
    """Pose of the object in the world: position, m, and quaternion w, x, y, z, (7,)."""
    retreat: Vector
    """From the place of the grasp to where the palm waits, relative to the object, (3,), m, world axes."""


GIVE_OBJECTS = (
    "give objects=('scenario.yaml', …), or the path of a recipe with `environment: {objects: [scenario.yaml, …]}`"
)
"""How to say what a task is done with, in Python and on the command line."""


@cache
def known_scenarios(hand: str = HAND) -> dict[str, str]:
    """Scenarios of the catalogue's objects for a model of hand, read once."""
    return object_scenarios(hand)


def grasped_from_above(hand: str = HAND) -> tuple[str, ...]:
    """Objects that are grasped from above."""
    return tuple(name for name, path in known_scenarios(hand).items() if load_scenario(path)[0].wrist.retreat[2] > 0)


def require_objects(names: tuple[str, ...], spec: HandSpec, task: str) -> tuple[str, ...]:
    """The default objects of a task. Raises ConfigError for a hand without grasps in the package."""
    if not names:
        raise ConfigError(f"{task}: the package has no scenarios of {spec.model}: {GIVE_OBJECTS}, as allegro-twin plan "
                          f"OBJECT --hand {spec.model_reference} writes them")  # fmt: skip
    return names


def presented_scene(
    choice: ObjectChoice, spec: HandSpec, settings: EnvSettings, grasp: str | None = None, scenario: str | None = None
) -> TaskScene:
    """An object in a presenter's fingers before a hand that stands still."""
    found, surroundings, retreat = _find_scenario(choice if scenario is None else str(load_scenario(scenario)[1]), spec)
    position = np.asarray(surroundings.position) - retreat
    surroundings = replace(surroundings, position=position, wrist=False, table=False, stand=None, presented=True)
    return _build_scene(object_name(choice), surroundings, retreat, spec, settings, grasp or found.grasp)


def table_scene(choice: ObjectChoice, spec: HandSpec, settings: EnvSettings, grasp: str | None = None) -> TaskScene:
    """An object on a table under a hand that a slide lowers onto the scenario's grasp. Raises ConfigError for an object
    that is grasped from the side."""
    found, surroundings, retreat = _find_scenario(choice, spec)
    if retreat[2] <= 0:
        raise ConfigError(
            f"{object_name(choice)} is grasped from its side; the slide serves "
            f"{', '.join(grasped_from_above(spec.model))}"
        )
    # The slide is vertical: a palm that a scenario brings from aside begins straight above its grasp.
    aside = retreat * np.array([1.0, 1.0, 0.0])
    surroundings = replace(surroundings, position=np.asarray(surroundings.position) - aside, slide=True)
    return _build_scene(object_name(choice), surroundings, retreat - aside, spec, settings, grasp or found.grasp)


def _find_scenario(choice: ObjectChoice, spec: HandSpec) -> tuple[Scenario, Stage, Vector]:
    settings, folder = scenario_of(choice, known_scenarios(spec.model))
    if settings.model != spec.model:
        raise ConfigError(
            f"{object_name(choice)}: its scenario is for the hand {settings.model}, and this one is {spec.model}: "
            f"allegro-twin plan OBJECT --hand {spec.model_reference} makes one"
        )
    if "side" in settings.model_fields_set and settings.side != spec.side:
        raise ConfigError(
            f"{object_name(choice)}: its scenario is for the {settings.side} hand (its `side`), and this one is the "
            f"{spec.side} one: say side={settings.side!r}, or leave one of them out"
        )
    surroundings = make_stage(settings, load_protocol(settings.protocol), spec.side, folder)
    return settings, surroundings, as_written(spec.side) * settings.wrist.retreat


def _build_scene(
    name: str, surroundings: Stage, retreat: Vector, spec: HandSpec, settings: EnvSettings, grasp: str
) -> TaskScene:
    placed = surroundings.objects[0]
    obj = replace(placed, grasp_object=replace(placed.grasp_object, name=OBJECT))
    # On a device a geom has the same type in all simulations.
    one_layout = settings.device != "cpu" and placed.grasp_object.shape in SIZES_OF_KIND
    model = compile_task_scene(
        spec, replace(surroundings, objects=[obj], every_shape=one_layout, sensed=True), settings
    )
    pose = np.concatenate([placed.position, placed.quaternion])
    return TaskScene(name, load_grasp(grasp, spec), model, pose, retreat)


FACING = quaternion_facing((0, 0, 1), (1, 0, 0))
"""Orientation of the upturned palm in the world: its x points up, its fingers along the world's x."""


@cache
def palm_height(spec: HandSpec) -> float:
    """Height of the palm's surface above the palm's origin in the upturned hand, m: the top of the palm's contact
    shapes."""
    return top_of_palm(compile_scene(spec, Stage(np.zeros(3), FACING, [])), spec)


def upturned_model(
    spec: HandSpec,
    obj: GraspObject,
    place: tuple[float, float, float],
    settings: EnvSettings,
    friction: float = 0.8,
    *,
    every_shape: bool = False,
) -> mujoco.MjModel:
    """Model of an object at a place (3,), m, over the upturned palm. The fingers point along the world's x, so the
    palm's x is up and its y the world's y."""
    placed = PlacedObject(replace(obj, name=OBJECT), place, (1.0, 0.0, 0.0, 0.0))
    surroundings = Stage(np.zeros(3), FACING, [placed], friction=friction, every_shape=every_shape, sensed=True)
    return compile_task_scene(spec, surroundings, settings)


def compile_task_scene(spec: HandSpec, surroundings: Stage, settings: EnvSettings) -> mujoco.MjModel:
    """Compile a scene, with the physics of the settings."""
    model = compile_scene(spec, surroundings)
    model.opt.timestep, model.opt.noslip_iterations = settings.timestep, settings.noslip
    if settings.coarse:
        model.geom_condim[:] = np.minimum(model.geom_condim, 3)
        model.opt.impratio, model.opt.iterations, model.opt.tolerance = _COARSE
    return model


def make_worlds(spec: HandSpec, model: mujoco.MjModel, n: int, threads: int, settings: EnvSettings) -> SharedModelBatch:
    """Make `n` simulations that begin as `model`, on the device of the settings."""
    if settings.device == "cpu":
        return CpuBatch(spec, model, n, threads)
    room = {"contacts": settings.contacts, "constraints": settings.constraints}
    return WarpBatch(spec, model, n, device=settings.device, **room)


def add_variant(worlds: SharedModelBatch, model: mujoco.MjModel, name: str, first: str) -> None:
    """Add the scene of another object to simulations that began with the `first` one's. Raises ConfigError, with both
    names, for objects that no simulation can change into each other."""
    try:
        worlds.add(model)
    except ConfigError as error:
        raise not_one_environment(name, first, str(error)) from error


def not_one_environment(name: str, first: str, why: str) -> ConfigError:
    """Error for two objects that are not of one environment."""
    return ConfigError(
        f"objects {first} and {name} are not of one environment ({why}): make one environment for each mesh and MJCF, "
        "and one for all other objects"
    )


def palm_turn(worlds: SharedModelBatch, rows: Rows, before: Array) -> Array:
    """How palms of simulations have turned from orientations `before`, (4,) or (m, 4), to those of their models:
    rotations in world axes, (m, 4)."""
    now = worlds.expand("body_quat")[rows, worlds.model.body("palm_link").id]
    back = worlds.xp.concatenate([before[..., :1], -before[..., 1:]], axis=-1)
    turn: Array = quaternion_product(now, 0.0 * now + back)
    return turn


def turn_with_palm(worlds: SharedModelBatch, variant: Rows, turn: Array, pose: Array) -> Array:
    """Poses (m, 7), world, m, after a turn (m, 4) about the palm's origin: what is in the hand keeps its place in the
    palm's frame."""
    xp, palm = worlds.xp, worlds.model.body("palm_link").id
    origin = xp.asarray(np.stack([model.body_pos[palm] for model in worlds.models]))[variant]
    place = origin + rotate_vectors(turn, pose[:, :3] - origin)
    found: Array = xp.concatenate([place, quaternion_product(turn, pose[:, 3:])], axis=-1)
    return found
