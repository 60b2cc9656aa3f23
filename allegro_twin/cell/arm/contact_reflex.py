"""Contact reflex of an arm: collision thresholds as of libfranka's `setCollisionBehavior`, and the stop beyond them.

The torques from outside are estimated as on the real arm, by its own model and not by a sensor of contacts: a momentum
observer (De Luca and Mattone, ICRA 2005; Haddadin, De Luca and Albu-Schäffer, IEEE T-RO 33(6), 2017),

r = K (p - ∫ (τ - τ_f + C(q, q̇)ᵀ q̇ + r) dt),  p = M(q) q̇,

which is τ_ext behind a low-pass filter of the cutoff K / 2π. The wrench at the flange is (J Jᵀ)⁻¹ J r, in the axes of
the base. τ is what the motors give beyond the weight of arm and load, which the arm carries itself.

Above a lower threshold there is contact, above an upper one a collision: the arm stops and holds itself, and only
`recover` (`automaticErrorRecovery`) or a reset leads out. A phase is of acceleration while a joint's speed changes by
more than `ACCELERATING`, otherwise nominal; which it is on the real arm is not published.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from allegro_twin.backend import PassThroughBackend, limp_of
from allegro_twin.errors import ArmReflex, ConfigError
from allegro_twin.files.schema import Positive, Settings
from allegro_twin.kinematics.arm import ArmModel
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import Array, Command, HandState, Vector, frozen

ACCELERATING = 0.5
"""rad/s² of a joint, smoothed. OWN."""
_REFRESHED = 3  # Steps after which the flange's Jacobian is computed again: it hardly changes in 3 ms.
RETREAT = 0.05
"""m. OWN."""
_FAINT = 5.0  # N. A smaller force says no direction.
_SMOOTHED = 0.1  # s. Time constant of that. OWN: an impact is over before it counts as acceleration.
_CRAWL = 0.01  # rad/s. OWN: slower than this a joint's dry friction is known in part only.
_RESTS = 0.02  # rad/s.
_SETTLES = 0.5  # s. OWN: so long at most an arm that is recovered brakes on.
_YIELDS = 0.1  # s. OWN: as long as an impact and its rebound take.
_BRAKE, _STIFFNESS, _DAMPING = 3.0, 7.0, 0.6
"""Gains of an arm that brakes and then holds, per N·m of torque limit: N·m·s/rad, N·m/rad and N·m·s/rad. OWN: how the
real one's control brakes is not published."""
_SINGULAR = 4e-4
"""Added to J Jᵀ, m² and rad². OWN: near a singular posture the rest of friction must not look like a force."""
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")

Torques = Annotated[tuple[Positive, ...], Field(min_length=1)]
"""N·m, one for each joint."""
Forces = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
"""N along x, y and z, and N·m about them."""


class CollisionSettings(Settings):
    """Thresholds with the names and the meaning of libfranka's `setCollisionBehavior`.

    Defaults: `setDefaultBehavior` of libfranka's examples (0e0a8ee, examples/examples_common.cpp).
    """

    lower_torque_thresholds_acceleration: Torques = (20.0,) * 7
    """Torques beyond which there is contact, one for each joint, N·m."""
    upper_torque_thresholds_acceleration: Torques = (20.0,) * 7
    """Torques beyond which the arm stops, one for each joint, N·m."""
    lower_torque_thresholds_nominal: Torques = (10.0,) * 7
    """Torques beyond which there is contact while no joint accelerates, N·m."""
    upper_torque_thresholds_nominal: Torques = (10.0,) * 7
    lower_force_thresholds_acceleration: Forces = (20.0,) * 6
    """Forces and torques at the flange beyond which there is contact, along and about the axes of the base, N and
    N·m."""
    upper_force_thresholds_acceleration: Forces = (20.0,) * 6
    lower_force_thresholds_nominal: Forces = (10.0,) * 6
    upper_force_thresholds_nominal: Forces = (10.0,) * 6
    cutoff: Positive = 100.0
    """Cutoff of the filter on estimated torques, Hz. libfranka, `setFilters`: the arm's own filters are 100 Hz by
    default."""

    @model_validator(mode="after")
    def _ordered(self) -> CollisionSettings:
        for what in ("torque", "force"):
            for phase in ("acceleration", "nominal"):
                name = f"{what}_thresholds_{phase}"
                lower, upper = getattr(self, f"lower_{name}"), getattr(self, f"upper_{name}")
                if len(lower) != len(upper):
                    raise ValueError(f"lower_{name} has {len(lower)} values and upper_{name} {len(upper)}")
                for place, (low, high) in enumerate(zip(lower, upper, strict=True)):
                    if low > high:
                        raise ValueError(f"lower_{name}[{place}] {low:g} is above upper_{name}[{place}] {high:g}")
        return self


