"""Excitation motions for identification: poses of the hand, slow and fast motions of every joint, and their rehearsal
in simulation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from allegro_twin.control import laws
from allegro_twin.control.controllers import GravityFeedforward, ReferenceMemory
from allegro_twin.control.time_scaling import minimum_jerk
from allegro_twin.control.trajectory import Path, SetPoint
from allegro_twin.errors import ConfigError, WrongPose, unknown
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.loop import run, until
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec, Side
from allegro_twin.twin.identify.motions.limits import alike_joints
from allegro_twin.types import Array, HandState, TorqueCommand, Vector, frozen

KP, KD = 3.0, 0.08  # N·m/rad, N·m·s/rad. Low, so that torques are not all spent on holding a path.
SWING = np.array([0.40, 0.5, 0.5, 0.5])  # rad, about the middle, from the palm outward.
KEEP = 0.06  # rad from the joint limits.
SLOW = np.array([0.09, 0.23, 0.41, 0.73, 1.1])  # Hz, each drawn ± 10 %.
SLOW_SHARE = np.array([0.30, 0.22, 0.20, 0.16, 0.12])
FAST = (2.0, 14.0)  # Hz. The inertia of a drive shows above damping / armature, some 4 Hz.
N_FAST, SHARE = 6, 0.35  # Torque sines, and their sum as a share of the torque limit.
CYCLE, CREEP, RATE = 8.0, 0.3, 0.08  # s; its share of slow motion; the slow pace. Friction shows there.
APPROACH = 1.5  # s from wherever the hand is.

NEAR = 0.003  # m between two links that count as touching: the real hand differs from the nominal one.
SCALES, TRIES = (1.0, 0.85, 0.7), 6

G = 9.81  # m/s²
TILT = np.radians(15.0)  # rad. A stand that leans more is another pose.


@dataclass(frozen=True, slots=True)
class ExcitationPose:
    """A way to place the hand. Three of these together show every joint its weight."""

    name: str
    facing: tuple[float, float, float]
    """Where the palm looks, world axes; z is up."""
    fingers: tuple[float, float, float]
    """Where stretched fingers point."""
    instruction: str
    """Instruction for a person."""

    @property
    def gravity(self) -> tuple[float, float, float]:
        """In the palm frame (x: where the palm looks, z: where the fingers point), m/s²."""
        x, z = np.array(self.facing), np.array(self.fingers)
        down = np.array([0.0, 0.0, -G])
        a, b, c = (float(down @ axis) + 0.0 for axis in (x, np.cross(z, x), z))
        return a, b, c

    def check(self, measured: Vector) -> None:
        """Raise WrongPose where measured gravity in the palm frame, (3,), m/s², shows another pose."""
        known = np.array(self.gravity)
        length = float(np.linalg.norm(measured))
        if not np.isfinite(length) or length < 0.1 * G:
            return
        lean = float(np.arccos(np.clip(measured @ known / length / G, -1.0, 1.0)))
        if lean > TILT:
            raise WrongPose(
                f"the hand's IMU is {np.degrees(lean):.0f}° off the pose {self.name!r}: {self.instruction}, or name "
                "the pose that it has"
            )


def find_pose(name: str, side: Side) -> ExcitationPose:
    """A pose by its name, for a hand of that side. Raises ConfigError with the nearest names."""
    thumb = 1.0 if side == "right" else -1.0
    known = (
        ExcitationPose("up", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), "stand the hand upright, its fingers pointing up"),
        ExcitationPose("palm-up", (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), "lay the hand on its back, the palm looking up"),
        ExcitationPose("side", (0.0, -thumb, 0.0), (1.0, 0.0, 0.0), "turn the hand on its edge, the thumb's side down"),
        ExcitationPose("palm-down", (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), "hold the hand out, the palm looking down"),
    )
    for each in known:
        if each.name == name:
            return each
    raise ConfigError(unknown("pose", name, [each.name for each in known]))


@dataclass(frozen=True, slots=True, eq=False)
class SineSum:
    """Σ aₖ sin(2π fₖ t + φₖ), (n joints, k)."""

    amplitude: Array
    frequency: Array
    phase: Array

    def __call__(self, t: float) -> tuple[Vector, Vector]:
        """Value and rate, (n,) each."""
        omega = 2.0 * np.pi * self.frequency
        angle = omega * t + self.phase
        return (self.amplitude * np.sin(angle)).sum(axis=1), (self.amplitude * omega * np.cos(angle)).sum(axis=1)


@dataclass(frozen=True, eq=False)
class Excitation:
    """A controller that plays one excitation, within the joint limits. `scale` shrinks its swing; equal seeds give
    equal motions."""

    spec: HandSpec
    seed: int
    gravity: GravityFeedforward
    scale: float = 1.0

    @cached_property
    def middle(self) -> Vector:
        """The posture about which it swings, (n,), rad: the middle of every range."""
        return frozen((self.spec.lower + self.spec.upper) / 2.0)

    @cached_property
    def path(self) -> SineSum:
        """Path about the middle; adjacent fingers spread and close in parallel."""
        n, draw = self.spec.n_joints, np.random.default_rng(self.seed)
        room = np.minimum(self.spec.upper - self.middle, self.middle - self.spec.lower) - KEEP
        swing = np.minimum(room, np.concatenate([SWING[: len(f.joints)] for f in self.spec.fingers])) * self.scale
        frequency = SLOW * draw.uniform(0.9, 1.1, (n, len(SLOW)))
        phase = draw.uniform(0.0, 2.0 * np.pi, (n, len(SLOW)))
        spread = alike_joints(self.spec)[0]
        frequency[spread], phase[spread] = frequency[spread[0]], phase[spread[0]]
        return SineSum(swing[:, None] * SLOW_SHARE, frequency, phase)

    @cached_property
    def shaking(self) -> SineSum:
        """Additional torques, N·m."""
        n, draw = self.spec.n_joints, np.random.default_rng((self.seed, 1))
        band = np.geomspace(*FAST, N_FAST) * draw.uniform(0.9, 1.1, (n, N_FAST))
        share = SHARE * self.scale * self.spec.actuation.torque_limit[:, None] / N_FAST
        return SineSum(np.broadcast_to(share, band.shape), band, draw.uniform(0.0, 2.0 * np.pi, band.shape))

    def start(self, state: HandState) -> ReferenceMemory:
        self.gravity.check(state)
        return ReferenceMemory(self.path_from(state.position), state.t)

    def path_from(self, position: Vector) -> Path:
        """Where the joints are to be, by the time since the beginning, s, from where they are, (n,), rad."""
        first, travel = frozen(position), self.middle + self.path(0.0)[0] - position

        def path(t: float) -> SetPoint:
            if t < APPROACH:
                part, rate = minimum_jerk(t / APPROACH)
                return SetPoint(first + part * travel, rate / APPROACH * travel)
            warped, pace = warp(t - APPROACH)
            swing, speed = self.path(warped)
            return SetPoint(self.middle + swing, pace * speed)

        return path

    def __call__(self, state: HandState, memory: ReferenceMemory) -> tuple[TorqueCommand, ReferenceMemory]:
        t = state.t - memory.began
        target = memory.path(t)
        more = self.gravity(state)
        if t > APPROACH:
            more = more + warp(t - APPROACH)[1] * self.shaking(t)[0]
        error, rate = target.position - state.position, target.velocity - state.velocity
        return TorqueCommand(laws.pd(error, rate, np.float64(KP), np.float64(KD), more)), memory  # type: ignore[arg-type]


def warp(t: float) -> tuple[float, float]:
    """Time along the path, s, and its pace: 1, but RATE in a part of every cycle, so that every joint creeps."""
    whole, part = divmod(t, CYCLE)
    fast = CYCLE * (1.0 - CREEP)
    lap = fast + RATE * CYCLE * CREEP
    if part < fast:
        return whole * lap + part, 1.0
    return whole * lap + fast + RATE * (part - fast), RATE


class Rehearsal(NamedTuple):
    """An excitation without contact, and its speeds."""

    excitation: Excitation
    speed: Array
    """Speed of each joint at the end of every period, (k, n), rad/s."""


def rehearse(spec: HandSpec, pose: ExcitationPose, seed: int, seconds: float) -> Rehearsal:
    """Play excitations with the nominal hand in simulation, each smaller than the one before it. Returns the first that
    meets neither the hand itself nor a joint limit. Raises ConfigError where none does."""
    model = compile_scene(spec, Stage(np.zeros(3), quaternion_facing(pose.facing, pose.fingers)))
    model.geom_margin[:] = NEAR / 2.0
    model.geom_gap[:] = NEAR / 2.0
    carried = GravityFeedforward(hand_kinematics(spec).gravity_torque)
    for scale, number in product(SCALES, range(TRIES)):
        excitation = Excitation(spec, seed + 1000 * number, carried, scale)
        backend = SimBackend(spec, model, posture=excitation.middle)
        speed = []
        for sample in until(seconds, run(backend, excitation)):
            if sample.state.t > APPROACH and backend.data.ncon:
                break
            speed.append(sample.state.velocity)
        else:
            return Rehearsal(excitation, np.array(speed))
    raise ConfigError(f"no excitation of {spec.name} found that does not touch itself: give another --seed")
