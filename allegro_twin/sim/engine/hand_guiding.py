"""A person's hand on the simulated fingers: springs that lead the joints along a path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import Sample, Vector


@dataclass(slots=True, eq=False)
class HandGuide:
    """Pulls the joints towards `path(t)` from outside, whatever the motors do; called with every sample."""

    backend: SimBackend
    path: Callable[[float], Vector]
    """Where the person leads the joints at a time of the hand's clock (s), (n,), rad."""
    stiffness: float = 3.0
    """N·m/rad."""
    damping: float = 0.05
    """N·m·s/rad."""
    strength: float = 0.5
    """The most that a person pushes on one joint, N·m."""

    def __call__(self, sample: Sample) -> None:
        state = sample.state
        pull = self.stiffness * (self.path(state.t) - state.position) - self.damping * state.velocity
        self.backend.push(np.clip(pull, -self.strength, self.strength))

    def let_go(self) -> None:
        """Take the hand away."""
        self.backend.push(np.zeros(self.backend.spec.n_joints))
