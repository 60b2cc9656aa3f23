"""Settings of an environment, and options of a reset."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, field_validator, model_validator

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.schema import Positive, Settings, parse_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.settings import scenario_files, scenario_side, with_card_side
from allegro_twin.learning.environments.objects import ObjectChoice
from allegro_twin.learning.environments.randomise import LARGEST_FRICTION, Randomise, parse_randomise
from allegro_twin.learning.policy.interface import Mode
from allegro_twin.sim.batch.warp import SimDevice
from allegro_twin.spec import SIDES, HandSpec, Side
from allegro_twin.viewing.views import LARGEST

OPTIONS = ("object", "size", "friction", "grasp", "posture", "position_noise")

Level: TypeAlias = Literal["default", "easy"]
TASK_SETTINGS = (
    "observation", "goals", "farthest", "level", "palm", "starts", "grip", "position_noise", "reach",
)  # fmt: skip
"""Settings that only some tasks have."""
VARIATIONS = (
    "objects", "position_noise", "level", "farthest", "starts", "grip", "randomise", "timestep", "noslip", "coarse",
    "device", "contacts", "constraints", "state", "reward",
)  # fmt: skip
"""Settings that change neither what a policy sees, nor what its actions do, nor what is asked of it: how much differs
from episode to episode, how it is simulated, and what the terms of its reward weigh."""

NEAREST = 0.3
"""rad: least distance of a new goal of Reorient, so that it is never reached already."""
GoalDistance: TypeAlias = Annotated[float, Field(ge=NEAREST, le=math.pi)]
"""rad, between two orientations, which are at most π apart."""


class EnvSettings(Settings):
    """Keyword arguments of `gymnasium.make`."""

    hand: str = HAND
    """A model of hand, or the path of your own card (docs/how-to/add_a_hand.md)."""
    side: Side = "right"
    """Default: that of the hand's card, else of the scenarios among `objects`; where none says one, right."""
    control: Mode = "delta"
    """Meaning of an action: `delta` or `absolute` joint positions, or `torque` of a hand that takes torques."""
    objects: Annotated[tuple[ObjectChoice, ...], Field(min_length=1)] | None = None
    """Objects from the catalogue, from scenarios, or your own (docs/how-to/add_a_task.md); each episode draws one.
    None: the task's."""
    position_noise: Annotated[float, Field(ge=0, le=0.03)] | None = None
    """Largest offset of an object along each axis, m. None: the task's own."""
    randomise: Randomise = Randomise()
    """Domain randomisation; `default` for everything."""
    period: Positive = 0.003
    """Control period, s."""
    timestep: Positive = 0.001
    """Time step of the physics, s."""
    noslip: Annotated[int, Field(ge=0)] = 0
    """Solver iterations against the creep of held objects. They double the cost of a step in contact. Without them a
    held object creeps by 0.1 mm/s (docs/reference/allegro_model.md#contact), 1 % of what an episode tolerates."""
    coarse: bool = False
    """Contacts without torsional and rolling friction, solved less exactly: for training, at half the cost."""
    decimation: Annotated[int, Field(ge=1)] = 13
    """Control periods between two actions."""
    gains: str = "default"
    """Name in conf/gains."""
    step: Positive | None = None
    """rad of a joint per action, in the mode `delta`. None: the task's own."""
    device: SimDevice = "cpu"
    """Simulator: `cpu`, MuJoCo; `warp`, MuJoCo Warp on an NVIDIA GPU; `warp:cpu`, its kernels on one processor."""
    contacts: Annotated[int, Field(ge=1)] = 64
    """Most contacts on a Warp device, for each simulation; twice what the busiest task has
    (docs/explanation/reinforcement_learning.md#on-a-gpu)."""
    constraints: Annotated[int, Field(ge=1)] = 256
    """Most constraints, likewise."""
    reach: Positive = 0.3
    """Largest distance of an action from the scripted motion, rad of a joint, where a task has a script."""

    history: Annotated[int, Field(ge=1, le=20)] = 1
    """Decisions of the hand in an observation: this one and those before."""
    touch: bool = False
    """Observations end with the external torque of every joint, as a mirror beside a hand estimates it."""
    state: bool = False
    """Observations are a dictionary with a further part `state`: what only the simulation knows, for a critic."""
    observation: Literal["full", "hand"] = "full"
    """For tasks with an object in the hand: `hand` leaves out what no hand measures."""
    observe: tuple[Literal["rgb", "depth"], ...] = ()
    """Pictures in observations, which are a dictionary then: `rgb`, bytes (height, width, 3), and `depth`, m (height,
    width); of several cameras `rgb_side`, `rgb_top` and so on. On processors."""
    cameras: Annotated[tuple[str, ...], Field(min_length=1)] = ("side",)
    """Cameras of these pictures: `side`, `front`, `top`, `palm`, `auto`, or `AZIMUTH,ELEVATION,DISTANCE`; each looks at
    the middle of the grasp."""
    resolution: Annotated[str, Field(pattern=r"^[1-9]\d{0,3}x[1-9]\d{0,3}$")] = "84x84"
    """Width and height of these pictures, pixels, up to 8192 each."""
    goals: Literal["any", "yaw"] = "any"
    """For Reorient: turns about any axis, or about the vertical alone."""
    farthest: GoalDistance | None = None
    """For Reorient: largest distance of a goal, rad, from 0.3 to π. None: π, and π / 2 about the vertical."""
    palm: Literal["forbidden", "allowed"] = "forbidden"
    """For tasks with an object in the hand: whether palm and proximal links may touch it, or end the episode."""
    starts: Literal["train", "test"] = "train"
    """For tasks in the fingertips: states to begin in, those for trainings or those for tests, which are other states
    of other sizes."""
    grip: Literal["pinch", "cradle"] = "pinch"
    """For tasks in the fingertips: whether they press on the object's sides at the beginning, or it lies on them."""
    level: Level = "default"
    """For tasks with a scripted grasp: `easy` varies little of the object."""
    reward: dict[str, Annotated[float, Field(ge=0)]] = {}  # noqa: RUF012  # Pydantic copies it.
    """Factors of terms in the reward, by the names that `info` reports, instead of the task's own. For tasks without
    goals."""

    @field_validator(
        "position_noise", "period", "timestep", "noslip", "decimation", "step", "contacts", "constraints", "reach",
        "history", "farthest", mode="before",
    )  # fmt: skip
    @classmethod
    def _check_number(cls, value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError("input should be a number")
        return value

    @model_validator(mode="before")
    @classmethod
    def _of_hand(cls, values: Any) -> Any:
        """A card's side, or that of scenarios; and `default` randomises what applies to the chosen hand."""
        values = with_card_side(values, "hand")
        if isinstance(values, dict) and "side" not in values:
            side = scenario_side(scenario_files(values.get("objects")))
            values = values if side is None else values | {"side": side}
        if not isinstance(values, dict) or "randomise" not in values:
            return values
        return values | {"randomise": parse_randomise(values["randomise"], _chosen_hand(values))}

    @model_validator(mode="after")
    def _check_pictures(self) -> EnvSettings:
        for name in ("cameras", "resolution"):
            if not self.observe and getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"{name} is of pictures in observations: give observe, too, or leave {name} out")
        if max(map(int, self.resolution.split("x"))) > LARGEST:
            raise ValueError(f"resolution: width and height are up to {LARGEST} pixels each, not {self.resolution}")
        if self.observe and self.device != "cpu":
            raise ValueError(
                f"observe: pictures are rendered of simulations on processors: device cpu, not {self.device}"
            )
        for name in ("observe", "cameras"):
            if len({*getattr(self, name)}) < len(getattr(self, name)):
                raise ValueError(f"{name} has one of {', '.join(getattr(self, name))} twice")
        return self


