"""A policy as a controller like any other: it decides every few periods, and between them its set-points are held by
a PD law, or by the hand's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.learning.policy.interface import Course, Floats, Interface, Memory, Observation
from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand, Vector


class Policy(Protocol):
    """From one observation, or a batch of them, to actions in [-1, 1]; without a memory of its own."""

    def __call__(self, observation: Observation) -> Floats: ...


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """The policy that does nothing: with a script, the scripted player."""

    n_joints: int

    def __call__(self, observation: Observation) -> Floats:
        seen = observation["observation"] if isinstance(observation, dict) else observation
        return np.zeros((*seen.shape[:-1], self.n_joints), np.float32)


class Deciding(NamedTuple):
    """What the controller remembers."""

    memory: Memory
    course: Course
    age: int
    """Control periods since the last decision."""
    tick: int
    """Of the state that was answered last."""


@dataclass(frozen=True, slots=True, eq=False)
class PolicyController:
    """Runs a policy on any backend. The hand's clock counts: where periods were missed, decisions are not late."""

    policy: Policy
    interface: Interface
    goal: Vector | None = None
    """For a policy with goals: where the fingertips should be in the palm frame, shape (3 * fingers,), m."""
    script: int = 0
    """Which of the interface's scripts."""
    target: Vector | None = None
    """Where the joints are drawn to at the beginning, rad; None: to the script's beginning, or to where they are."""
    beside: Callable[[Observation], Observation] | None = None
    """What completes an observation with what no hand reports, as a camera beside it would."""

    def __post_init__(self) -> None:
        wanted = self.interface.n_goal
        given = 0 if self.goal is None else np.size(self.goal)
        if given != wanted:
            raise ConfigError(f"this policy takes a goal of {wanted} numbers, not {given}")

    def start(self, state: HandState) -> Deciding:
        return self._decided(state, self.interface.start(state.position, self.script, self.target), 0)

    def __call__(self, state: HandState, memory: Deciding) -> tuple[Command, Deciding]:
        inner, age = memory.memory, memory.age + state.tick - memory.tick
        while age >= self.interface.decimation:
            inner, age = self.interface.elapsed(inner), age - self.interface.decimation
        if inner is memory.memory:
            memory = memory._replace(age=age, tick=state.tick)
        else:
            memory = self._decided(state, inner, age)
        told = self.interface.told(state.position, state.velocity, memory.course, age)
        return PositionCommand(told) if self.interface.leads else TorqueCommand(told), memory

    def _decided(self, state: HandState, memory: Memory, age: int) -> Deciding:
        observation = self.interface.observe(state.position, state.velocity, memory, self.goal)
        if self.beside is not None:
            observation = self.beside(observation)
        action = self.policy(observation)
        if not np.isfinite(action).all():
            raise CommandError(f"the policy's action at {state.t:.3f} s is not finite: {action}")
        seen = observation["observation"] if isinstance(observation, dict) else observation
        memory = self.interface.act(action, memory, seen)
        return Deciding(memory, self.interface.course(memory), age, state.tick)
