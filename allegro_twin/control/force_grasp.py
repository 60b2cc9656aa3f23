"""Grasps that control force: the centroid grasp with two to four fingertips, and the envelop grasp with all links."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control.centroid import holding, joint_torques, pressing, resting
from allegro_twin.control.contact import Stall, stalling, touching
from allegro_twin.control.controllers import PD, Following, Gravity
from allegro_twin.control.laws import known
from allegro_twin.types import Array, HandState, TorqueCommand, Vector

FingertipsOf: TypeAlias = Callable[[Vector], tuple[Array, Array]]
"""Joint positions (n,) -> positions (k, 3), m, and translational Jacobians (k, 3, n) of the grasping fingertips."""


class Gripping(NamedTuple):
    """What a force grasp remembers."""

    reach: Following
    t: float
    stall: Stall
    contact: float
    """When every finger had met the object, s; NaN before."""
    spots: Array
    """Where the fingertips were then, (k, 3), m."""
    gripping: NDArray[np.bool_]
    """Which fingers press: those that had met it, (k,)."""
    rest: Vector
    """Joint positions then, (n,), rad."""


@dataclass(frozen=True, slots=True, eq=False)
class CentroidGrasp:
    """Reach the pre-shape, close softly until every finger has met the object, then press through their centroid.

    Fingers that do not take part follow `reach` all the time.
    """

    reach: PD
    """Leads to the pre-shape, and on into the object."""
    close_at: float
    """When the fingers begin to close, s since the controller began."""
    squeeze_at: float
    """When the force is due, s: the latest moment, if some finger has not met anything."""
    fingertips: FingertipsOf
    joints: Array
    """Joint indices of the grasping fingers, the thumb's last, (k, j)."""
    gravity: Gravity
    closing_torque: Vector
    """The most that a joint may push before contact, (n,), N·m."""
    friction: Vector
    """Dry friction of the joints, (n,), N·m: what a torque loses before the fingertip feels it."""
    force: float
    """On the thumb; the fingers share the same, N."""
    spread: float = 0.25
    """How much of a finger's force may point toward the others."""
    ramp: float = 0.3
    """From closing to full force, s."""
    stiffness: float = 600.0
    """Against a motion of the object, N/m."""
    damping: float = 0.12
    """Of every joint, N·m·s/rad."""
    posture_stiffness: float = 1.0
    """Of what the fingertips do not feel, N·m/rad."""
    felt: Callable[[], NDArray[np.bool_]] | None = None
    """Which of its fingers something touches now, (k,), as somebody else knows, a mirror; None: those that are pushed
    and stand still."""

    def start(self, state: HandState) -> Gripping:
        following = self.reach.start(state)
        spots = np.full((len(self.joints), 3), np.nan)
        everyone = np.ones(len(self.joints), dtype=bool)
        return Gripping(following, state.t, Stall(np.zeros(len(everyone))), np.nan, spots, everyone, state.position)

    def __call__(self, state: HandState, memory: Gripping) -> tuple[TorqueCommand, Gripping]:
        command, _ = self.reach(state, memory.reach)
        since = state.t - memory.reach.began
        if since < self.close_at:
            return command, memory._replace(t=state.t)
        weight = self.gravity(state)
        soft = np.minimum(np.maximum(command.torque, weight - self.closing_torque), weight + self.closing_torque)
        tips, jacobians = self.fingertips(state.position)
        memory = self._felt(state, memory, tips, soft - weight, since)
        torque = command.torque.copy()
        torque[self.joints.reshape(-1)] = soft[self.joints.reshape(-1)]
        if not np.isnan(memory.contact):
            part = min((state.t - memory.contact) / self.ramp, 1.0)
            who = memory.gripping
            grip = weight + self._grip(state, memory, tips[who], jacobians[who])
            mine = self.joints[who].reshape(-1)
            torque[mine] += part * (grip - soft)[mine]
        return TorqueCommand(torque), memory

    def _felt(self, state: HandState, memory: Gripping, tips: Array, push: Vector, since: float) -> Gripping:
        """Notice contact: from then on the object is held where the fingertips found it."""
        stall = stalling(memory.stall, state.velocity[self.joints], push[self.joints], state.t - memory.t)
        memory = memory._replace(t=state.t, stall=stall)
        met = touching(stall) if self.felt is None else self.felt()
        if np.isnan(memory.contact) and (met.all() or since >= self.squeeze_at):
            # Without the thumb, or with nothing but it, there is no opposition to build on: all press.
            who = met if met[-1] and met.sum() > 1 else np.ones_like(met)
            return memory._replace(contact=state.t, spots=tips, gripping=who, rest=state.position)
        return memory

    def _grip(self, state: HandState, memory: Gripping, tips: Array, jacobians: Array) -> Vector:
        forces = pressing(tips, self.force, self.spread) + holding(tips, memory.spots[memory.gripping], self.stiffness)
        posture = resting(jacobians, self.posture_stiffness * (memory.rest - state.position))
        press = joint_torques(jacobians, forces)
        lost = self.friction * np.clip(press / self.friction, -1.0, 1.0)
        return press + lost + posture - self.damping * known(state.velocity)


