"""Laws of hidden motors and gears: friction that breaks away, cogging, cables, warmth, teeth with play. NumPy alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Row = NDArray[np.float64]
N = 16


@dataclass(slots=True)
class HandPhysics:
    """A hand's truth, a row a joint: N·m, kg·m², N·m·s/rad, rad, s."""

    constant: Row
    armature: Row
    damping: Row
    friction: Row
    noise: float = 5e-5
    offset: Row = field(default_factory=lambda: np.zeros(N))
    delay: float = 0.003
    mass: Row = field(default_factory=lambda: np.ones(N))
    ratio: Row = field(default_factory=lambda: np.ones(N))
    """Breakaway over sliding friction."""
    stribeck: float = 0.12
    bristle: float = 0.0
    """How far a joint gives before it breaks away, rad; 0: it does not give."""
    load: Row = field(default_factory=lambda: np.zeros(N))
    uneven: Row = field(default_factory=lambda: np.zeros(N))
    """Share by which friction and damping are larger forwards than on average."""
    cogging: Row = field(default_factory=lambda: np.zeros(N))
    teeth: Row = field(default_factory=lambda: np.full(N, 6.0))
    """Periods of the cogging in a turn."""
    phase: Row = field(default_factory=lambda: np.zeros(N))
    cable: Row = field(default_factory=lambda: np.zeros(N))
    cold: float = 0.0
    """Share by which friction and damping are larger at the start of a session."""
    warming: float = 8.0
    play: Row = field(default_factory=lambda: np.zeros(N))
    spring: float = 0.0
    """Of the teeth, N·m/rad; 0: none, motors are one with their links."""
    lean: dict[str, Row] = field(default_factory=dict)
    """By pose, or "" for all: rotation of gravity in the palm's frame, (3,), rad."""


class MotorLaws:
    """The motors of one hand, integrated by explicit steps of `dt` s."""

    def __init__(self, physics: HandPhysics, dt: float) -> None:
        self.physics, self._dt = physics, dt
        self.reset(np.zeros(N))

    @property
    def link_friction(self) -> bool:
        """Whether dry friction acts on the links as Coulomb's, for an engine to solve."""
        return not self.physics.bristle and not self.physics.spring

    def reset(self, position: Row) -> None:
        self._motor, self._speed, self._bent = position.copy(), np.zeros(N), np.zeros(N)

    def step(self, duty: Row, link: Row, moving: Row, now: float) -> tuple[Row, Row]:
        """Torques on the links for one step, N·m, and the dry friction that `link_friction` speaks of. `duty`: part of
        full PWM; `link`, `moving`: positions and speeds of the links, rad and rad/s; `now`: s since power."""
        own = self.physics
        angle, speed = (self._motor, self._speed) if own.spring else (link, moving)
        pull = own.constant * duty
        warm = 1.0 + own.cold * np.exp(-now / own.warming)
        side = 1.0 + own.uneven * np.sign(speed)
        slides = own.friction * side * warm
        slides = slides * (1.0 + (own.ratio - 1.0) * np.exp(-np.square(speed / own.stribeck))) + own.load * np.abs(pull)
        torque = pull - own.damping * side * warm * speed
        torque = torque + own.cable + own.cogging * np.sin(own.teeth * angle + own.phase)
        if own.bristle:
            stiff = own.friction * own.ratio / own.bristle
            rate = speed - stiff * np.abs(speed) / slides * self._bent
            self._bent = np.clip(self._bent + self._dt * rate, -slides / stiff, slides / stiff)
            torque = torque - stiff * self._bent - np.sqrt(stiff * own.armature) * rate
        if own.spring:
            torque = self._turned(torque, slides, link, moving)
        return torque, slides

    def _turned(self, torque: Row, slides: Row, link: Row, moving: Row) -> Row:
        """Turn the motors by a step; what their teeth pass on to the links."""
        own, dt = self.physics, self._dt
        apart = self._motor - link
        over = apart - np.clip(apart, -own.play / 2.0, own.play / 2.0)
        passed: Row = own.spring * over + np.where(over != 0.0, 0.01 * (self._speed - moving), 0.0)
        free, holds = self._speed + dt * (torque - passed) / own.armature, dt * slides / own.armature
        self._speed = np.sign(free) * np.maximum(np.abs(free) - holds, 0.0)
        self._motor = self._motor + dt * self._speed
        return passed
