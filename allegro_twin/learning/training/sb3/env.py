"""Adapter of the vector environment for Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.training.logs import NO_TERMS

Indices = int | Iterable[int] | None


class Sb3VecEnv(VecEnv):  # type: ignore[misc]  # Stable-Baselines3 is untyped here.
    """Ended episodes begin anew within the step; their last observation is `info["terminal_observation"]`.

    The first episodes after a reset are cut at random times, so that the simulations are not all at the same place of
    an episode. They are truncated like any other, and left out of the statistics. `scale` multiplies rewards, not the
    reported returns. Expects an environment with `autoreset_mode="disabled"`.
    """

    def __init__(self, env: HandVectorEnv, *, scale: float = 1.0) -> None:
        self.env, self._scale = env, scale
        self._generator = np.random.default_rng(0)
        self._seed: int | None = None
        self._actions = np.zeros(0, np.float32)
        self._terms: dict[str, list[float]] = {}
        self._return = np.zeros(env.num_envs)
        self._age = np.zeros(env.num_envs, np.int64)
        self._cut: NDArray[np.int64] = np.full(env.num_envs, env.limit, np.int64)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed of the next reset."""
        self._seed = seed
        return [None if seed is None else seed + row for row in range(self.num_envs)]

    def reset(self) -> Observation:
        observation, _ = self.env.reset(seed=self._seed)
        self._generator, self._seed = np.random.default_rng(self._seed), None
        self._return[:], self._age[:] = 0.0, 0
        self._cut[:] = self._generator.integers(1, self.env.limit + 1, self.num_envs)
        return observation

    def step_async(self, actions: NDArray[np.float32]) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Observation, NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        observation, reward, terminated, truncated, more = self.env.step(self._actions)
        for name, value in {"diverged": np.zeros(self.num_envs), **more}.items():
            if name not in NO_TERMS and not name.startswith("_"):  # Those are Gymnasium's masks.
                self._terms.setdefault(name, []).append(float(value.mean()))
        self._return += reward
        self._age += 1
        ended = terminated | truncated | (self._age >= self._cut)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        rows = np.flatnonzero(ended)
        for row in rows.tolist():
            infos[row] = self._last(row, observation, bool(terminated[row]), bool(more["is_success"][row]))
        if len(rows):
            observation, _ = self.env.reset(options={"reset_mask": ended})
            self._return[rows], self._age[rows], self._cut[rows] = 0.0, 0, self.env.limit
        return observation, (self._scale * reward).astype(np.float32), ended, infos

    def take_terms(self) -> dict[str, float]:
        """Means over the actions since the last call of the task's terms, by their names in the logs."""
        found = {f"terms/{name}": float(np.mean(means)) for name, means in self._terms.items()}
        self._terms.clear()
        return found

    def _last(self, row: int, observation: Observation, failed: bool, success: bool) -> dict[str, Any]:
        """Info of an episode that has just ended."""
        if isinstance(observation, dict):
            seen: Any = {name: rows[row] for name, rows in observation.items()}
        else:
            seen = observation[row]
        info = {"terminal_observation": seen, "TimeLimit.truncated": not failed}
        if failed or self._age[row] >= self.env.limit:
            age = int(self._age[row])
            info |= {"episode": {"r": float(self._return[row]), "l": age, "t": 0.0}, "is_success": success}
        return info

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> Sequence[NDArray[Any] | None]:
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        return [getattr(self.env, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        raise AttributeError(f"{attr_name}: all simulations are one environment; set it there")

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        raise AttributeError(f"{method_name}: all simulations are one environment; call it there")

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        return [False] * len(self._rows(indices))

    def _rows(self, indices: Indices) -> list[int]:
        if indices is None:
            return list(range(self.num_envs))
        return [indices] if isinstance(indices, int) else list(indices)