class MomentumObserver:
    """The torques from outside, by an arm's model, its motion and the torques of its motors."""

    def __init__(self, model: ArmModel, cutoff: float) -> None:
        self._model, self._gain = model, 2.0 * math.pi * cutoff
        motor = model.spec.actuation
        self._dry, self._damping = motor.frictionloss, motor.damping
        self._momentum: Vector | None = None
        self._torque = np.zeros(model.spec.n_joints)

    @property
    def torque(self) -> Vector:
        """r, (n,), N·m."""
        return self._torque

    def reset(self) -> None:
        """Nothing is known."""
        self._momentum, self._torque = None, np.zeros(self._model.spec.n_joints)

    def update(self, position: Vector, velocity: Vector, torque: Vector, dt: float) -> Vector:
        """r after a step of `dt` seconds, over which the motors gave `torque`, (n,), N·m."""
        momentum, bias = self._model.momentum(position, velocity)
        if self._momentum is not None:
            rubbed = self._dry * np.tanh(velocity / _CRAWL) + self._damping * velocity
            outside = (momentum - self._momentum) / dt - (torque - rubbed + bias)
            # The exact step of the filter: stable however long it is.
            self._torque = self._torque + (1.0 - math.exp(-self._gain * dt)) * (outside - self._torque)
        self._momentum = momentum
        return self._torque


class ContactState(NamedTuple):
    """Contact state of an arm, as libfranka's RobotState has it."""

    joint_contact: Array
    """Lower threshold of each joint exceeded, (n,), 0 or 1."""
    joint_collision: Array
    """Upper threshold, since the last recovery, (n,)."""
    cartesian_contact: Array
    """(6,)."""
    cartesian_collision: Array
    torque: Vector
    """tau_ext_hat_filtered, (n,), N·m."""
    wrench: Vector
    """O_F_ext_hat_K at the flange, in the axes of the base, (6,), N and N·m."""
    accelerating: bool
    """Which thresholds count."""


@dataclass(frozen=True, slots=True, eq=False)
class _Thresholds:
    """Collision thresholds of one phase of the motion."""

    lower: Vector
    """(n + 6,): joints, then axes."""
    upper: Vector


class CollisionMonitor:
    """Compares the estimated torques and forces with their thresholds, step by step."""

    def __init__(self, model: ArmModel, settings: CollisionSettings) -> None:
        n = model.spec.n_joints
        for name in ("lower_torque_thresholds_acceleration", "lower_torque_thresholds_nominal"):
            if len(getattr(settings, name)) != n:
                raise ConfigError(f"{name} has {len(getattr(settings, name))} values; {model.spec.name} has {n} joints")
        self._model, self._n = model, n
        self._phases = [
            _Thresholds(
                *(
                    frozen([*getattr(settings, f"{side}_torque_thresholds_{phase}"),
                            *getattr(settings, f"{side}_force_thresholds_{phase}")])
                    for side in ("lower", "upper")
                )
            )
            for phase in ("nominal", "acceleration")
        ]  # fmt: skip
        self._observer = MomentumObserver(model, settings.cutoff)
        self.reset()

    def reset(self) -> None:
        """Nothing touches the arm."""
        self._observer.reset()
        self._velocity: Vector | None = None
        self._rate, self._steps = np.zeros(self._n), 0
        self._inverse: Array = np.zeros((6, self._n))
        self._felt = self._collided = np.zeros(self._n + 6)
        self._accelerating = False
        self.reflex: ArmReflex | None = None
        """Why the arm has stopped."""

    @property
    def torque(self) -> Vector:
        """tau_ext_hat_filtered, (n,), N·m."""
        return self._observer.torque

    def update(self, position: Vector, velocity: Vector, torque: Vector, dt: float) -> None:
        """After a step of `dt` seconds, over which the motors gave `torque`, (n,), N·m; sets `reflex`."""
        outside = self._observer.update(position, velocity, torque, dt)
        if self._steps % _REFRESHED == 0:
            jacobian = self._model.motion(position)[2]
            self._inverse = np.asarray(
                np.linalg.solve(jacobian @ jacobian.T + _SINGULAR * np.eye(6), jacobian), dtype=np.float64
            )
        self._steps += 1
        wrench = self._inverse @ outside
        if self._velocity is not None:
            share = 1.0 - math.exp(-dt / _SMOOTHED)
            self._rate = self._rate + share * ((velocity - self._velocity) / dt - self._rate)
        self._velocity, self._felt = velocity, np.concatenate([outside, wrench])
        self._accelerating = bool(np.abs(self._rate).max() > ACCELERATING)
        over = np.abs(self._felt) > self._phases[self._accelerating].upper
        if over.any():
            self._collided = np.maximum(self._collided, over)
            if self.reflex is None:
                self.reflex = self._named(over)

    @property
    def state(self) -> ContactState:
        """Contact state of the last step."""
        n, contact = self._n, (np.abs(self._felt) > self._phases[self._accelerating].lower).astype(np.float64)
        return ContactState(
            contact[:n], self._collided[:n], contact[n:], self._collided[n:], self._felt[:n], self._felt[n:],
            self._accelerating,
        )  # fmt: skip

    def _named(self, over: NDArray[np.bool_]) -> ArmReflex:
        n, name = self._n, self._model.spec.name
        limit = self._phases[self._accelerating].upper
        worst = int(np.argmax(np.where(over, np.abs(self._felt) / limit, 0.0)))
        phase = "acceleration" if self._accelerating else "nominal"
        if worst < n:
            word, what, unit = "joint_reflex", f"the torque from outside on {self._model.spec.joints[worst]}", "N·m"
            key = f"upper_torque_thresholds_{phase}[{worst}]"
        else:
            axis = worst - n
            word, unit = "cartesian_reflex", "N" if axis < 3 else "N·m"
            what = f"the {'force' if axis < 3 else 'torque'} on the flange of {name} {'along' if axis < 3 else 'in'} "
            what += _AXES[axis]
            key = f"upper_force_thresholds_{phase}[{axis}]"
        return ArmReflex(
            f"{word}: {what} is {self._felt[worst]:.1f} {unit}, beyond {key} of {limit[worst]:g} {unit}; {name} has "
            f"stopped and holds itself: free it, and recover() or reset() it",
            word, tuple(self._felt[n:].tolist()),
        )  # fmt: skip


