"""What can be chosen of an environment when it is made, and of an episode when it is reset."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, model_validator

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.schema import Positive, Settings, parse_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import HAND
from allegro_twin.learning.environments.objects import Given
from allegro_twin.learning.environments.randomise import Randomise, preset
from allegro_twin.learning.policy.interface import Mode
from allegro_twin.sim.batch.warp_model import Device
from allegro_twin.spec import SIDES, HandSpec, Side

OPTIONS = ("object", "size", "friction", "grasp", "posture", "position_noise")

Level: TypeAlias = Literal["default", "easy"]
OWN = ("observation", "goals", "farthest", "level")
"""Settings that only some tasks have."""


class EnvSettings(Settings):
    """The keyword arguments of `gymnasium.make`."""

    hand: str = HAND
    """A model of hand, or the path of a card of one's own (docs/hands.md#any-mjcf)."""
    side: Side = "right"
    control: Mode = "delta"
    """What an action means: `delta` or `absolute` joint positions, or `torque` of a hand that takes torques."""
    objects: Annotated[tuple[Given, ...], Field(min_length=1)] | None = None
    """Of the catalogue, of scenarios, or one's own (docs/your_task.md); each episode draws one. None: the task's."""
    position_noise: Annotated[float, Field(ge=0, le=0.03)] | None = None
    """An object is off by up to so much along each axis, m. None: the task's own."""
    randomise: Randomise = Randomise()
    """What differs from episode to episode; `default` for everything."""
    period: Positive = 0.003
    """Control period, s."""
    timestep: Positive = 0.001
    """Of the physics, s."""
    noslip: Annotated[int, Field(ge=0)] = 0
    """Solver iterations against the creep of held objects. They double the cost of a step in contact, and without them
    a held object creeps by 0.1 mm/s (docs/models.md#contact), 1 % of what an episode lets pass."""
    coarse: bool = False
    """Contacts without torsional and rolling friction, solved less exactly: for training, half as dear again."""
    decimation: Annotated[int, Field(ge=1)] = 13
    """Control periods between two actions."""
    gains: str = "default"
    """Name in conf/gains."""
    step: Positive | None = None
    """rad of a joint an action, in the mode `delta`. None: the task's own."""
    device: Device = "cpu"
    """Who simulates: `cpu`, MuJoCo; `warp`, MuJoCo Warp on an NVIDIA GPU; `warp:cpu`, its kernels on one processor."""
    contacts: Annotated[int, Field(ge=1)] = 64
    """Room for contacts on a Warp device, for each simulation; twice what the busiest task has (docs/rl.md#gpu)."""
    constraints: Annotated[int, Field(ge=1)] = 256
    """Room for constraints, likewise."""
    reach: Positive = 0.3
    """How far an action may lead from the scripted motion, rad of a joint, where a task has one."""

    history: Annotated[int, Field(ge=1, le=20)] = 1
    """How many decisions an observation shows of the hand, this one and those before."""
    touch: bool = False
    """Observations end with the external torque of every joint, as a twin beside a hand estimates it."""
    state: bool = False
    """Observations are a dictionary with a `state`, too: what only the simulation knows, for a critic."""
    observation: Literal["full", "hand"] = "full"
    """Of tasks with an object in the hand: `hand` leaves out what no hand measures."""
    goals: Literal["any", "yaw"] = "any"
    """Of Reorient: turns about any axis, or about the vertical alone."""
    farthest: Positive | None = None
    """Of Reorient: how far a goal is at most, rad. None: π, and π / 2 about the vertical."""
    level: Level = "default"
    """Of tasks with a scripted grasp: `easy` varies little of the object."""

    @model_validator(mode="before")
    @classmethod
    def _named(cls, given: Any) -> Any:
        """`default` is what there is to vary of that very hand."""
        if not isinstance(given, dict) or "randomise" not in given:
            return given
        return given | {"randomise": preset(given["randomise"], _spec_of(given))}


def _spec_of(given: dict[str, Any]) -> HandSpec | None:
    """Of the hand that is asked for, where it is not the usual one; None, too, where the answer is no name of one."""
    hand, side = given.get("hand", HAND), given.get("side", "right")
    return None if hand == HAND or not isinstance(hand, str) or side not in SIDES else load_spec(hand, side)


class Options(Settings):
    """The `options` of a reset: what this episode does not draw."""

    object: str | None = None
    """Of the catalogue."""
    size: Positive | None = None
    """Factor on the object's size."""
    friction: Annotated[float, Field(gt=0, le=1.0)] | None = None
    """Sliding friction of every contact."""
    grasp: str | None = None
    """Of the library, in place of the one that the object's scenario names."""
    posture: str | None = None
    """Of the library: where the fingers are at the beginning."""
    position_noise: Annotated[float, Field(ge=0, le=0.03)] | None = None
    """m."""


def read_settings(kwargs: dict[str, Any]) -> EnvSettings:
    """`of_side` is what an id says of the side. Raises ConfigError with the nearest keyword."""
    given = dict(kwargs)
    side = given.pop("of_side", None)
    if side is not None and given.setdefault("side", side) != side:
        raise ConfigError(f"this id is the {side} hand's, and side is {given['side']!r}: take the id without a side")
    return parse_settings(EnvSettings, given, "environment")


def read_options(options: dict[str, Any] | None, allowed: tuple[str, ...], task: str) -> Options:
    """Raises ConfigError with the nearest option, or for one that the task has no use for."""
    given = dict(options or {})
    for key in given:
        if key not in OPTIONS:
            raise ConfigError(unknown("option", key, OPTIONS))
        if key not in allowed:
            raise ConfigError(f"{task} has no {key} to choose; its options: {', '.join(allowed)}")
    return parse_settings(Options, given, "options")
