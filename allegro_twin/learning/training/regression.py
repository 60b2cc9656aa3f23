"""Learns actions by regression: a network of states in which somebody says what to do."""

from __future__ import annotations

import io
from collections.abc import Sequence

import torch

from allegro_twin.errors import ConfigError, HandError
from allegro_twin.learning.policy.interface import Floats
from allegro_twin.learning.training.onnx_policy import PolicyNetwork

_LEAST = 1e-2
"""Added to the spread of every observed number."""
_SLOWEST = 0.01
"""Share of the learning rate at the end of a training."""


class ActionRegression:
    """Layers with ELU between, which minimise the squared error of their actions with Adam.

    Numbers are scaled by mean and spread of the states of the first `learn`. The same calls give the same network, bit
    for bit.
    """

    def __init__(self, observation: int, action: int, hidden: Sequence[int], learning_rate: float, seed: int) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            layers: list[torch.nn.Module] = []
            for width, out in zip((observation, *hidden), (*hidden, action), strict=True):
                layers += [torch.nn.Linear(width, out), torch.nn.ELU()]
        self._layers = torch.nn.Sequential(*layers[:-1])
        self.sizes = observation, action
        self._rate, self._seed = learning_rate, seed
        self._adam = torch.optim.Adam(self._layers.parameters(), lr=learning_rate)
        self._mean, self._spread = torch.zeros(observation), torch.zeros(observation)
        self._calls = 0

    def learn(self, observed: Floats, actions: Floats, updates: int, batch: int, *, last: bool) -> float:
        """Learn from states (rows, observation) and the actions in them (rows, action). `last`: the learning rate falls
        in a straight line to a hundredth. Returns the mean squared error of an action in the last mini-batch. Raises
        HandError where it is not finite."""
        torch.set_num_threads(1)  # No number may depend on how many there are.
        draws = torch.Generator().manual_seed(self._seed * 1009 + self._calls)
        given, wanted = torch.from_numpy(observed), torch.from_numpy(actions)
        if not self._calls:
            self._mean, self._spread = given.mean(dim=0), given.std(dim=0) + _LEAST
        self._calls += 1
        given, error = (given - self._mean) / self._spread, torch.zeros(())
        for update in range(updates):
            for group in self._adam.param_groups:
                group["lr"] = self._rate * max(1.0 - last * update / updates, _SLOWEST)
            rows = torch.randint(len(given), (batch,), generator=draws)
            error = ((self._layers(given[rows]) - wanted[rows]) ** 2).sum(dim=-1).mean()
            self._adam.zero_grad()
            error.backward()
            self._adam.step()
        if not torch.isfinite(error):
            raise HandError(f"the training diverged: choose a learning_rate below {self._rate:g}, and another folder")
        return float(error.detach())

    def network(self, name: str = "observation") -> PolicyNetwork:
        """The network for a policy file; `name` of its input."""
        return PolicyNetwork({name: len(self._mean)}, self._mean, 1.0 / self._spread, None, [*self._layers])

    def dump(self) -> bytes:
        """All that decides what the next `learn` does, for `load`."""
        whole = io.BytesIO()
        torch.save(
            {"layers": self._layers.state_dict(), "adam": self._adam.state_dict(), "mean": self._mean,
             "spread": self._spread, "calls": self._calls}, whole,
        )  # fmt: skip
        return whole.getvalue()

    def load(self, content: bytes) -> None:
        """Go on from a `dump` of a network of the same sizes. Raises ConfigError for what is none."""
        try:
            found = torch.load(io.BytesIO(content), weights_only=True)
            self._layers.load_state_dict(found["layers"])
            self._adam.load_state_dict(found["adam"])
            self._mean, self._spread, self._calls = found["mean"], found["spread"], found["calls"]
        except (RuntimeError, KeyError, ValueError, EOFError) as error:
            raise ConfigError(f"no state of a network of these sizes: {error}") from error
