"""Batched environment for learners in PyTorch: actions, observations and rewards are tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import tensor_namespace
from allegro_twin.learning.environments.engine import make_engine
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.snapshot import restore_snapshot, take_snapshot
from allegro_twin.learning.environments.spaces import action_space, episode_length, observation_space


class TensorVectorEnv:
    """`num_envs` simulations of a task; keywords as for `gymnasium.make`. On a Warp device all data stay there; on
    processors tensors share memory with NumPy's arrays.

    Random numbers of an episode follow from `seed`, the simulation's number and the episode's number. An episode that
    has ended begins anew in the same step. Raises ConfigError.
    """

    def __init__(
        self, task: str, num_envs: int, *, seed: int = 0, max_episode_steps: int | None = None, **kwargs: Any
    ) -> None:
        self.engine = make_engine(task, kwargs, num_envs)
        self.num_envs, self._own = num_envs, self.engine.worlds.xp
        self.xp = tensor_namespace("cpu") if self._own is np else self._own
        self.limit = episode_length(max_episode_steps, self.engine.limit)
        self.single_action_space = action_space(self.engine.task)
        self.single_observation_space = observation_space(self.engine.task, self.engine.n_state, self.engine.pictures)
        self._all = self._own.arange(num_envs)
        self._key = self._own.asarray(self._all * 1_000_003 + seed, np.uint64)
        self._episode = self._own.zeros(num_envs, np.int64)

    def reset(self) -> Any:
        """Begin new episodes of all simulations. Returns observations (num_envs, k), or a dictionary of such."""
        self._begin(self._all)
        return self._as_tensors(self.engine.observe())

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step, as Gymnasium's vector environments do. `info` has `is_success`, the reward's terms, and the last
        observations of ended episodes, `final_obs`. Actions (num_envs, joints) in [-1, 1]; one with NaN is
        `info["diverged"]`."""
        engine, own = self.engine, self._own
        taken = engine.clip_actions(actions.numpy() if own is np else actions)
        engine.step(taken)
        observation: Any = engine.observe()
        outcome, diverged = engine.outcome(taken, observation)
        truncated = engine.count >= self.limit
        info = {"is_success": outcome.success, "diverged": diverged, **outcome.terms}
        rows = own.flatnonzero(outcome.failed | truncated)
        if len(rows):
            # A reset writes into what the task counts.
            info = {name: own.copy(value) for name, value in info.items()} | {"final_obs": observation}
            self._begin(rows)
            observation = engine.observe()
        return self._as_tensors((observation, outcome.reward, outcome.failed, truncated, info))  # type: ignore[no-any-return]

    def stagger_episodes(self) -> None:
        """Set the simulations to random times of their episodes, so that they do not all end together."""
        torch = self.xp.torch
        self._as_tensors(self.engine.count)[:] = torch.randint(0, self.limit, (self.num_envs,), device=self.xp.device)

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays besides the engine's that decide how the episodes go on, by name, live."""
        return {"key": self._key, "episode": self._episode}

    def state_dict(self) -> dict[str, Any] | None:
        """Everything that decides how the simulations continue, as tensors, numbers and strings. None on a
        Warp device, whose runs are not reproducible."""
        if self._own is not np:
            return None

        def convert(part: Any) -> Any:
            if isinstance(part, tuple | list):
                return type(part)(map(convert, part))
            if not isinstance(part, np.ndarray):
                return part
            return self.xp.torch.from_numpy(part.view(np.int64) if part.dtype == np.uint64 else part)

        return {path: convert(part) for path, part in take_snapshot(self).items()}

    def load(self, content: dict[str, Any] | None) -> bool:
        """Continue from a `state_dict` of the same settings, on processors. Returns False where that is not possible,
        and nothing has changed. Raises ConfigError for one of other settings."""
        if content is None or self._own is not np:
            return False
        restore_snapshot(self, {path: _array(part) for path, part in content.items()})
        return True

    def _begin(self, rows: Any) -> None:
        self._episode[rows] += 1
        self.engine.begin(rows, Draws.from_counters(self._key[rows], self._episode[rows]))

    def _as_tensors(self, tree: Any) -> Any:
        """Arrays as tensors of the same memory; single precision for learning."""
        if self._own is not np:
            return tree
        if isinstance(tree, dict):
            return {name: self._as_tensors(part) for name, part in tree.items()}
        if isinstance(tree, tuple):
            return tuple(self._as_tensors(part) for part in tree)
        return self.xp.torch.from_numpy(tree)


def _array(part: Any) -> Any:
    if isinstance(part, tuple | list):
        return type(part)(map(_array, part))
    return part.cpu().numpy() if hasattr(part, "numpy") else part
