"""Many hands on a Warp device for a learner on the same one: actions, observations and rewards are its tensors."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.gym.engine import Engine
from allegro_twin.gym.noise import Draws
from allegro_twin.gym.settings import read_settings
from allegro_twin.gym.spaces import action_space, observation_space


class DeviceVectorEnv:
    """`num_envs` simulations of a task; keywords as of `gymnasium.make`, `device` among them: `warp` or `warp:cpu`.

    What is drawn for an episode follows from `seed`, the simulation's number and the episode's. An episode that has
    ended begins anew in the same step. Raises ConfigError.
    """

    def __init__(
        self, task: str, num_envs: int, *, seed: int = 0, max_episode_steps: int | None = None, **kwargs: Any
    ) -> None:
        settings = read_settings({"device": "warp"} | kwargs)
        if settings.device == "cpu":
            raise ConfigError("on device cpu nothing is a tensor: take HandVectorEnv, or device: warp")
        self.engine = Engine(task, settings, num_envs)
        self.num_envs, self.xp = num_envs, self.engine.worlds.xp
        self.limit = self.engine.limit if max_episode_steps is None else max_episode_steps
        self.single_action_space = action_space(self.engine.task)
        self.single_observation_space = observation_space(self.engine.task, self.engine.n_state)
        self._all = self.xp.arange(num_envs)
        self._key = self._all * 1_000_003 + seed
        self._episode = self.xp.zeros(num_envs, np.int64)

    def reset(self) -> Any:
        """New episodes of all; what is seen: (num_envs, k), or a dictionary of such."""
        self._begin(self._all)
        return self.engine.observe()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As Gymnasium's vector environments: `info` has `is_success`, the reward's terms, and what those that ended
        saw last, `final_obs`. Actions (num_envs, joints) in [-1, 1]; one with a NaN is `info["diverged"]`."""
        engine = self.engine
        engine.step(actions)
        observation = engine.observe()
        outcome, diverged = engine.outcome(actions, observation)
        truncated = engine.count >= self.limit
        info = {"is_success": outcome.success, "diverged": diverged, **outcome.terms}
        rows = self.xp.flatnonzero(outcome.failed | truncated)
        if len(rows):
            info["final_obs"] = observation
            self._begin(rows)
            observation = engine.observe()
        return observation, outcome.reward, outcome.failed, truncated, info

    def spread(self, generator: Any = None) -> None:
        """Set the simulations at random places of their time, so that they do not all end together."""
        torch = self.xp.torch
        self.engine.count[:] = torch.randint(
            0, self.limit, (self.num_envs,), device=self.xp.device, generator=generator
        )

    def _begin(self, rows: Any) -> None:
        self._episode[rows] += 1
        self.engine.begin(rows, Draws.counted(self._key[rows], self._episode[rows]))
