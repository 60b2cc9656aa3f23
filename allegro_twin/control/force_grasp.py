"""Grasps that control force: the centroid grasp with two to four fingertips, the envelop grasp with all links, and the
latching grasp, whose squeeze begins where the object has stopped the fingers.

The centroid grasp follows Bae et al., "A Grasp Strategy with the Geometric Centroid of a Groped Object Shape Derived
from Contact Spots", ICRA 2012: fingertips press through the centroid of their contacts and hold it where it was found,
so the size of the object need not be known. Arrays broadcast over leading batch dimensions; of k fingertips the last,
the thumb, opposes the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control.controllers import PD, GravityFeedforward, ReferenceMemory
from allegro_twin.control.laws import known_rate, pd
from allegro_twin.control.trajectory import Path, Reference, SetPoint
from allegro_twin.types import Array, HandState, TorqueCommand, Vector


class StallTimes(NamedTuple):
    """Contact from torque and position alone: a finger that is pushed and does not move has met something."""

    seconds: Array
    """How long each finger has been pushed without moving, shape (k,), s."""

    @property
    def begun(self) -> bool:
        return bool((self.seconds > 0).any())


def update_stall(
    stall: StallTimes, velocity: Array, torque: Array, dt: float, *, still: float = 0.05, push: float = 0.05
) -> StallTimes:
    """The stall times `dt` s later. `velocity`, `torque`: the joints of each finger, (k, j), rad/s and N·m.

    A finger counts as pushed when some joint is given more than `push` beyond what moves it freely, and as still when
    no joint is faster than `still`; otherwise its time begins anew.
    """
    blocked = (np.abs(velocity).max(axis=-1) < still) & (np.abs(torque).max(axis=-1) > push)
    return StallTimes(np.where(blocked, stall.seconds + dt, 0.0))


def fingers_in_contact(stall: StallTimes, after: float = 0.06) -> NDArray[np.bool_]:
    """Which fingers are in contact, shape (k,), bool: stalled for at least `after` seconds."""
    return stall.seconds >= after


def pressing_forces(tips: Array, force: Array | float, spread: float = 0.25) -> Array:
    """Forces by which the fingertips press the object and that cancel, shape (..., k, 3), N.

    With c the centroid of the m = k - 1 fingers and u the direction from it to the thumb: f_thumb = -F u and
    f_i = F/m u + β (c - p_i). Their sum is zero, and so is their moment about any point, whatever F and β are: they
    load the object and do not move it. β makes the part toward the centroid at most `spread` of F/m, since a finger
    that pulls sideways more than friction allows slides off. For two fingertips it is the line between them.
    `tips`: positions (..., k, 3), m; `force` F on the thumb, N.
    """
    fingers, thumb = tips[..., :-1, :], tips[..., -1:, :]
    centroid = fingers.mean(axis=-2, keepdims=True)
    axis = thumb - centroid
    axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-6)
    share = np.asarray(force)[..., None, None] / fingers.shape[-2]
    inward = centroid - fingers
    widest = np.linalg.norm(inward, axis=-1, keepdims=True).max(axis=-2, keepdims=True)
    inward = inward * (spread / np.maximum(widest, 1e-6)) * (widest > 1e-6)
    return np.concatenate([share * (axis + inward), -share * fingers.shape[-2] * axis], axis=-2)


def holding_forces(tips: Array, spots: Array, stiffness: float) -> Array:
    """Forces that bring the object back to where it was gripped, shape (..., k, 3), N, without adding to the pressing.

    With e_i = spot_i - p_i, mean ē and u_i the direction to the centroid: f_i = K (ē + (1 - u_i u_iᵀ)(e_i - ē)). The
    first term resists a shift of the whole grasp, the second its rotation; what would only open or close it is left
    to `pressing_forces`. `stiffness` K in N/m.
    """
    away = spots - tips
    shift = away.mean(axis=-2, keepdims=True)
    towards = tips.mean(axis=-2, keepdims=True) - tips
    unit = towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-6)
    turned = away - shift
    turned = turned - unit * (unit * turned).sum(axis=-1, keepdims=True)
    forces: Array = stiffness * (shift + turned)
    return forces


def joint_torques(jacobians: Array, forces: Array) -> Array:
    """τ = Σ J_iᵀ f_i, shape (..., n), N·m. `jacobians`: translational, (..., k, 3, n), m/rad."""
    torque: Array = np.einsum("...kcn,...kc->...n", jacobians, forces)
    return torque


def null_space_torque(jacobians: Array, torque: Array, damping: float = 1e-6) -> Array:
    """The part of a joint torque that exerts no fingertip force, (..., n): τ less Jᵀ (J Jᵀ + λ 1)⁻¹ J τ of each finger.

    A finger of four joints that holds a point has one motion left; posture torques act on that alone. `damping` λ in
    m²/rad² keeps a straight finger's inverse finite.
    """
    tip = np.einsum("...kcn,...n->...kc", jacobians, torque)
    square = np.einsum("...kcn,...kdn->...kcd", jacobians, jacobians)
    felt = np.linalg.solve(square + damping * np.eye(3), tip[..., None])[..., 0]
    return torque - joint_torques(jacobians, felt)


FingertipsOf: TypeAlias = Callable[[Vector], tuple[Array, Array]]
"""Joint positions (n,) -> positions (k, 3), m, and translational Jacobians (k, 3, n) of the grasping fingertips."""


class CentroidMemory(NamedTuple):
    """Memory of a centroid grasp."""

    reach: ReferenceMemory
    t: float
    stall: StallTimes
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
    gravity: GravityFeedforward
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
    """Damping of every joint, N·m·s/rad."""
    posture_stiffness: float = 1.0
    """Stiffness towards the posture, in the null space of the fingertip forces, N·m/rad."""
    contacts: Callable[[], NDArray[np.bool_]] | None = None
    """Another source, such as a mirror, for which of its fingers are in contact, (k,); None: those that are pushed and
    do not move."""

    def start(self, state: HandState) -> CentroidMemory:
        following = self.reach.start(state)
        spots = np.full((len(self.joints), 3), np.nan)
        everyone = np.ones(len(self.joints), dtype=bool)
        return CentroidMemory(
            following, state.t, StallTimes(np.zeros(len(everyone))), np.nan, spots, everyone, state.position
        )

    def __call__(self, state: HandState, memory: CentroidMemory) -> tuple[TorqueCommand, CentroidMemory]:
        command, _ = self.reach(state, memory.reach)
        since = state.t - memory.reach.began
        if since < self.close_at:
            return command, memory._replace(t=state.t)
        weight = self.gravity(state)
        soft = np.minimum(np.maximum(command.torque, weight - self.closing_torque), weight + self.closing_torque)
        tips, jacobians = self.fingertips(state.position)
        memory = self._detect_contact(state, memory, tips, soft - weight, since)
        torque = command.torque.copy()
        torque[self.joints.reshape(-1)] = soft[self.joints.reshape(-1)]
        if not np.isnan(memory.contact):
            part = min((state.t - memory.contact) / self.ramp, 1.0)
            who = memory.gripping
            grip = weight + self._grip(state, memory, tips[who], jacobians[who])
            mine = self.joints[who].reshape(-1)
            torque[mine] += part * (grip - soft)[mine]
        return TorqueCommand(torque), memory

    def _detect_contact(
        self, state: HandState, memory: CentroidMemory, tips: Array, push: Vector, since: float
    ) -> CentroidMemory:
        """Notice contact: from then on the object is held where the fingertips found it."""
        stall = update_stall(memory.stall, state.velocity[self.joints], push[self.joints], state.t - memory.t)
        memory = memory._replace(t=state.t, stall=stall)
        met = fingers_in_contact(stall) if self.contacts is None else self.contacts()
        if np.isnan(memory.contact) and (met.all() or since >= self.squeeze_at):
            # Without the thumb, or with nothing but it, there is no opposition to build on: all press.
            who = met if met[-1] and met.sum() > 1 else np.ones_like(met)
            return memory._replace(contact=state.t, spots=tips, gripping=who, rest=state.position)
        return memory

    def _grip(self, state: HandState, memory: CentroidMemory, tips: Array, jacobians: Array) -> Vector:
        forces = pressing_forces(tips, self.force, self.spread) + holding_forces(
            tips, memory.spots[memory.gripping], self.stiffness
        )
        posture = null_space_torque(jacobians, self.posture_stiffness * (memory.rest - state.position))
        press = joint_torques(jacobians, forces)
        lost = self.friction * np.clip(press / self.friction, -1.0, 1.0)
        return press + lost + posture - self.damping * known_rate(state.velocity)


class EnvelopMemory(NamedTuple):
    """Memory of an envelop grasp."""

    reach: ReferenceMemory
    t: float
    stall: StallTimes
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
    gravity: GravityFeedforward
    joints: Array
    """Joint indices of the fingers that wrap, (k, j)."""
    torque: Vector
    """Closing torques at scale 1, (n,), N·m; joints with zero stay at the pre-shape."""
    scale: float = 1.0
    closing_scale: float = 0.3
    """Share of `torque` that closes the fingers before the squeeze."""
    stiffness: float = 4.0
    """Against a motion of the wrapped object, N·m/rad."""
    ramp: float = 0.3
    """s."""
    damping: float = 0.12
    """Damping of the closing joints, N·m·s/rad."""

    def start(self, state: HandState) -> EnvelopMemory:
        still = StallTimes(np.zeros(len(self.joints)))
        return EnvelopMemory(self.reach.start(state), state.t, still, np.full(len(state.position), np.nan))

    def __call__(self, state: HandState, memory: EnvelopMemory) -> tuple[TorqueCommand, EnvelopMemory]:
        command, _ = self.reach(state, memory.reach)
        since = state.t - memory.reach.began
        if since < self.close_at:
            return command, memory._replace(t=state.t)
        part = min(max((since - self.squeeze_at) / self.ramp, 0.0), 1.0)
        wrap = (self.closing_scale + part * (self.scale - self.closing_scale)) * self.torque
        memory = self._detect_contact(state, memory, wrap, since)
        spring = self.stiffness * np.nan_to_num(memory.rest - state.position)
        wrap = wrap + spring + self.gravity(state) - self.damping * known_rate(state.velocity)
        return TorqueCommand(np.where(self.torque != 0.0, wrap, command.torque)), memory

    def _detect_contact(self, state: HandState, memory: EnvelopMemory, push: Vector, since: float) -> EnvelopMemory:
        """Notice, from the squeeze on, which fingers the object has stopped: there they stay."""
        stall = update_stall(memory.stall, state.velocity[self.joints], push[self.joints], state.t - memory.t)
        rest = memory.rest
        new = fingers_in_contact(stall) & np.isnan(rest[self.joints[:, 0]])
        if since >= self.squeeze_at and new.any():
            rest, mine = rest.copy(), self.joints[new]
            rest[mine] = state.position[mine]
        return memory._replace(t=state.t, stall=stall, rest=rest)


EARLY = 0.8
"""Share of the closing time in which fingers may move on beyond their expected contact with the object."""


class LatchParameters(NamedTuple):
    """Numbers of a latching grasp; of many, each with leading batch dimensions, times as (..., 1)."""

    kp: Array
    """(..., n), N·m/rad."""
    kd: Array
    """(..., n), N·m·s/rad."""
    close_at: Array | float
    """When the fingers begin to close, s since the controller began."""
    squeeze_at: Array | float
    """When they latch, s."""
    ramp: Array | float
    """From latching to the whole squeeze, s."""
    limit: Array
    """The most that a joint pushes while it closes, (..., n), N·m."""
    damping: Array
    """Damping of the joints themselves, (..., n), N·m·s/rad; the torque that it takes is not counted as contact."""
    beyond: Array
    """How far joints go on beyond where they are expected to meet the object, (..., n), rad."""
    offset: Array
    """Offset of the squeeze from the positions where the joints have come to rest, (..., n), rad."""


class LatchState(NamedTuple):
    """Memory of the law, NaN before it latches, (..., n) each, rad."""

    rest: Array
    """Where the joints were when the squeeze began."""
    pressed: Array
    """The spring's deflection then."""


