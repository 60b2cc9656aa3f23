"""Rollouts: plans of actions tried side by side in simulations of one episode, and what each is worth."""

from __future__ import annotations

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.environments.settings import EnvSettings, env_keywords
from allegro_twin.learning.environments.snapshot import EpisodeState, spread_snapshot
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.mpc.costs import PlanCosts
from allegro_twin.learning.mpc.settings import MpcSettings
from allegro_twin.learning.policy.interface import radian_scale
from allegro_twin.types import Array


def planner_environment(environment: EnvSettings, settings: MpcSettings) -> EnvSettings:
    """The environment in which plans are tried: the same decisions, perhaps with coarser physics."""
    changed: dict[str, object] = {"coarse": environment.coarse or settings.coarse}
    if settings.stride:
        steps = max(round(environment.decimation / settings.stride), 1)
        period = environment.period * environment.decimation / steps
        spec = load_spec(environment.hand, environment.side)
        changed |= {"period": period, "timestep": spec.longest_step(period), "decimation": steps}
    return environment.model_copy(update=changed)


class Rollouts:
    """`samples` simulations of a task that go on from one saved state. `place`: where the settings are written, before
    a key in an error. Raises ConfigError, also for terms that the task does not report."""

    def __init__(
        self, task: str, environment: EnvSettings, settings: MpcSettings, threads: int = 0, place: str = ""
    ) -> None:
        self.settings, self._place = settings, place
        planner = planner_environment(environment, settings)
        self._steps, self._periods = planner.decimation, environment.decimation
        self._sims = HandVectorEnv(
            task, settings.samples, threads=threads, autoreset_mode="disabled", **env_keywords(planner)
        )
        self._sims.reset(seed=settings.seed)
        self.engine = self._sims.engine
        if settings.stride > 1 and self.engine.task.interface.scripts is not None:
            raise ConfigError(f"{place}stride: {self.engine.task.name} has a script, which goes by control periods: "
                              "leave stride out")  # fmt: skip
        if settings.count and not self.engine.task.count_term:
            raise ConfigError(f"{place}count: {self.engine.task.name} counts nothing: leave it out")
        if settings.terms:
            self._check_terms()
        self.costs = PlanCosts(settings.costs, self.engine, place)

    def begin(self, state: EpisodeState) -> None:
        """A new episode, from its first state."""
        self._spread(state)
        object_body = self.engine.task.object_body
        self._home = np.array(self.engine.memory.end[0])
        self.costs.begin(self.engine.worlds.position[0], None if object_body is None else object_body.pose[0])

    def return_action(self, state: EpisodeState, decisions: int) -> Array:
        """The action that brings each joint's set-point back to the beginning's in so many decisions, (joints,)."""
        interface = self.engine.task.interface
        if interface.mode != "delta":
            raise ConfigError(f"{self._place}back is for control delta, not {interface.mode}: leave it out")
        end = state.parts["engine/memory/end"][0]
        most = decisions * interface.step * radian_scale(interface.spec)
        action: Array = np.clip((self._home - end) / most, -1.0, 1.0)
        return action

    def __call__(self, state: EpisodeState, actions: Array, still: int) -> Array:
        """What each sample is worth from a saved state: `actions` (decisions, samples, joints), and then `still`
        decisions without any. What has failed pays as much as the worst that goes on. Shape (samples,)."""
        self._spread(state)
        engine, n = self.engine, self.engine.n
        seconds, weight = engine.task.interface.seconds, self.settings.reward
        total, going, before = np.zeros(n), np.ones(n, bool), np.zeros(n)
        for decision, each in enumerate((*actions, *[np.zeros_like(actions[0])] * still)):
            taken = engine.clip_actions(each)
            engine.step(taken, None if going.all() else np.flatnonzero(going))
            outcome, _ = engine.outcome(taken, engine.observe())
            worth = self.settings.discount ** (seconds * decision)
            gained = worth * (weight * outcome.reward - seconds * (self.costs() + self._terms(outcome.terms)))
            if self.settings.count:
                if (name := engine.task.count_term) not in outcome.terms:
                    raise ConfigError(f"{self._place}count: {engine.task.name} reports no {name}: leave count out")
                count = outcome.terms[name]
                gained, before = gained + worth * self.settings.count * (count - before), count
            gained = np.where(np.isfinite(gained), gained, 0.0)
            # Else what fails at once would save the costs of what fails later.
            total += np.where(going, gained, min(gained[going].min(), 0.0))
            going &= ~outcome.failed
            if not going.any():
                break
        return total

    def _terms(self, terms: dict[str, Array]) -> Array | float:
        """Costs of the terms of a step, (samples,), 1/s. Raises ConfigError for a term that there is not."""
        total: Array | float = 0.0
        for name, weight in self.settings.terms.items():
            if name not in terms:
                raise ConfigError(f"{self._place}terms.{name}: {unknown('term', name, terms)}")
            total = total + weight * terms[name]
        return total

    def _check_terms(self) -> None:
        """A task tells its terms with a step."""
        self.engine.step(np.zeros((self.settings.samples, self.engine.task.spec.n_joints), np.float32))
        outcome, _ = self.engine.outcome(np.zeros((self.settings.samples, self.engine.task.spec.n_joints)),
                                         self.engine.observe())  # fmt: skip
        self._terms(outcome.terms)
        self._sims.reset(seed=self.settings.seed)

    def _spread(self, state: EpisodeState) -> None:
        spread_snapshot(self._sims, state.parts)
        self.engine.memory.tick[...] = self.engine.memory.tick // self._periods * self._steps
