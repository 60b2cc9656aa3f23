"""Vector environment: many hands at one task, on all processors and without a loop over them."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils import EzPickle, seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.engine import make_engine
from allegro_twin.learning.environments.snapshot import EpisodeState, restore_episode, save_episode
from allegro_twin.learning.environments.spaces import (
    action_space,
    episode_length,
    observation_space,
    with_episode_length,
)
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.viewing.batch import BatchCamera
from allegro_twin.viewing.views import check_edges

Rows = NDArray[np.int64]


class HandVectorEnv(VectorEnv[Observation, Floats, NDArray[Any]], EzPickle):
    """`num_envs` simulations. Number i behaves as the single environment with the seed `seed + i` does, to the bit.

    `autoreset_mode`: `next_step` as in Gymnasium's own vector environments, `same_step`, or `disabled`, where `reset`
    takes the option `reset_mask`; or Gymnasium's `AutoresetMode`. `threads`: 0 for one per processor. Other keywords as
    in `HandEnv`. Raises ConfigError.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # As Gymnasium declares it.
        "render_modes": ["rgb_array", "depth_array"],
        "render_fps": 26,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        threads: int = 0,
        autoreset_mode: AutoresetMode | str = "next_step",
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        width: int = 480,
        height: int = 480,
        **kwargs: Any,
    ) -> None:
        EzPickle.__init__(self, task, num_envs, threads=threads, autoreset_mode=autoreset_mode, render_mode=render_mode,
                          max_episode_steps=max_episode_steps, width=width, height=height, **kwargs)  # fmt: skip
        modes = {mode.name.lower(): mode for mode in AutoresetMode}
        named = {mode.value: mode for mode in AutoresetMode} | modes
        mode = autoreset_mode if isinstance(autoreset_mode, AutoresetMode) else named.get(autoreset_mode)
        if mode is None:
            raise ConfigError(f"autoreset_mode {autoreset_mode!r} is none of {', '.join(modes)}")
        if not isinstance(num_envs, int | np.integer) or isinstance(num_envs, bool) or num_envs < 1:
            raise ConfigError(f"num_envs must be a whole number from 1 on, not {num_envs!r}")
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ConfigError(f"render_mode {render_mode!r} is none of {', '.join(self.metadata['render_modes'])}")
        check_edges(width, height)
        self.engine = make_engine(task, kwargs, num_envs, threads)
        self.num_envs, self.render_mode, self._size = num_envs, render_mode, (width, height)
        self.limit = episode_length(max_episode_steps, self.engine.limit)
        self.single_action_space = action_space(self.engine.task)
        self.single_observation_space = observation_space(self.engine.task, self.engine.n_state, self.engine.pictures)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._mode = mode
        fps = round(1.0 / self.engine.task.interface.seconds)
        self.metadata = self.metadata | {"autoreset_mode": self._mode, "render_fps": fps}
        self._generators: list[np.random.Generator] = []
        self._ended = np.zeros(num_envs, bool)
        self._pictures: BatchCamera | None = None
        self._spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's, with the length of an episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = with_episode_length(spec, self.limit)

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays besides the engine's that decide how the episodes go on, by name, live."""
        return {"ended": self._ended}

    def save_state(self) -> EpisodeState:
        """All that decides how the episodes go on, random numbers included: plain arrays and numbers, which pickle.
        Raises ConfigError on a device."""
        return save_episode(self, self._generators, **self._keywords)

    def restore_state(self, state: EpisodeState) -> Observation:
        """Go on from a `save_state` of environments with the same keywords, to the bit. Returns the observations that
        they had. Raises ConfigError for others, and then nothing has changed."""
        saved = restore_episode(self, state, lambda: self.reset(seed=0), **self._keywords)
        for generator, its in zip(self._generators, saved, strict=True):
            generator.bit_generator.state = its
        found: Observation = self.engine.fetch(self.engine.observe())
        return found

    @property
    def _keywords(self) -> dict[str, Any]:
        """Keywords of the environments that decide episodes."""
        return {"autoreset_mode": self._mode.name.lower(), "max_episode_steps": self.limit}

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        rows, options = self._reset_rows(options)
        self._seed(seed, rows)
        info = self._restart(rows, options)
        return self.engine.fetch(self.engine.observe()), info

    def step(self, actions: Floats) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        taken = self.engine.clip_actions(np.asarray(actions))
        new = np.flatnonzero(self._ended) if self._mode is AutoresetMode.NEXT_STEP else np.zeros(0, np.int64)
        going = np.flatnonzero(~self._ended) if len(new) else None
        self.engine.step(taken, going)
        info = self._restart(new, None) if len(new) else {}
        engine, seen = self.engine, self.engine.observe()
        observation, (outcome, diverged), count = engine.fetch((seen, engine.outcome(taken, seen), engine.count))
        terminated, truncated = outcome.failed, count >= self.limit
        reward, success = outcome.reward, outcome.success
        if len(new):
            for array in (terminated, truncated, success):
                array[new] = False
            reward[new] = 0.0
        stepped = np.ones(self.num_envs, bool)
        stepped[new] = False
        info |= _masked({"is_success": success} | outcome.terms, stepped)
        if diverged.any():
            info |= _masked({"diverged": diverged}, diverged)
        self._ended = terminated | truncated
        if self._mode is AutoresetMode.SAME_STEP and self._ended.any():
            observation, info = self._same_step_reset(observation, info)
        return observation, reward, terminated, truncated, info

    def render(self) -> tuple[NDArray[Any], ...] | None:
        """Pictures of all simulations."""
        if self.render_mode is None:
            return None
        if self._pictures is None:
            self._pictures = BatchCamera(self.engine.worlds, *self._size, mode=self.render_mode)
        frames = [self._pictures.take(row, self.engine.task.marks(row)) for row in range(self.num_envs)]
        return tuple(frame for frame in frames if frame is not None)

    def close_extras(self, **kwargs: Any) -> None:
        if self.engine.pictures is not None:
            self.engine.pictures.close()
        if self._pictures is not None:
            self._pictures.close()

    def _reset_rows(self, options: dict[str, Any] | None) -> tuple[Rows, dict[str, Any]]:
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if mask is None:
            return np.arange(self.num_envs), options
        if np.shape(mask) != (self.num_envs,) or not np.any(mask) or np.asarray(mask).dtype != bool:
            raise ConfigError(f"reset_mask must be {self.num_envs} truth values with at least one true")
        return np.flatnonzero(mask), options

    def _seed(self, seed: int | list[int | None] | None, rows: Rows) -> None:
        """Seed as Gymnasium's vector environments do: simulation i gets `seed + i`, or its own from a list."""
        if seed is None or isinstance(seed, int | np.integer):
            seeds = [None if seed is None else int(seed) + row for row in range(self.num_envs)]
        elif not isinstance(seed, list | tuple):
            raise ConfigError(f"seed is a whole number or a list of such, not {seed!r}")
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ConfigError(f"{len(seeds)} seeds for {self.num_envs} environments")
        if not self._generators:
            self._generators = [seeding.np_random(each)[0] for each in seeds]
            return
        for row in rows:
            if seeds[row] is not None:
                self._generators[row] = seeding.np_random(seeds[row])[0]

    def _restart(self, rows: Rows, options: dict[str, Any] | None) -> dict[str, Any]:
        """Begin new episodes. Returns what was drawn, with a mask of the simulations, as Gymnasium does."""
        self._ended[rows] = False
        return self._spread(self.engine.reset(rows, self._generators, options), rows)

    def _same_step_reset(self, observation: Observation, info: dict[str, Any]) -> tuple[Observation, dict[str, Any]]:
        """Reset simulations that ended in this step, and return what they saw and reported last."""
        rows, ended = np.flatnonzero(self._ended), self._ended.copy()
        own = {name: value for name, value in info.items() if not name.startswith("_")}
        info = {}
        for name, value in own.items():
            info |= _masked({name: value}, value if name == "diverged" else ~ended, ~ended)
        last: dict[str, Any] = {}
        for name, value in own.items():
            last |= _masked({name: value}, value if name == "diverged" else ended, ended)
        info |= {"final_obs": observation, "_final_obs": ended, "final_info": last, "_final_info": ended.copy()}
        info |= self._restart(rows, None)
        return self.engine.fetch(self.engine.observe()), info

    def _spread(self, report: dict[str, Any], rows: Rows) -> dict[str, Any]:
        spread: dict[str, Any] = {}
        mask = np.zeros(self.num_envs, bool)
        mask[rows] = True
        for name, values in report.items():
            if isinstance(values, dict):
                spread |= {name: self._spread(values, rows), f"_{name}": mask.copy()}
                continue
            none = None if values.dtype == object else 0  # As Gymnasium fills what an environment did not report.
            whole = np.full((self.num_envs, *values.shape[1:]), none, values.dtype)
            whole[rows] = values
            spread |= {name: whole, f"_{name}": mask.copy()}
        return spread


def _masked(values: dict[str, NDArray[Any]], *masks: NDArray[np.bool_]) -> dict[str, Any]:
    """Copies of values, zero where a mask is False, and that mask under `_name`, as Gymnasium has them."""
    mask = np.logical_and.reduce(masks)
    return {
        key: part for name, value in values.items()
        for key, part in ((name, np.where(mask, value, np.zeros(1, value.dtype))), (f"_{name}", mask.copy()))
    }  # fmt: skip
