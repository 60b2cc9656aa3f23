"""Faults of a simulated arm: backends in front of a backend, for rehearsals and tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from allegro_twin.backend import HandBackend, PassThroughBackend
from allegro_twin.errors import LinkTimeout
from allegro_twin.types import HandState, Vector, frozen


class SilentBackend(PassThroughBackend):
    """Nothing comes from the arm from a moment on, s since its reset; it holds itself, and only a reset leads out."""

    def __init__(self, inner: HandBackend, at: float) -> None:
        super().__init__(inner)
        self._at, self._t = at, 0.0

    def reset(self) -> HandState:
        self._t = 0.0
        return super().reset()

    def read(self) -> HandState:
        if self._t + self.period > self._at - 1e-9:
            raise LinkTimeout(
                f"no state from {self.spec.name} since {self._t:.3f} s: it holds itself; see to its cable, and reset it"
            )
        state = super().read()
        self._t = state.t
        return state


class DisturbedBackend(PassThroughBackend):
    """The flange's sensor is noisy, or wrong from a moment on. The same seed is the same noise.

    `noise`: standard deviations of force and torque in each sample, (6,), N and N·m; `bias`, (6,), from `at` (s) on.
    """

    def __init__(
        self, inner: HandBackend, noise: Vector, bias: Vector | None = None, at: float = 0.0, seed: int = 0
    ) -> None:
        super().__init__(inner)
        self._noise, self._seed, self._at = np.asarray(noise, dtype=np.float64), seed, at
        self._bias = np.zeros(6) if bias is None else np.asarray(bias, dtype=np.float64)
        self._chance = np.random.default_rng(seed)

    def reset(self) -> HandState:
        self._chance = np.random.default_rng(self._seed)
        return self._seen(super().reset())

    def read(self) -> HandState:
        return self._seen(super().read())

    def recover(self) -> HandState:
        return self._seen(super().recover())

    def _seen(self, state: HandState) -> HandState:
        bias = self._bias if state.t >= self._at else 0.0
        return replace(state, wrench=frozen(state.wrench + self._noise * self._chance.standard_normal(6) + bias))