def latch_torque(
    wanted: SetPoint, position: Array, velocity: Array, since: float, parameters: LatchParameters, latch: LatchState
) -> tuple[Array, LatchState]:
    """Torques that close and squeeze, (..., n), N·m, without the hand's weight.

    Until `squeeze_at`: τ = Kp (q* + β - q) + Kd (q̇* + β̇ - q̇) within ±(limit + damping |q̇*|), with β growing to
    `beyond`, so that fingers stop at the object whatever its size and place. Then they latch at q_r with the deflection
    e_r = τ/Kp, and τ = Kp (q_r + e_r + s (offset - e_r) - q) - Kd q̇, with s from 0 to 1 during `ramp`.
    `wanted`: q* and q̇* on the way to the closed posture; `since` s since the controller began.
    """
    p = parameters
    seconds = EARLY * np.maximum(p.squeeze_at - np.asarray(p.close_at), 1e-9)
    part = np.minimum(np.maximum((since - p.close_at) / seconds, 0.0), 1.0)
    rate = wanted.velocity + np.where((part > 0.0) & (part < 1.0), p.beyond / seconds, 0.0)
    torque = pd(wanted.position + part * p.beyond - position, known_rate(rate - velocity), p.kp, p.kd)
    most = np.where(since >= p.close_at, p.limit + p.damping * np.abs(rate), np.inf)
    torque = np.minimum(np.maximum(torque, -most), most)
    squeezes = since >= np.asarray(p.squeeze_at)
    new = squeezes & np.isnan(latch.rest)
    rest, pressed = np.where(new, position, latch.rest), np.where(new, torque / p.kp, latch.pressed)
    done = np.minimum(np.maximum((since - p.squeeze_at) / p.ramp, 0.0), 1.0)
    held = pd(rest + pressed + done * (p.offset - pressed) - position, -known_rate(velocity), p.kp, p.kd)
    return np.where(squeezes, held, torque), LatchState(rest, pressed)


class LatchMemory(NamedTuple):
    """Memory of a latching grasp."""

    path: Path
    began: float
    latch: LatchState


@dataclass(frozen=True, slots=True, eq=False)
class LatchGrasp:
    """Reach the pre-shape, close with little torque until the object stops the fingers, then squeeze from there.

    The squeeze is an offset from where the fingers have come to rest in this very close, so that its torque is the same
    whatever the size and the place of the object.
    """

    reference: Reference
    """Leads to the pre-shape, and on to the closed posture; where it leads afterwards does not matter."""
    parameters: LatchParameters
    gravity: GravityFeedforward

    def start(self, state: HandState) -> LatchMemory:
        self.gravity.check(state)
        unknown = np.full(len(state.position), np.nan)
        return LatchMemory(self.reference.begin(state.position), state.t, LatchState(unknown, unknown))

    def __call__(self, state: HandState, memory: LatchMemory) -> tuple[TorqueCommand, LatchMemory]:
        since = state.t - memory.began
        torque, latch = latch_torque(
            memory.path(since), state.position, state.velocity, since, self.parameters, memory.latch
        )
        return TorqueCommand(torque + self.gravity(state)), memory._replace(latch=latch)