class Wrapped(NamedTuple):
    """What an envelop grasp remembers."""

    reach: Following
    t: float
    stall: Stall
    rest: Vector
    """Joint positions at which the object stopped each finger, (n,), rad; NaN before."""


@dataclass(frozen=True, slots=True, eq=False)
class EnvelopGrasp:
    """Reach the pre-shape under position control, then wrap: constant torques close every link onto the object.

    From the squeeze on the joints are also springs about where the object stopped them, lest a wide can turn.
    """

    reach: PD
    close_at: float
    squeeze_at: float
    gravity: Gravity
    joints: Array
    """Joint indices of the fingers that wrap, (k, j)."""
    torque: Vector
    """Closing torques at scale 1, (n,), N·m; joints with zero stay at the pre-shape."""
    scale: float = 1.0
    closing_scale: float = 0.3
    """Of `torque` before the squeeze."""
    stiffness: float = 4.0
    """Against a motion of the wrapped object, N·m/rad."""
    ramp: float = 0.3
    """s."""
    damping: float = 0.12
    """Of the closing joints, N·m·s/rad."""

    def start(self, state: HandState) -> Wrapped:
        still = Stall(np.zeros(len(self.joints)))
        return Wrapped(self.reach.start(state), state.t, still, np.full(len(state.position), np.nan))

    def __call__(self, state: HandState, memory: Wrapped) -> tuple[TorqueCommand, Wrapped]:
        command, _ = self.reach(state, memory.reach)
        since = state.t - memory.reach.began
        if since < self.close_at:
            return command, memory._replace(t=state.t)
        part = min(max((since - self.squeeze_at) / self.ramp, 0.0), 1.0)
        wrap = (self.closing_scale + part * (self.scale - self.closing_scale)) * self.torque
        memory = self._felt(state, memory, wrap, since)
        spring = self.stiffness * np.nan_to_num(memory.rest - state.position)
        wrap = wrap + spring + self.gravity(state) - self.damping * known(state.velocity)
        return TorqueCommand(np.where(self.torque != 0.0, wrap, command.torque)), memory

    def _felt(self, state: HandState, memory: Wrapped, push: Vector, since: float) -> Wrapped:
        """Notice, from the squeeze on, which fingers the object has stopped: there they stay."""
        stall = stalling(memory.stall, state.velocity[self.joints], push[self.joints], state.t - memory.t)
        rest = memory.rest
        new = touching(stall) & np.isnan(rest[self.joints[:, 0]])
        if since >= self.squeeze_at and new.any():
            rest, mine = rest.copy(), self.joints[new]
            rest[mine] = state.position[mine]
        return memory._replace(t=state.t, stall=stall, rest=rest)
