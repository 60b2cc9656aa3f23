"""Model predictive control as a controller: it plans from what a hand measures, in lockstep or beside it."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.snapshot import EpisodeState
from allegro_twin.learning.mpc.observed import ObservedEpisode
from allegro_twin.learning.mpc.sampling import Plan, SamplingMpc
from allegro_twin.learning.mpc.settings import MpcSettings
from allegro_twin.learning.policy.interface import DecisionSetPoints, InterfaceMemory
from allegro_twin.types import Array, Command, HandState, PositionCommand, TorqueCommand


class MpcMemory(NamedTuple):
    """Memory of the controller."""

    memory: InterfaceMemory
    set_points: DecisionSetPoints
    action: Array
    """Action of the present decision, (joints,), in [-1, 1]."""
    age: int
    """Control periods since the last decision."""
    tick: int
    """Tick of the last state."""


class MpcController:
    """Plans the actions of one task, and performs them as a policy's.

    In *lockstep* every decision waits for its plan: the time of a simulated hand stands still meanwhile. With
    `real_time` a thread plans, one plan after another, each from the newest decision; the last plan goes on being
    performed until the next has come, and what it does in the decision of its beginning is taken for certain.

    `place`: where the settings are written, before a key in an error.

    `start` begins anew: a run in lockstep repeats itself to the bit. Its simulations belong to one run at a time.
    """

    def __init__(
        self,
        task: str,
        episode: ObservedEpisode,
        settings: MpcSettings,
        *,
        real_time: bool = False,
        threads: int = 0,
        place: str = "",
    ) -> None:
        self.episode, self.real_time = episode, real_time
        environment: EnvSettings = episode.environment
        self._mpc = SamplingMpc(task, environment, settings, threads, place)
        self._interface = episode.engine.task.interface
        self._worker = ThreadPoolExecutor(1, "mpc") if real_time else None
        self._pending: Future[Plan] | None = None
        self.plans, self.decisions = 0, 0
        """Plans that were made since `start`, and decisions that were taken."""

    def start(self, state: HandState) -> MpcMemory:
        self._wait()
        self.plans = self.decisions = 0
        self.episode.begin(state)
        self._mpc.begin()
        self._plan = Plan(np.zeros((1, len(state.position)), np.float32), 0.0)
        self._from = self._asked = 0
        """Decisions in which the present plan begins, and the one that is being made."""
        target = self.episode.engine.task.initial_targets(np.zeros(1, np.int64))
        memory = self._interface.start(state.position, 0, None if target is None else target[0])
        return self._decide(state, memory, 0)

    def __call__(self, state: HandState, memory: MpcMemory) -> tuple[Command, MpcMemory]:
        self.episode.look(state.t)
        inner, age = memory.memory, memory.age + state.tick - memory.tick
        while age >= self._interface.decimation:
            inner, age = self._interface.advance(inner), age - self._interface.decimation
            self.decisions += 1
        if inner is memory.memory:
            memory = memory._replace(age=age, tick=state.tick)
        else:
            self.episode.follow(state, memory.action)
            memory = self._decide(state, inner, age)
        command = self._interface.command(state.position, state.velocity, memory.set_points, age)
        return PositionCommand(command) if self._interface.takes_positions else TorqueCommand(command), memory

    def report(self, seconds: float) -> str:
        """One line on a run of so many seconds of the hand."""
        how = "beside the hand" if self.real_time else "in lockstep"
        rate = self.plans / seconds if seconds > 0 else 0.0
        return f"mpc: {self.plans} plans {how} in {self.decisions + 1} decisions, {rate:.1f} a second of the hand"

    def close(self) -> None:
        """End planning. A further `start` is not possible with `real_time`."""
        self._wait()
        if self._worker is not None:
            self._worker.shutdown()

    def _decide(self, state: HandState, memory: InterfaceMemory, age: int) -> MpcMemory:
        action = self._planned() if self._worker is None else self._at_hand()
        memory = self._interface.act(action, memory)
        return MpcMemory(memory, self._interface.set_points(memory), action, age, state.tick)

    def _planned(self) -> Array:
        """The next action of a plan, a new one where it is time for one."""
        action = self._mpc.plan(self.episode.save()).astype(float)
        self.plans = self._mpc.searches
        return action

    def _at_hand(self) -> Array:
        """The action of the newest plan; a new one is begun where the last is ready."""
        if self._pending is not None and self._pending.done():
            self._plan, self._from, self._pending = self._pending.result(), self._asked, None
            self.plans += 1
        action = self._action()
        if self._pending is None and self._worker is not None:
            passed, self._asked = self.decisions - self._from, self.decisions
            self._pending = self._worker.submit(self._next, self.episode.save(), self._plan, passed, action)
        return action

    def _action(self) -> Array:
        place = self.decisions - self._from
        actions = self._plan.actions
        return actions[place].astype(float) if place < len(actions) else np.zeros(actions.shape[1])

    def _next(self, state: EpisodeState, before: Plan, passed: int, action: Array) -> Plan:
        """In the worker: a plan from a state in which an action is already decided."""
        if len(before.actions) > 1:
            self._mpc.move_on(before, passed)
        return self._mpc.search(state, action)

    def _wait(self) -> None:
        if self._pending is not None:
            self._pending.result()
            self._pending = None
