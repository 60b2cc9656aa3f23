"""Sampling-based model predictive control: actions are splines, tried in a batch of simulations, and the best counts.

From the present state s, with knots θ of a spline a_θ(t) over a horizon of H decisions, the task's own reward r, its
weight w and further costs c (`CostSettings`), for decisions of Δt and a discount γ a second,

    J(θ) = Σ_{h<H+S} γ^{hΔt} (w r - c Δt)(s_h, a_h),  a_h = a_θ(h) for h < H, else 0,   until the episode fails,

is maximised over samples θ_i = θ̄ + σ ε_i in one of three ways: *predictive sampling* keeps the best sample (Howell et
al. 2022), the *cross-entropy method* the mean and spread of the best share, *MPPI* the mean weighted by
exp((J_i − max J) / (λ sd J)). The first action is taken, of the best sample or with MPPI of θ̄, and θ̄ moves on by one
decision.

Among the samples of every decision are always the rest of the last plan, action by action, with no action after it; no
action at all; the action that was taken last, held; and the best samples of the last decision (`keep`). Some samples
move one finger alone (`fingers`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.snapshot import EpisodeState
from allegro_twin.learning.mpc.rollouts import Rollouts
from allegro_twin.learning.mpc.settings import MpcSettings
from allegro_twin.types import Array


class Plan(NamedTuple):
    """Result of one search."""

    actions: NDArray[np.float32]
    """Actions of the decisions of the horizon, (decisions, joints), in [-1, 1]."""
    value: float
    """J of the best sample."""


class SamplingMpc:
    """Plans actions of one episode in simulations of the same task."""

    def __init__(
        self, task: str, environment: EnvSettings, settings: MpcSettings, threads: int = 0, place: str = ""
    ) -> None:
        self.settings = settings
        self._rollouts = Rollouts(task, environment, settings, threads, place)
        own = self._rollouts.engine.task
        seconds = own.interface.seconds
        self.decisions = max(round(settings.horizon / seconds), 2)
        """In the horizon."""
        self._still = round(settings.hold / seconds)
        self._joints = own.spec.n_joints
        self._fingers = [list(finger.joints) for finger in own.spec.fingers]
        at = np.linspace(0.0, settings.knots - 1.0, self.decisions)
        low = np.minimum(at.astype(int), settings.knots - 2)
        self._low, self._part = low, (at - low)[:, None, None]
        self.begin()

    def begin(self) -> None:
        """A new episode."""
        self._rng = np.random.default_rng(self.settings.seed)
        self._mean: Array = np.zeros((self.settings.knots, self._joints))
        self._spread: Array = np.full_like(self._mean, self.settings.spread)
        self._last: Array = np.zeros(self._joints)
        self._rest: Array | None = None
        """Actions of the last plan, (decisions, joints): no spline has them, for knots lie elsewhere."""
        self._kept: Array = np.zeros((0, *self._mean.shape))
        self._begun = False
        self._place, self.searches = 0, 0
        """Place of the next decision in the present plan; searches since the beginning."""

    def plan(self, state: EpisodeState) -> NDArray[np.float32]:
        """The next action from a saved state of the episode, (joints,), in [-1, 1]: of a new plan, or where `every` is
        more than 1 of the last one."""
        every = min(self.settings.every, self.decisions)
        if self._place == 0:
            self._found = self.search(state)
            self.searches += 1
        action: NDArray[np.float32] = self._found.actions[self._place]
        self._place = (self._place + 1) % every
        if self._place == 0:
            self.move_on(self._found, every)
        return action

    def search(self, state: EpisodeState, decided: Array | None = None) -> Plan:
        """The best plan from a saved state of the episode. `decided`: the action of its first decision, (joints,),
        where that is not open any more."""
        chosen = self.settings
        if not self._begun:
            self._rollouts.begin(state)
            self._begun = True
        self._spread = np.clip(2.0 * self._spread, chosen.narrowest, chosen.spread)
        best, value, tried = np.zeros((self.decisions, self._joints), np.float32), -np.inf, []
        for iteration in range(chosen.iterations):
            knots = self._draw(self._steps_back(state) if chosen.back else np.zeros((0, *self._mean.shape)))
            actions = self._actions(knots, decided)
            if iteration == 0 and self._rest is not None:
                actions[:, 0] = self._rest if decided is None else [decided, *self._rest[1:]]
            returns = self._rollouts(state, actions.astype(float), self._still)
            top = int(returns.argmax())
            if returns[top] > value:
                best, value = actions[:, top].copy(), float(returns[top])
            tried.append((returns, knots))
            self._choose(knots, returns)
        self._keep(tried)
        # What was tried is certain here, and a mean was not tried; with `mppi` it is the plan by definition.
        return Plan(self._actions(self._mean[None], decided)[:, 0] if chosen.method == "mppi" else best, value)

    def move_on(self, plan: Plan, decisions: int = 1) -> None:
        """Go on with the rest of a plan of which so many decisions have passed."""
        taken = min(max(decisions, 1), self.decisions)
        self._last = plan.actions[taken - 1].astype(float)
        actions = plan.actions.astype(float)
        self._rest = self._rest_of(actions, decisions)
        self._mean = self._knots(self._rest)
        splines = (self._spline(knots[None])[:, 0] for knots in self._kept)
        self._kept = np.array([self._knots(self._rest_of(spline, decisions)) for spline in splines])

    def _actions(self, knots: Array, decided: Array | None) -> NDArray[np.float32]:
        actions = self._spline(knots).astype(np.float32)
        if decided is not None:
            actions[0] = decided
        return actions

    def _steps_back(self, state: EpisodeState) -> Array:
        """Knots that bring one finger back within half of the horizon, (fingers, knots, joints)."""
        action = self._rollouts.return_action(state, max(self.decisions // 2, 1))
        found: Array = np.zeros((len(self._fingers), *self._mean.shape))
        for row, joints in enumerate(self._fingers):
            found[row][: (self.settings.knots + 1) // 2, joints] = action[joints]
        return found

    def _draw(self, back: Array) -> Array:
        """Knots to try, (samples, knots, joints); `back`: those that bring a finger back."""
        chosen, rng = self.settings, self._rng
        fixed = [
            self._mean,
            np.zeros_like(self._mean),
            np.broadcast_to(self._last, self._mean.shape),
            *self._kept,
            *back,
        ]
        fixed = fixed[: max(chosen.samples // 2, 1)]
        left = chosen.samples - len(fixed)
        noise = self._spread * rng.standard_normal((left, *self._mean.shape))
        if chosen.method != "cem":
            noise *= np.exp(rng.uniform(np.log(min(chosen.narrowest / chosen.spread, 1.0)), 0.0, (left, 1, 1)))
        alone = np.flatnonzero(rng.random(left) < chosen.fingers)
        for row, finger in zip(alone, rng.integers(len(self._fingers), size=len(alone)), strict=True):
            others = np.ones(self._joints, bool)
            others[self._fingers[finger]] = False
            noise[row][:, others] = 0.0
        around = np.where((rng.random(left) < chosen.afresh)[:, None, None], 0.0, self._mean)
        if len(back):
            steps = np.flatnonzero((around == 0.0).all(axis=(1, 2)) & (rng.random(left) < 0.5))
            around[steps] = back[rng.integers(len(back), size=len(steps))]
        drawn: Array = np.clip(np.concatenate([np.stack(fixed), around + noise]), -1.0, 1.0)
        return drawn

    def _keep(self, tried: list[tuple[Array, Array]]) -> None:
        """Remember the best samples but the very best, which is the plan."""
        if self.settings.keep:
            returns, knots = (np.concatenate(parts) for parts in zip(*tried, strict=True))
            self._kept = knots[np.argsort(returns)[::-1][1 : 1 + self.settings.keep]]

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

    def _rest_of(self, actions: Array, decisions: int) -> Array:
        """What is left of actions (decisions, joints) so many decisions later, with no action after it."""
        rest = np.zeros((self.decisions, self._joints))
        rest[: max(self.decisions - decisions, 0)] = actions[decisions:]
        return rest

    def _knots(self, actions: Array) -> Array:
        """Knots on the actions of a horizon, (knots, joints)."""
        at = np.linspace(0.0, self.decisions - 1.0, self.settings.knots)
        found: Array = np.stack([np.interp(at, np.arange(self.decisions), column) for column in actions.T], axis=-1)
        return found
