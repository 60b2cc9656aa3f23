"""Sampling-based model predictive control: actions are splines, tried in a batch of simulations, and the best counts.

From the present state s, with knots θ of a spline a_θ(t) over a horizon of H decisions and the task's own reward r,

    J(θ) = Σ_{h<H} r(s_h, a_θ(h)) + Σ_{H≤h<H+S} r(s_h, 0),   until the episode fails,

is maximised over samples θ_i = θ̄ + σ ε_i in one of three ways: *predictive sampling* keeps the best sample (Howell et
al. 2022), the *cross-entropy method* the mean and spread of the best share, *MPPI* the mean weighted by
exp((J_i − max J) / (λ sd J)). The first action is taken, of the best sample or with MPPI of θ̄, and θ̄ moves on by one
decision.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from allegro_twin.files.schema import Positive, Settings
from allegro_twin.learning.environments.settings import EnvSettings, env_keywords
from allegro_twin.learning.environments.snapshot import EpisodeState, spread_snapshot
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.types import Array

Share = Annotated[float, Field(gt=0, le=1)]


class MpcSettings(Settings):
    """How actions are looked for."""

    method: Literal["cem", "mppi", "predictive"] = "cem"
    samples: Annotated[int, Field(ge=2)] = 48
    """Simulations side by side."""
    horizon: Positive = 0.6
    """s"""
    hold: Annotated[float, Field(ge=0)] = 0.36
    """s after the horizon without any action, in which a plan that ends in a bad hold shows it."""
    knots: Annotated[int, Field(ge=2)] = 4
    """Of the spline, over the horizon; between them it is linear."""
    iterations: Annotated[int, Field(ge=1)] = 2
    """Of the search in each decision."""
    spread: Positive = 0.4
    """Largest standard deviation of samples, in parts of an action's range."""
    narrowest: Positive = 0.05
    """Least standard deviation, with `cem`, which begins every decision with twice that of the last."""
    elite: Share = 0.15
    """Best share of the samples, with `cem`."""
    temperature: Positive = 0.2
    """λ, with `mppi`."""
    seed: int = 0


class SamplingMpc:
    """Plans actions of one episode in simulations of the same task."""

    def __init__(self, task: str, environment: EnvSettings, settings: MpcSettings, threads: int = 0) -> None:
        self.settings = settings
        self._sims = HandVectorEnv(
            task, settings.samples, threads=threads, autoreset_mode="disabled", **env_keywords(environment)
        )
        self._sims.reset(seed=settings.seed)
        seconds = self._sims.engine.task.interface.seconds
        self.decisions = max(round(settings.horizon / seconds), 2)
        """In the horizon."""
        self._still = round(settings.hold / seconds)
        self._joints = self._sims.engine.task.spec.n_joints
        at = np.linspace(0.0, settings.knots - 1.0, self.decisions)
        low = np.minimum(at.astype(int), settings.knots - 2)
        self._low, self._part = low, (at - low)[:, None, None]
        self.begin()

    def begin(self) -> None:
        """A new episode."""
        self._rng = np.random.default_rng(self.settings.seed)
        self._mean: Array = np.zeros((self.settings.knots, self._joints))
        self._spread: Array = np.full_like(self._mean, self.settings.spread)

    def plan(self, state: EpisodeState) -> NDArray[np.float32]:
        """The next action from a saved state of the episode, (joints,), in [-1, 1]."""
        chosen = self.settings
        self._spread = np.clip(2.0 * self._spread, chosen.narrowest, chosen.spread)
        best = self._mean
        for _ in range(chosen.iterations):
            knots = self._mean + self._spread * self._rng.standard_normal((chosen.samples, *self._mean.shape))
            knots[0] = self._mean
            knots = np.clip(knots, -1.0, 1.0)
            returns = self._returns(state, knots)
            best = knots[int(returns.argmax())]
            self._choose(knots, returns)
        # What was tried is certain here, and a mean was not tried; with `mppi` it is the plan by definition.
        actions = self._spline((self._mean if chosen.method == "mppi" else best)[None])[:, 0]
        self._move_on(actions)
        first: NDArray[np.float32] = actions[0].astype(np.float32)
        return first

    def _returns(self, state: EpisodeState, knots: Array) -> Array:
        """Sum of the rewards of each sample, (samples,)."""
        spread_snapshot(self._sims, state.parts)
        actions = self._spline(knots).astype(np.float32)
        total, going = np.zeros(len(knots)), np.ones(len(knots), bool)
        for each in (*actions, *[np.zeros_like(actions[0])] * self._still):
            _, reward, failed, _, _ = self._sims.step(each)
            total += np.where(going, reward, 0.0)
            going &= ~failed
        return total

    def _spline(self, knots: Array) -> Array:
        """Actions at every decision, (decisions, samples, joints), of knots (samples, knots, joints)."""
        by_knot = knots.transpose(1, 0, 2)
        found: Array = by_knot[self._low] * (1.0 - self._part) + by_knot[self._low + 1] * self._part
        return found

    def _choose(self, knots: Array, returns: Array) -> None:
        chosen = self.settings
        if chosen.method == "predictive":
            self._mean = knots[int(returns.argmax())]
        elif chosen.method == "mppi":
            weight = np.exp((returns - returns.max()) / (chosen.temperature * (returns.std() + 1e-9)))
            self._mean = np.tensordot(weight / weight.sum(), knots, 1)
        else:
            best = knots[np.argsort(returns)[-max(round(chosen.elite * len(knots)), 2) :]]
            self._mean = best.mean(axis=0)
            self._spread = np.maximum(best.std(axis=0), chosen.narrowest)

    def _move_on(self, actions: Array) -> None:
        """The spline one decision later, which ends with no action."""
        later = np.concatenate([actions[1:], np.zeros((1, self._joints))])
        at = np.linspace(0.0, self.decisions - 1.0, self.settings.knots)
        self._mean = np.stack([np.interp(at, np.arange(self.decisions), column) for column in later.T], axis=-1)
