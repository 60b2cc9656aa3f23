"""The wrist: a stiff gantry that carries the palm along a timeline, in place of an arm.

Six joints in series: three slides along the world's axes, then, from the orientation in which the palm is presented,
three hinges about the palm's own x, y and z. So a turn about one palm axis is a motion of one joint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.types import Array

WRIST_JOINTS = ("wrist_x", "wrist_y", "wrist_z", "wrist_roll", "wrist_pitch", "wrist_yaw")
# Chosen to be as stiff as a good arm's end: 20 N/mm and 600 N·m/rad, critically damped
# (docs/reference/allegro_model.md#wrist).
_STIFFNESS = np.array([2e4] * 3 + [600.0] * 3)
_INERTIA = np.array([8.0] * 3 + [0.08] * 3)
_UPRIGHT = 1.0 - 1e-9
"""Sine of the second hinge's angle from which the first and the third have one axis."""


class WristServo(NamedTuple):
    """Servo gains of the wrist's six joints, (6,) each: slides in N/m and kg, hinges in N·m/rad and kg·m². Critically
    damped."""

    stiffness: Array
    inertia: Array

    @property
    def damping(self) -> Array:
        """N·s/m and N·m·s/rad."""
        damping: Array = 2.0 * np.sqrt(self.stiffness * self.inertia)
        return damping


STIFF_WRIST = WristServo(_STIFFNESS, _INERTIA)


@dataclass(frozen=True, slots=True, eq=False)
class WristSegment:
    """A stretch of the timeline: from rest to rest by `move`, or a shake about the same place."""

    seconds: float
    move: Array
    """Added to the wrist's six coordinates over the segment, minimum jerk, shape (6,), m and rad."""
    shake: Array
    """Peak acceleration along each coordinate, one after the other, shape (6,), m/s² and rad/s²; zero for none."""
    frequency: float = 2.0
    """Frequency of the shake, Hz."""


def add_wrist(spec: mujoco.MjSpec, palm: mujoco.MjsBody, joints: Sequence[str] = WRIST_JOINTS) -> None:
    """Give the palm, placed where it is presented, the six joints and their servos, or only some of them."""
    slides = matrix_from_quaternion(palm.quat)  # Row i is the world's axis i seen from the palm as it is presented.
    for index, name in enumerate(WRIST_JOINTS):
        if name not in joints:
            continue
        slide = index < 3
        palm.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE if slide else mujoco.mjtJoint.mjJNT_HINGE,
            axis=slides[index] if slide else np.eye(3)[index - 3],
            armature=STIFF_WRIST.inertia[index],
        )
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=STIFF_WRIST.stiffness[index], kv=STIFF_WRIST.damping[index])


def set_wrist_servo(model: mujoco.MjModel, servo: WristServo) -> None:
    """Give the six joints of a compiled scene another drive: an arm that yields, in place of a stiff one. The slides'
    inertia is that of all that they move, the hand's with it."""
    for index, name in enumerate(WRIST_JOINTS):
        motor = model.actuator(name).id
        model.actuator_gainprm[motor, 0] = servo.stiffness[index]
        model.actuator_biasprm[motor, 1:3] = -servo.stiffness[index], -servo.damping[index]
        model.dof_armature[model.joint(name).dofadr[0]] = servo.inertia[index] - (
            wrist_load(model) if index < 3 else 0.0
        )


def wrist_angles(rotation: Array) -> Array:
    """The three hinges that turn a palm by R = Rx(a) Ry(b) Rz(c), (3,), rad; c is 0 where a and c have one axis."""
    b = np.arcsin(np.clip(rotation[0, 2], -1.0, 1.0))
    if abs(rotation[0, 2]) > _UPRIGHT:
        return np.array([np.arctan2(rotation[2, 1], rotation[1, 1]), b, 0.0])
    return np.array([
        np.arctan2(-rotation[1, 2], rotation[2, 2]), b, np.arctan2(-rotation[0, 1], rotation[0, 0])
    ])  # fmt: skip


def wrist_load(model: mujoco.MjModel) -> float:
    """What the wrist carries when the hand is empty, kg."""
    return float(model.body_subtreemass[model.body("palm_link").id])


def wrist_set_points(
    segments: list[WristSegment], timestep: float, load: float, gravity: float = 9.81, servo: WristServo = STIFF_WRIST
) -> Array:
    """The servo set-points at every physics step, shape (k, 6).

    Each is the wanted coordinate plus what makes the servo follow it without lag: (kv v + I a) / kp, and on the
    vertical slide the weight `load` (kg) that it carries. `servo`: as the one follows whose inertia is that.
    """
    place = np.zeros(6)
    rows = []
    for segment in segments:
        t: Array = timestep * np.arange(1.0, round(segment.seconds / timestep) + 1)
        position, velocity, acceleration = _minimum_jerk(t, segment.seconds, segment.move)
        if segment.shake.any():
            position, velocity, acceleration = _shaken(t, segment)
        rows.append(place + position + (servo.damping * velocity + servo.inertia * acceleration) / servo.stiffness)
        place = place + segment.move
    table = np.concatenate(rows) if rows else np.zeros((1, 6))
    table[:, 2] += load * gravity / servo.stiffness[2]
    return table


def _minimum_jerk(t: Array, seconds: float, move: Array) -> tuple[Array, Array, Array]:
    """x = 10 s³ - 15 s⁴ + 6 s⁵ with s = t / T, and its derivatives."""
    s = (t / seconds)[:, None]
    return (
        move * (10 * s**3 - 15 * s**4 + 6 * s**5),
        move * (30 * s**2 - 60 * s**3 + 30 * s**4) / seconds,
        move * (60 * s - 180 * s**2 + 120 * s**3) / seconds**2,
    )


def _shaken(t: Array, segment: WristSegment) -> tuple[Array, Array, Array]:
    """One axis after the other: a sine under an envelope that rises and falls over the first and last cycle.

    The derivatives are taken numerically from the smooth displacement.
    """
    axes = np.flatnonzero(segment.shake)
    each = segment.seconds / len(axes)
    omega = 2.0 * math.pi * segment.frequency
    position = np.zeros((len(t), 6))
    for number, axis in enumerate(axes):
        local = t - number * each
        inside = (local > 0.0) & (local <= each)
        ramp = np.clip(np.minimum(local, each - local) * segment.frequency, 0.0, 1.0)
        envelope = ramp**3 * (10 - 15 * ramp + 6 * ramp**2)
        position[inside, axis] = (segment.shake[axis] / omega**2 * envelope * np.sin(omega * local))[inside]
    velocity = np.asarray(np.gradient(position, t, axis=0))
    acceleration = np.asarray(np.gradient(velocity, t, axis=0))
    return position, velocity, acceleration
