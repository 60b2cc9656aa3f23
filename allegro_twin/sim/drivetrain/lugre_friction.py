"""Friction that breaks away (LuGre), by the engine's own DC motor, of which nothing but its friction is used.

    τ = σ₀ z + σ₁ ż,   ż = v − σ₀ |v| z / g(v),   g(v) = F_c + (F_s − F_c) exp(−(v / v_s)²)

F_c: dry friction in motion, F_s: at breakaway, v_s: the speed over which the one falls to the other, z: how far the
bristles are bent, at most F_s / σ₀, which is what `bristle` says. σ₁ = √(σ₀ A), with the armature A: half of critical.
Canudas de Wit et al. 1995, A new model for control of systems with friction.
"""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from allegro_twin.types import Array, Vector

_NO_MOTOR = 1e-6
"""N·m/A: the engine wants a motor to be one."""
STILL = 0.02
"""rad/s. Slower, nobody knows to which side the bristles are bent."""
Indices = NDArray[np.int_]


def add_friction(hand: mujoco.MjSpec, joint: str) -> None:
    """A friction actuator on a joint, whose numbers are set in the compiled model; the joint's own friction is gone."""
    hand.joint(joint).frictionloss = 0.0
    element = hand.add_actuator(name=friction_actuator(joint), target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    element.set_to_dcmotor([_NO_MOTOR, _NO_MOTOR], 1.0, lugre=[1.0, 0.1, 0.01, 0.01, 0.1])


def friction_actuator(joint: str) -> str:
    return f"{joint}_friction"


def is_friction_only(gain: int, numbers: Array) -> bool:
    """Whether an actuator with such a gain and its numbers is friction and nothing that could be told to give."""
    return bool(gain == mujoco.mjtGain.mjGAIN_DCMOTOR and numbers[1] <= _NO_MOTOR * numbers[0])


def set_friction(
    model: mujoco.MjModel,
    elements: Indices,
    dry: Vector,
    ratio: Vector,
    speed: Vector,
    bristle: Vector,
    armature: Vector,
) -> None:
    """Set F_c (N·m), F_s / F_c, v_s (rad/s), how far the bristles bend (rad), and the armature (kg·m²), one each."""
    dry = np.maximum(dry, 1e-6)
    stiffness = dry * ratio / bristle
    model.actuator_dynprm[elements, 5] = stiffness
    model.actuator_dynprm[elements, 6] = np.sqrt(stiffness * armature)
    model.actuator_biasprm[elements, 3] = dry
    model.actuator_biasprm[elements, 4] = dry * ratio
    model.actuator_biasprm[elements, 5] = speed


class BatchedFriction:
    """Friction of many simulations of a model that was tuned, set anew from step to step."""

    def __init__(self, sims: batch.Batch, elements: Indices) -> None:
        rows = slice(int(elements[0]), int(elements[-1]) + 1)  # `add_friction` makes them one after the other.
        self._dynamics, self._bias = (sims.expand(f"actuator_{name}")[:, rows] for name in ("dynprm", "biasprm"))

    def set(self, dry: Array, ratio: Vector, bristle: Vector, armature: Vector) -> None:
        """As in `set_friction`, the first (w, n), the others (n,)."""
        dry = np.maximum(dry, 1e-6)
        breakaway = dry * ratio
        stiffness = breakaway / bristle
        self._dynamics[:, :, 5], self._dynamics[:, :, 6] = stiffness, np.sqrt(stiffness * armature)
        self._bias[:, :, 3], self._bias[:, :, 4] = dry, breakaway


def followed_deflection(ratio: Vector, speed: Vector, bristle: Vector, velocity: Array, period: float) -> Array:
    """How far the bristles are bent after each of some periods, (k, …, n), rad, by the speeds in them, (k, …, n),
    rad/s: each period's motion at a constant speed, bent by nothing before the first."""
    found, bent = np.empty(velocity.shape), np.zeros(velocity.shape[1:])
    for k, moved in enumerate(velocity):
        level = (1.0 + (ratio - 1.0) * np.exp(-np.square(moved / speed))) / ratio
        steady = np.sign(moved) * bristle * level
        bent = found[k] = steady + (bent - steady) * np.exp(-np.abs(moved) * period / (bristle * level))
    return found


def steady_deflection(ratio: Vector, speed: Vector, bristle: Vector, velocity: Array) -> Array:
    """How far the bristles are bent in steady motion, rad: g(v) sgn(v) / σ₀."""
    level = (1.0 + (ratio - 1.0) * np.exp(-np.square(velocity / speed))) / ratio
    return np.asarray(bristle * level * np.tanh(velocity / STILL))
