"""Networks for Stable-Baselines3: observations are normalised inside the policy, and a critic may see more."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, MlpExtractor

from allegro_twin.learning.training.goal_features import goal_difference, goal_difference_width
from allegro_twin.learning.training.onnx_policy import PolicyNetwork
from allegro_twin.learning.training.progress import ACHIEVED, GOAL, STATE

BOUND = 5.0
"""Standard deviations at which a normalised observation is clipped."""
LEAST = 1e-6
"""Added to every variance: a constant stays zero instead of becoming noise."""


class NormalisedFeatures(BaseFeaturesExtractor):  # type: ignore[misc]  # Stable-Baselines3 is untyped here.
    """All parts of an observation, concatenated and normalised by the observations so far.

    With a goal the goal difference follows as a further part. Mean and variance are part of the policy's own state, so
    every checkpoint and every export contains them.
    """

    def __init__(
        self, observation_space: spaces.Space[Any], turns: bool = False, without: tuple[str, ...] = ()
    ) -> None:
        """`turns`: goals are orientations. `without`: parts to leave out."""
        parts = dict(observation_space.items()) if isinstance(observation_space, spaces.Dict) else {}
        self.names = [name for name in parts if name not in without]
        seen = [parts[name] for name in self.names] or [observation_space]
        missing = goal_difference_width(spaces.flatdim(parts[GOAL]), turns) if GOAL in parts else 0
        super().__init__(observation_space, sum(spaces.flatdim(part) for part in seen) + missing)
        self.turns = turns
        for name, value in (("mean", 0.0), ("variance", 1.0), ("count", 0.0)):
            size = (self.features_dim,) if name != "count" else ()
            self.register_buffer(name, torch.full(size, value, dtype=torch.float64))

    def forward(self, observations: Any) -> torch.Tensor:
        flat = torch.cat(self._parts(observations), dim=-1)
        scaled = (flat - self.mean.float()) * self.scale
        return torch.clamp(scaled, -BOUND, BOUND)

    @property
    def scale(self) -> torch.Tensor:
        """Factor on an observation's distance from the mean, (features,)."""
        return torch.rsqrt(self.variance + LEAST).float()

    def learn(self, observations: Any) -> None:
        """Update mean and variance with observations, (…, features) or a dictionary of such (Chan et al. 1979)."""
        flat: NDArray[np.float64] = np.concatenate(self._parts(observations), axis=-1)
        flat = flat.reshape(-1, self.features_dim).astype(np.float64)
        count, more = float(self.count), len(flat)
        mean, variance = self.mean.numpy(), self.variance.numpy()
        apart, total = flat.mean(axis=0) - mean, count + more
        spread = variance * count + flat.var(axis=0) * more + apart**2 * count * more / total
        self.mean[:] = torch.from_numpy(mean + apart * more / total)
        self.variance[:] = torch.from_numpy(spread / total)
        self.count.fill_(total)

    def _parts(self, observations: Any) -> list[Any]:
        if not self.names:
            return [observations]
        goal = [goal_difference(observations[GOAL], observations[ACHIEVED], self.turns)] if GOAL in self.names else []
        return [*(observations[name] for name in self.names), *goal]


class AsymmetricPolicy(MultiInputActorCriticPolicy):  # type: ignore[misc]  # Likewise.
    """An actor without, and a critic with the environment's `state`."""

    def make_features_extractor(self) -> NormalisedFeatures:
        critic = hasattr(self, "pi_features_extractor")  # The actor's is made first.
        return NormalisedFeatures(
            self.observation_space, without=() if critic else (STATE,), **self.features_extractor_kwargs
        )

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        width = self.vf_features_extractor.features_dim
        critic = MlpExtractor(width, net_arch=self.net_arch, activation_fn=self.activation_fn, device=self.device)
        self.mlp_extractor.value_net = critic.value_net


def policy_network(model: Any) -> PolicyNetwork:
    """The mean action of a model of Stable-Baselines3 with `NormalisedFeatures`."""
    front, body, head = model.policy.pi_features_extractor, model.policy.mlp_extractor, model.policy.action_net
    assert isinstance(front, NormalisedFeatures)
    spaces_of = {name: model.observation_space[name] for name in front.names}
    widths = {name: int(space.shape[-1]) for name, space in spaces_of.items()}
    return PolicyNetwork(
        widths=widths or {"observation": int(model.observation_space.shape[-1])},
        mean=front.mean.float().numpy(),
        scale=front.scale.numpy(),
        bound=BOUND,
        layers=[*body.policy_net, head],
        turns=front.turns,
    )