def _chosen_hand(values: dict[str, Any]) -> HandSpec | None:
    """The chosen hand, where it is not the usual one; None, too, for an unknown name."""
    hand, side = values.get("hand", HAND), values.get("side", "right")
    return None if hand == HAND or not isinstance(hand, str) or side not in SIDES else load_spec(hand, side)


class ResetOptions(Settings):
    """The `options` of a reset: values that this episode does not draw."""

    object: str | None = None
    """Name in the catalogue."""
    size: Positive | None = None
    """Factor on the object's size. In `Rotate` and `Reorient` an episode takes a start state near it, whose size, some
    0.005 off, is the object's: a reset reports it."""
    friction: Annotated[float, Field(gt=0, le=LARGEST_FRICTION)] | None = None
    """Sliding friction of every contact."""
    grasp: str | None = None
    """Grasp of the library, instead of the one in the object's scenario."""
    posture: str | None = None
    """Posture of the library: where the fingers are at the beginning."""
    position_noise: Annotated[float, Field(ge=0, le=0.03)] | None = None
    """m."""


_ELSEWHERE = {
    "seed": "it goes to reset(seed=…)",
    "threads": "it is of many simulations, gymnasium.make_vec or HandVectorEnv",
    "num_envs": "it is of many simulations, gymnasium.make_vec or HandVectorEnv",
    "autoreset_mode": "it is of many simulations, gymnasium.make_vec or HandVectorEnv",
    "max_episode_steps": "it is of gymnasium.make, gymnasium.make_vec and HandVectorEnv",
}


def read_settings(kwargs: dict[str, Any]) -> EnvSettings:
    """Read keyword arguments; `of_side` is the side in an id. Raises ConfigError with the nearest keyword."""
    values = dict(kwargs)
    for name, where in _ELSEWHERE.items():
        if name in values:
            raise ConfigError(f"{name} {values[name]!r} is no keyword of an environment: {where}")
    side = values.pop("of_side", None)
    if side is not None and values.setdefault("side", side) != side:
        raise ConfigError(f"this id is the {side} hand's, and side is {values['side']!r}: take the id without a side")
    return parse_settings(EnvSettings, values, "environment")


def read_options(options: dict[str, Any] | None, allowed: tuple[str, ...], task: str) -> ResetOptions:
    """Read options of a reset. Raises ConfigError with the nearest option, or for an option that the task does not
    have."""
    if not isinstance(options, Mapping | None):
        raise ConfigError(f"options are a mapping such as {{'{allowed[0]}': …}}, not {options!r}")
    values = dict(options or {})
    for key in values:
        if key not in OPTIONS:
            raise ConfigError(unknown("option", str(key), OPTIONS))
        if key not in allowed:
            raise ConfigError(f"{task} has no {key} to choose; its options: {', '.join(allowed)}")
    return parse_settings(ResetOptions, values, "options")


def env_keywords(settings: EnvSettings) -> dict[str, Any]:
    """Settings as the keyword arguments that they came from."""
    return {name: getattr(settings, name) for name in settings.model_fields_set}
