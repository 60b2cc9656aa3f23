"""Gymnasium spaces of a task."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.learning.policy.interface import BOUND, Floats, Observation
from allegro_twin.learning.tasks.base import Task
from allegro_twin.spec import HandSpec
from allegro_twin.viewing.batch import PictureSensor

_ROOM = 0.4  # m. No fingertip of a hand that ships is farther from the palm's origin: the longest finger has 0.15.

_UNIT = 1.001  # Bound of a quaternion's numbers, with room for the rounding to float32.


def action_space(task: Task) -> spaces.Space[Floats]:
    return spaces.Box(-1.0, 1.0, (task.spec.n_joints,), np.float32)


def observation_space(task: Task, state: int = 0, pictures: PictureSensor | None = None) -> spaces.Space[Observation]:
    """`state`: numbers of the privileged state."""
    parts: dict[str, spaces.Space[Any]] = {}
    parts["observation"] = spaces.Box(-BOUND, BOUND, (task.interface.n_observation + task.n_unmeasured,), np.float32)
    goal = task.goal()
    if goal is not None:
        room = _reach(task.spec) if task.interface.n_goal else _UNIT
        place = spaces.Box(-room, room, (goal.shape[-1],), np.float32)
        parts |= {"achieved_goal": place, "desired_goal": place}
    if state:
        parts["state"] = spaces.Box(-BOUND, BOUND, (state,), np.float32)
    for name, (shape, kind, largest) in {} if pictures is None else pictures.shapes().items():
        parts[name] = spaces.Box(0, largest, shape, kind)
    return parts["observation"] if len(parts) == 1 else spaces.Dict(parts)  # type: ignore[return-value]  # Of a Dict.


def _reach(spec: HandSpec) -> float:
    """m. No fingertip is farther from the root's origin."""
    if spec.foreign is None:
        return _ROOM
    postures = np.random.default_rng(0).uniform(spec.lower, spec.upper, (2000, spec.n_joints))
    tips = hand_kinematics(spec).batch_fingertips()(np.vstack([spec.rest, postures]))
    return max(_ROOM, round(1.2 * float(np.abs(tips).max()), 2))


def describe_space(space: spaces.Space[Any]) -> str:
    """Number of values and their bounds; for a dictionary, of each part."""
    if isinstance(space, spaces.Dict):
        return ", ".join(f"{name} {part.shape[0]}" for name, part in space.items() if part.shape)
    assert isinstance(space, spaces.Box)
    return f"{space.shape[0]} in [{space.low.min():g}, {space.high.max():g}]"


class EpisodeSpec(EnvSpec):
    """Gymnasium's specification, whose `max_episode_steps` is at most the task's own, `limit`, and always said.

    `gymnasium.make` tells an environment no limit that was asked for: it writes it here, later. A longer one warns.
    """

    limit: int

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "max_episode_steps" and isinstance(value, int) and value > self.limit:
            warnings.warn(f"max_episode_steps is {value}, and an episode of {self.id} ends after {self.limit} actions: "
                          "give fewer, or leave it out", stacklevel=3)  # fmt: skip
            value = self.limit
        super().__setattr__(name, value)


def with_episode_length(spec: EnvSpec | None, limit: int) -> EnvSpec | None:
    """A specification that says how many actions an episode has; Gymnasium only knows a limit that was asked for."""
    if spec is None:
        return None
    found: EpisodeSpec = object.__new__(EpisodeSpec)
    found.__dict__.update(vars(spec) | {"limit": limit, "max_episode_steps": limit})
    if spec.max_episode_steps is not None:
        found.max_episode_steps = spec.max_episode_steps
    return found


def episode_length(requested: int | None, usual: int) -> int:
    """Actions of an episode: as the task says, or fewer. Raises ConfigError."""
    if requested is None or requested == -1:  # Gymnasium's word for no limit of one's own.
        return usual
    if not isinstance(requested, int | np.integer) or isinstance(requested, bool) or requested < 1:
        raise ConfigError(f"max_episode_steps is a whole number from 1 on, not {requested!r}; an episode has {usual}")
    if requested > usual:
        raise ConfigError(f"max_episode_steps is {requested}, and an episode of this task ends after {usual} actions: "
                          "give fewer, or leave it out")  # fmt: skip
    return int(requested)
