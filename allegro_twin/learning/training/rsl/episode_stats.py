"""What the episodes of a training came to."""

from __future__ import annotations

from typing import Any

import torch

from allegro_twin.learning.environments.tensors import TensorVectorEnv


class Tally:
    """Sums over episodes, on the device of the simulations."""

    def __init__(self, env: TensorVectorEnv) -> None:
        zeros = env.xp.zeros(env.num_envs)
        self._return, self._length, self._over = zeros, zeros.clone(), zeros.new_zeros(4)

    def add(self, reward: Any, ended: Any, success: Any) -> None:
        """One action of every simulation: (n,) each."""
        self._return += reward
        self._length += 1
        one = ended.float()
        self._over += torch.stack(
            [one.sum(), (one * self._return).sum(), (one * self._length).sum(), (one * success).sum()]
        )
        self._return *= 1.0 - one
        self._length *= 1.0 - one

    def saved(self) -> list[Any]:
        """What `load` takes."""
        return [each.clone() for each in (self._return, self._length, self._over)]

    def load(self, content: list[Any]) -> None:
        for mine, other in zip((self._return, self._length, self._over), content, strict=True):
            mine.copy_(other)

    def told(self) -> tuple[int, float, float, float]:
        """How many have ended since the last call, their mean return and length, and the share of success; NaN where
        none has."""
        number, *sums = self._over.tolist()
        self._over.zero_()
        total, length, good = (each / number if number else float("nan") for each in sums)
        return int(number), total, length, good
