"""Single environment: one hand at one task."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.learning.environments.engine import make_engine
from allegro_twin.learning.environments.snapshot import EpisodeState, restore_episode, save_episode
from allegro_twin.learning.environments.spaces import action_space, observation_space, with_episode_length
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.learning.tasks.base import GoalTask
from allegro_twin.viewing.batch import BatchCamera, has_screen
from allegro_twin.viewing.views import check_edges

_ONE = np.zeros(1, np.int64)


class HandEnv(gymnasium.Env[Observation, Floats], EzPickle):
    """Gymnasium environment of a task, by its name; further keywords are those of `EnvSettings`, or `policy`: a policy,
    by path or name, in whose environment it is. Raises ConfigError.

    A pickle contains the arguments, not the state of the episode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # As Gymnasium declares it.
        "render_modes": ["rgb_array", "depth_array", *(["human"] if has_screen() else [])],
        "render_fps": 26,  # 1 / 39 ms, rounded.
    }

    def __init__(
        self, task: str, *, render_mode: str | None = None, width: int = 480, height: int = 480, **kwargs: Any
    ) -> None:
        EzPickle.__init__(self, task, render_mode=render_mode, width=width, height=height, **kwargs)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ConfigError(f"render_mode {render_mode!r} is none of {', '.join(self.metadata['render_modes'])}")
        check_edges(width, height)
        self.engine = make_engine(task, kwargs, 1, threads=1)
        self.action_space = action_space(self.engine.task)
        self.observation_space = observation_space(self.engine.task, self.engine.n_state, self.engine.pictures)
        self.metadata = self.metadata | {"render_fps": round(1.0 / self.engine.task.interface.seconds)}
        self.render_mode, self._size = render_mode, (width, height)
        self._pictures: BatchCamera | None = None
        self._spec: EnvSpec | None = None
        if isinstance(self.engine.task, GoalTask):
            # Stable-Baselines3 treats an environment with these as a goal environment.
            self.compute_reward: Callable[[ArrayLike, ArrayLike, object], Any] = self._goal_reward
            self.compute_terminated = self.compute_truncated = _never

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's, with the length of an episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = with_episode_length(spec, self.engine.limit)

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays besides the engine's that decide how the episode goes on: none."""
        return {}

    def save_state(self) -> EpisodeState:
        """All that decides how the episode goes on, random numbers included: plain arrays and numbers, which pickle.
        Raises ConfigError on a device."""
        return save_episode(self, [self.np_random])._replace(seed=self.np_random_seed)

    def restore_state(self, state: EpisodeState) -> Observation:
        """Go on from a `save_state` of an environment with the same keywords, to the bit. Returns the observation that
        it had. Raises ConfigError for another, and then nothing has changed."""
        (saved,) = restore_episode(self, state, lambda: self.reset(seed=0))
        self.np_random.bit_generator.state, self._np_random_seed = saved, state.seed
        return self._observation()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        report = self.engine.reset(_ONE, [self.np_random], options)
        if self.render_mode == "human":
            self.render()
        return self._observation(), _single_report(report)

    def step(self, action: Floats) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        engine, given = self.engine, np.asarray(action)
        if given.shape != self.action_space.shape:
            raise CommandError(f"an action must have shape {self.action_space.shape}, not {given.shape}")
        actions = engine.clip_actions(given[None])
        engine.step(actions)
        seen = engine.observe()
        observation, (outcome, diverged), count = engine.fetch((seen, engine.outcome(actions, seen), engine.count))
        info = {"is_success": bool(outcome.success[0])} | {name: float(row[0]) for name, row in outcome.terms.items()}
        if diverged[0]:
            info["diverged"] = True
        if self.render_mode == "human":
            self.render()
        over = bool(count[0] >= engine.limit)
        return _first(observation), float(outcome.reward[0]), bool(outcome.failed[0]), over, info

    def render(self) -> NDArray[Any] | None:
        if self.render_mode is None:
            return None
        if self._pictures is None:
            self._pictures = BatchCamera(self.engine.worlds, *self._size, mode=self.render_mode)
        return self._pictures.take(0, self.engine.task.marks(0))

    def close(self) -> None:
        if self.engine.pictures is not None:
            self.engine.pictures.close()
        if self._pictures is not None:
            self._pictures.close()
            self._pictures = None

    def _goal_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: object) -> Any:
        """Reward for goals (..., k): a number for one, an array for many. `info` as the steps gave it, one or one per
        row.

        It follows from the goals as given. Those of an observation come from encoders or a camera; with noise or delay
        the reward of the step is another, since it follows from the true state.
        """
        task = self.engine.task
        assert isinstance(task, GoalTask)
        return task.reward(achieved_goal, desired_goal, _term(info, "dropped", 0.0), _term(info, "held", 1.0))

    def _observation(self) -> Observation:
        return _first(self.engine.fetch(self.engine.observe()))


def _first(observation: Observation) -> Observation:
    """The only row of an observation."""
    if isinstance(observation, dict):
        return {name: rows[0] for name, rows in observation.items()}
    return observation[0]  # type: ignore[no-any-return]  # A row of an array.


def _single_report(report: dict[str, Any]) -> dict[str, Any]:
    """The only row of what a reset reports."""
    return {name: _single_report(rows) if isinstance(rows, dict) else _plain(rows[0]) for name, rows in report.items()}


def _plain(value: Any) -> Any:
    return (
        value.item() if isinstance(value, np.generic) else np.array(value) if isinstance(value, np.ndarray) else value
    )


def _term(info: object, name: str, otherwise: float) -> Any:
    """A term of one step's info, or of many."""
    if isinstance(info, dict):
        return info.get(name, otherwise)
    return np.array([each.get(name, otherwise) for each in info]) if isinstance(info, Iterable) else otherwise


def _never(achieved_goal: ArrayLike, desired_goal: ArrayLike, info: object) -> Any:
    """A goal neither truncates nor terminates an episode, since the hand should stay there: only time and a loss do."""
    shape = np.shape(achieved_goal)[:-1]
    return np.zeros(shape, bool) if shape else False
