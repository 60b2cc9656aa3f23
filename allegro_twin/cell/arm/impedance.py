"""Cartesian impedance: the tool hangs on a spring and a damper from its target.

τ = Jᵀ(-K e - D J q̇) + N (kₙ (qₙ - q) - 2 √kₙ q̇) + C(q, q̇) q̇, with e = (p - p_d; φ), φ the rotation vector from the
target's orientation to the tool's, D = 2 √(K m) and N = 1 - Jᵀ (J Jᵀ)⁻¹ J; after libfranka's
cartesian_impedance_example_controller, whose φ is half of ours for small angles and whose m is 1: here it is a quarter
of what the arm weighs along an axis, with its rotors, at least 1. The arm carries itself and its load.

With a force sensor on the flange the joints' dry friction is overcome, too: at rest the spring and what is felt
cancel, and where r = Jᵀ(-K e - D J q̇ + w̄) is not nothing, friction holds it: τ_f clip(r / ε, -1, 1) is added.

Where the motion of the set-point is known, with the twist ξ and the acceleration ξ̇, J q̇ - ξ is damped and Λ ξ̇ is added,
Λ = (J M⁻¹ Jᵀ)⁻¹: a spring that is pulled along lags behind by D ξ / K, 24 mm at 0.16 m/s, and then overshoots by 7 mm.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.arm.target import SMOOTH, CartesianTarget, Smoothing, approach
from allegro_twin.cell.arm.tool import WrenchCompensation
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arm import ArmModel, rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array, HandState, TorqueCommand, Vector

_SINGULAR = 1e-6  # Added to J Jᵀ: what a stretched arm would divide by, m² and rad².
_AXES = ("x", "y", "z")
_QUARTER = 0.25  # OWN: with more damping dry friction stops the tool short of where the spring has it.
_FINE = 0.02  # ε, N·m. OWN: an eleventh of the friction of a Franka's joints is left, and nothing swings (tests).
_SMOOTHED = 0.05  # s. Time constant of w̄.


@dataclass(frozen=True, slots=True)
class Stiffness:
    """Stiffness of the Cartesian spring, the same along all axes of the base."""

    linear: float = 200.0
    """N/m. franka_ros, compliance_param.cfg."""
    angular: float = 10.0
    """N·m/rad."""

    def diagonal(self) -> Vector:
        """Shape (6,)."""
        return np.repeat([self.linear, self.angular], 3)


class SetpointMotion(NamedTuple):
    """Motion of a set-point in the axes of the base, (6,) each: linear, then angular."""

    twist: Vector
    """ξ, m/s and rad/s."""
    acceleration: Vector
    """ξ̇, m/s² and rad/s²."""


class ImpedanceState(NamedTuple):
    """Memory of the controller."""

    setpoint: Pose
    rest: Vector
    """Where the elbow likes to be: joint positions at the start, (n,), rad."""
    t: float
    wrench: Vector | None = None
    """w̄, by the tool in the axes of the base, (6,), N and N·m; None: nothing is felt."""


@dataclass(frozen=True, slots=True, eq=False)
class Impedance:
    """Keep the tool at a target with the stiffness of a spring.

    Raises ConfigError at the start for a spring that could not overcome the joints' dry friction within `slack`.
    """

    model: ArmModel
    target: CartesianTarget
    stiffness: Stiffness = Stiffness()
    null: float = 10.0
    """Stiffness of what the target leaves free, N·m/rad."""
    smoothing: Smoothing | None = SMOOTH
    """None: targets are set-points."""
    slack: tuple[float, float] = (0.01, 0.1)
    """How far friction may keep the tool from its target, m and rad."""
    compensation: WrenchCompensation | None = None
    """To what the flange feels, by which friction is overcome. None: it is not."""
    spring: Vector = field(init=False)
    """The stiffness along and about the axes, (6,)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "spring", self.stiffness.diagonal())

    def start(self, state: HandState) -> ImpedanceState:
        if self.compensation is not None and not state.wrench.size:
            raise ConfigError(f"{self.model.spec.name} reports no wrench: leave out the compensation")
        stuck(self.model, state.position, self.stiffness, self.slack, force_sensor=self.compensation is not None)
        return ImpedanceState(self.model.pose(state.position), state.position, state.t)

    def __call__(self, state: HandState, memory: ImpedanceState) -> tuple[TorqueCommand, ImpedanceState]:
        setpoint = approach(memory.setpoint, self.target.pose, state.t - memory.t, self.smoothing)
        wrench = None if self.compensation is None else smoothed_wrench(self.compensation, self.model, state, memory)
        torque = hung(self.model, state, setpoint, memory.rest, self.spring, self.null, wrench)
        return TorqueCommand(torque), ImpedanceState(setpoint, memory.rest, state.t, wrench)