def retreat_offset(reflex: ArmReflex, base: Array) -> Vector:
    """Where an arm that has stopped is to back off to, by `RETREAT`: the way by which it is pushed and never down, up
    for a faint push, (3,), m, in the axes in which the base's are `base`, (3, 3), z up."""
    force = base @ np.array(reflex.wrench[:3])
    way = np.array([force[0], force[1], max(force[2], 0.0)])
    size = float(np.linalg.norm(way))
    return RETREAT * (way / size if size > _FAINT else np.array([0.0, 0.0, 1.0]))


class ContactReflex(PassThroughBackend):
    """A simulated arm that stops by itself, at every step of its physics, whatever it is commanded then.

    Stands behind the guard. Raises ArmReflex from then on, until `recover` or `reset`.
    """

    def __init__(self, inner: SimBackend, model: ArmModel, settings: CollisionSettings) -> None:
        super().__init__(inner)
        self._sim, self.monitor = inner, CollisionMonitor(model, settings)
        self._dt = float(inner.model.opt.timestep)
        self._begin()
        self.on_step: Callable[[ContactState], None] | None = None
        """Hears of every step; for measurements."""
        inner.watch = self._watch

    def _begin(self) -> None:
        self._at: Vector | None = None  # Where it came to rest.
        self._stopping = 0.0  # s that it has been stopping for.
        self._settling = False  # Recovered, and not yet at rest.

    def reset(self) -> HandState:
        self._begin()
        self.monitor.reset()
        return super().reset()

    def write(self, command: Command) -> None:
        if self.monitor.reflex is not None:
            raise self.monitor.reflex
        super().write(command)

    def read(self) -> HandState:
        state = super().read()
        if self.monitor.reflex is not None:
            raise self.monitor.reflex
        return state

    def recover(self) -> HandState:
        """As `automaticErrorRecovery`: the arm takes commands again, and obeys them from when it has come to rest."""
        self._settling = True
        self.monitor.reset()
        self._inner.write(limp_of(self.spec))
        return self._inner.read()

    def _watch(self, position: Vector, velocity: Vector, torque: Vector) -> Vector | None:
        self.monitor.update(position, velocity, torque, self._dt)
        if self.on_step is not None:
            self.on_step(self.monitor.state)
        if self._settling:
            self.monitor.reflex = None
            if self._at is None and self._stopping < _SETTLES:
                return self._stop(position, velocity)
            self._begin()
            self.monitor.reset()
        return None if self.monitor.reflex is None else self._stop(position, velocity)

    def _stop(self, position: Vector, velocity: Vector) -> Vector:
        """Brake what goes against the contact, give way a moment to what it pushes back, and hold what rests, (n,)."""
        limit = self.spec.actuation.torque_limit
        if self._at is None and float(np.abs(velocity).max()) < _RESTS:
            self._at = position
        if self._at is None:
            self._stopping += self._dt
            yields = (velocity * self.monitor.torque > 0.0) & (self._stopping < _YIELDS)
            wanted = -np.where(yields, 0.0, _BRAKE) * limit * velocity
        else:
            wanted = limit * (_STIFFNESS * (self._at - position) - _DAMPING * velocity)
        return np.asarray(np.clip(wanted, -limit, limit))
