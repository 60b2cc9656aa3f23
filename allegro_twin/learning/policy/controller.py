"""Policies as controllers: decisions every few periods, and between them PD control, or the hand's own, of their
set-points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.learning.policy.interface import DecisionSetPoints, Floats, Interface, InterfaceMemory, Observation
from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand, Vector


class Policy(Protocol):
    """A function from one observation, or a batch of them, to actions in [-1, 1], without a memory of its own."""

    def __call__(self, observation: Observation) -> Floats: ...


@dataclass(frozen=True, slots=True, eq=False)
class ZeroPolicy:
    """The policy without action: with a script, the script alone."""

    n_joints: int

    def __call__(self, observation: Observation) -> Floats:
        seen = observation["observation"] if isinstance(observation, dict) else observation
        return np.zeros((*seen.shape[:-1], self.n_joints), np.float32)


class PolicyMemory(NamedTuple):
    """Memory of the controller."""

    memory: InterfaceMemory
    set_points: DecisionSetPoints
    age: int
    """Control periods since the last decision."""
    tick: int
    """Tick of the last state."""


@dataclass(frozen=True, slots=True, eq=False)
class PolicyController:
    """Runs a policy on any backend. It counts the hand's periods, so lost periods do not delay decisions."""

    policy: Policy
    interface: Interface
    goal: Vector | None = None
    """For a policy with goals: goal of the fingertips in the palm frame, shape (3 * fingers,), m."""
    script: int = 0
    """Number of the interface's script."""
    target: Vector | None = None
    """Initial set-points of the joints, rad; None: the script's beginning, or where the joints are."""
    complete: Callable[[Observation], Observation] | None = None
    """Adds to an observation what no hand reports, as a camera beside it would."""

    def __post_init__(self) -> None:
        expected = self.interface.n_goal
        size = 0 if self.goal is None else np.size(self.goal)
        if size != expected:
            raise ConfigError(f"this policy takes a goal of {expected} numbers, not {size}")

    def start(self, state: HandState) -> PolicyMemory:
        return self._decide(state, self.interface.start(state.position, self.script, self.target), 0)

    def __call__(self, state: HandState, memory: PolicyMemory) -> tuple[Command, PolicyMemory]:
        inner, age = memory.memory, memory.age + state.tick - memory.tick
        while age >= self.interface.decimation:
            inner, age = self.interface.advance(inner), age - self.interface.decimation
        if inner is memory.memory:
            memory = memory._replace(age=age, tick=state.tick)
        else:
            memory = self._decide(state, inner, age)
        command = self.interface.command(state.position, state.velocity, memory.set_points, age)
        return PositionCommand(command) if self.interface.takes_positions else TorqueCommand(command), memory

    def _decide(self, state: HandState, memory: InterfaceMemory, age: int) -> PolicyMemory:
        observation = self.interface.observe(state.position, state.velocity, memory, self.goal)
        if self.complete is not None:
            observation = self.complete(observation)
        action = self.policy(observation)
        if not np.isfinite(action).all():
            raise CommandError(f"the policy's action at {state.t:.3f} s is not finite: {action}")
        seen = observation["observation"] if isinstance(observation, dict) else observation
        memory = self.interface.act(action, memory, seen)
        return PolicyMemory(memory, self.interface.set_points(memory), age, state.tick)
