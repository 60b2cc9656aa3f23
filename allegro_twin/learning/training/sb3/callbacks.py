"""What happens beside the learning: the normalisation keeps up, the curve is written, and somebody is told."""

from __future__ import annotations

from time import monotonic
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from allegro_twin.learning.training.curve import Curve
from allegro_twin.learning.training.learned import Advance


class Watching(BaseCallback):  # type: ignore[misc]  # Stable-Baselines3 is untyped here.
    """For one round of learning that begins `seconds` after the training did."""

    def __init__(self, curve: Curve, seconds: float, advance: Advance) -> None:
        super().__init__()
        self._curve, self._advance = curve, advance
        self._began = monotonic() - seconds
        self._episodes: list[tuple[float, int, bool]] = []
        self._seen: Any = None

    @property
    def seconds(self) -> float:
        """Of training so far."""
        return monotonic() - self._began

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self._episodes += [(i["episode"]["r"], i["episode"]["l"], i["is_success"]) for i in infos if "episode" in i]
        return True

    def _on_rollout_start(self) -> None:
        """An observation means the same while it is acted on and while it is learned from, hence only now."""
        self._learn()

    def _on_rollout_end(self) -> None:
        self._seen = self.model.rollout_buffer.observations
        if not float(self.model.policy.pi_features_extractor.count):
            self._learn()  # Nothing is known yet; the first update is better with it.
        found = np.array(self._episodes, float).mean(axis=0) if self._episodes else np.full(3, np.nan)
        values = dict(zip(("return", "length", "success"), found.tolist(), strict=True)) if self._episodes else {}
        steps = int(self.num_timesteps)
        self._curve.add(steps=steps, seconds=self.seconds, episodes=len(self._episodes), **values)
        self._advance(steps, float(found[0]), float(found[2]))
        self._episodes.clear()

    def _on_training_end(self) -> None:
        self._learn()

    def _learn(self) -> None:
        if self._seen is not None:
            policy = self.model.policy
            for front in {policy.pi_features_extractor, policy.vf_features_extractor}:
                front.learn(self._seen)
            self._seen = None
