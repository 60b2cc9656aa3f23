"""Many hands for a learner in PyTorch: actions, observations and rewards are tensors, where the simulations are."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.array_api import tensor_namespace
from allegro_twin.learning.environments.engine import Engine
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import read_settings
from allegro_twin.learning.environments.snapshot import put_back, taken
from allegro_twin.learning.environments.spaces import action_space, observation_space


class TensorVectorEnv:
    """`num_envs` simulations of a task; keywords as of `gymnasium.make`. On a Warp device nothing leaves it; on
    processors tensors share the memory of NumPy's arrays.

    What is drawn for an episode follows from `seed`, the simulation's number and the episode's. An episode that has
    ended begins anew in the same step. Raises ConfigError.
    """

    def __init__(
        self, task: str, num_envs: int, *, seed: int = 0, max_episode_steps: int | None = None, **kwargs: Any
    ) -> None:
        self.engine = Engine(task, read_settings(kwargs), num_envs)
        self.num_envs, self._own = num_envs, self.engine.worlds.xp
        self.xp = tensor_namespace("cpu") if self._own is np else self._own
        self.limit = self.engine.limit if max_episode_steps is None else max_episode_steps
        self.single_action_space = action_space(self.engine.task)
        self.single_observation_space = observation_space(self.engine.task, self.engine.n_state)
        self._all = self._own.arange(num_envs)
        self._key = self._own.asarray(self._all * 1_000_003 + seed, np.uint64)
        self._episode = self._own.zeros(num_envs, np.int64)

    def reset(self) -> Any:
        """New episodes of all; what is seen: (num_envs, k), or a dictionary of such."""
        self._begin(self._all)
        return self._shared(self.engine.observe())

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As Gymnasium's vector environments: `info` has `is_success`, the reward's terms, and what those that ended
        saw last, `final_obs`. Actions (num_envs, joints) in [-1, 1]; one with a NaN is `info["diverged"]`."""
        engine, own = self.engine, self._own
        taken = engine.placed(actions.numpy() if own is np else actions)
        engine.step(taken)
        observation: Any = engine.observe()
        outcome, diverged = engine.outcome(taken, observation)
        truncated = engine.count >= self.limit
        info = {"is_success": outcome.success, "diverged": diverged, **outcome.terms}
        rows = own.flatnonzero(outcome.failed | truncated)
        if len(rows):
            info["final_obs"] = observation
            self._begin(rows)
            observation = engine.observe()
        return self._shared((observation, outcome.reward, outcome.failed, truncated, info))  # type: ignore[no-any-return]

    def spread(self) -> None:
        """Set the simulations at random places of their time, so that they do not all end together."""
        torch = self.xp.torch
        self._shared(self.engine.count)[:] = torch.randint(0, self.limit, (self.num_envs,), device=self.xp.device)

    def saved(self) -> dict[str, Any] | None:
        """Everything that decides how the simulations go on, what `load` takes, as tensors and numbers. None on a Warp
        device, whose runs are not equal anyway."""
        if self._own is not np:
            return None
        torch = self.xp.torch
        return {
            path: torch.from_numpy(part.view(np.int64) if part.dtype == np.uint64 else part)
            if isinstance(part, np.ndarray)
            else part
            for path, part in taken(self).items()
        }

    def load(self, content: dict[str, Any] | None) -> bool:
        """Go on where another of the same settings was saved, on processors; False where that cannot be, and nothing
        has changed. Raises ConfigError for one of other settings."""
        if content is None or self._own is not np:
            return False
        put_back(self, {path: _array(part) for path, part in content.items()})
        return True

    def _begin(self, rows: Any) -> None:
        self._episode[rows] += 1
        self.engine.begin(rows, Draws.counted(self._key[rows], self._episode[rows]))

    def _shared(self, tree: Any) -> Any:
        """Arrays as tensors of the same memory; single precision for what is learned from."""
        if self._own is not np:
            return tree
        if isinstance(tree, dict):
            return {name: self._shared(part) for name, part in tree.items()}
        if isinstance(tree, tuple):
            return tuple(self._shared(part) for part in tree)
        return self.xp.torch.from_numpy(tree)


def _array(part: Any) -> Any:
    return part.cpu().numpy() if hasattr(part, "numpy") else part