def smoothed_wrench(
    compensation: WrenchCompensation, model: ArmModel, state: HandState, memory: ImpedanceState
) -> Vector:
    """w̄ after a state: the first is taken as it is."""
    axes = model.flange(state.position).rotation
    now = compensation.base_wrench(state.wrench, axes, state.gravity, model.tool.position)
    if memory.wrench is None:
        return now
    smooth: Vector = memory.wrench + (now - memory.wrench) * min((state.t - memory.t) / _SMOOTHED, 1.0)
    return smooth


def hung(
    model: ArmModel, state: HandState, setpoint: Pose, rest: Vector, stiffness: Vector, null: float,
    wrench: Vector | None = None, motion: SetpointMotion | None = None,
) -> Vector:  # fmt: skip
    """The law above, (n,), N·m. `stiffness` has shape (6,); `wrench` is w̄, (6,), or None: friction is left as it is;
    `motion` None: it stands still, or nobody knows."""
    q, v = state.position, state.velocity
    place, axes, jacobian = model.motion(q)
    error = np.concatenate([place - setpoint.position, rotation_between(setpoint.rotation, axes)])
    given = jacobian @ np.linalg.solve(model.inertia(q), jacobian.T)
    rate = jacobian @ v if motion is None else jacobian @ v - motion.twist
    force = -stiffness * error - 2.0 * np.sqrt(stiffness * _shown_mass(given)) * rate
    if motion is not None:
        force = force + np.linalg.solve(given + _SINGULAR * np.eye(6), motion.acceleration)
    free = null * (rest - q) - 2.0 * np.sqrt(null) * v
    taken = np.linalg.solve(jacobian @ jacobian.T + _SINGULAR * np.eye(6), jacobian @ free)
    torque: Vector = jacobian.T @ (force - taken) + free + model.coriolis(q, v)
    if wrench is None:
        return torque
    return torque + freed(model, jacobian.T @ (force + wrench))


def _shown_mass(given: Array) -> Vector:
    """m, (6,), kg and kg·m²: a quarter of 1 / (J M⁻¹ Jᵀ)ᵢᵢ, of what is `given`, (6, 6), the arm's along and about each
    axis where nothing else holds it, which is half of the critical damping; at least 1."""
    mass: Vector = np.maximum(_QUARTER / np.maximum(np.diag(given), _SINGULAR), 1.0)
    return mass


def freed(model: ArmModel, off: Vector) -> Vector:
    """What frees the joints from dry friction where torques (n,) are not in balance, τ_f clip(r / ε, -1, 1), N·m."""
    free: Vector = model.spec.actuation.frictionloss * np.minimum(np.maximum(off / _FINE, -1.0), 1.0)
    return free


def stuck(
    model: ArmModel, position: Vector, stiffness: Stiffness, slack: tuple[float, float], *, force_sensor: bool = False
) -> None:
    """Raise ConfigError when dry friction could hold the tool farther from its target than `slack`, m and rad.
    `force_sensor`: the flange has one, which leaves little of the friction."""
    band = _dead_band(model, position, force_sensor)
    for first, value, unit, most, name in (
        (0, stiffness.linear, "N/m", slack[0], "linear"),
        (3, stiffness.angular, "N·m/rad", slack[1], "angular"),
    ):
        axis = int(np.argmax(band[first : first + 3]))
        force = float(band[first + axis])
        if not value * most >= force:
            far = f"{1e3 * force / value:.1f} mm" if first == 0 else f"{np.degrees(force / value):.1f}°"
            raise ConfigError(
                f"stiffness.{name} {value:g} {unit}: dry friction would keep {model.spec.name} up to {far} from its "
                f"target along {_AXES[axis]}; take at least {force / most:.3g} {unit}"
            )


def _dead_band(model: ArmModel, position: Vector, force_sensor: bool) -> Array:
    """The largest force and torque along each axis that the joints' dry friction can hold, |J⁺ᵀ| τ, (6,), N and N·m."""
    _, _, jacobian = model.motion(position)
    friction = model.spec.actuation.frictionloss
    if force_sensor:
        friction = friction / (1.0 + friction / _FINE)  # r + τ_f r / ε = τ_f.
    return np.asarray(np.abs(np.linalg.pinv(jacobian.T)) @ friction)
