"""Forward-dynamics compliance: a light virtual arm is pulled by the error and by what is felt; the real one follows.

After Scherzinger, Roennau and Dillmann, "Forward Dynamics Compliance Control (FDCC)", IROS 2017, and FZI's
cartesian_compliance_controller, which the lab's report uses. A cycle, of one or several iterations:

f = R K Rᵀ e + w_felt + w_target,  u = s (P f + D ḟ),  q̈ = H⁻¹ Jᵀ u,  q ← q + q̇ Δ,  q̇ ← 0.9 (q̇ + q̈ Δ)

The real joints follow by τ = M (ω² (q_r - q) + 2 ω (q̇_r - q̇)) + C q̇ - Jᵀ w̄_felt, with q_r on a straight line from cycle
to cycle and w̄ smoothed; what dry friction holds of the first term is overcome (`impedance.freed`). At rest f = 0,
whatever P and the iterations are: P sets how fast, K where. FZI sets the virtual arm to where the real one is before
each cycle; here it goes on from where it was, since an arm that takes torques lags a little and would swing; it is
brought back where the real one lags by more than `lag`, and goes no faster than the real one could stop.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.arm.impedance import Stiffness, freed
from allegro_twin.cell.arm.target import SMOOTH, CartesianTarget, Smoothing, approach
from allegro_twin.cell.arm.tool import WrenchCompensation
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arm import ArmModel, rotation_between
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import HandState, TorqueCommand, Vector

_STEP = 0.02  # s. Δ of the virtual arm. FZI cartesian_controllers, internal period.
_KEPT = 0.9  # Of the virtual speed, after a step. FZI.
_MOST = 1.0  # Of an error, m and rad. FZI.
_CARRIED = (
    0.1  # s. Time constant of what is felt, before the follower carries it: at once it would be a loop of its own.
)
_FZI = Stiffness(500.0, 50.0)
_SHARE = 0.7  # Of the joints' speed limits, that the virtual arm may go.
_BRAKED = 0.027  # s. OWN: half of the time in which what changes the torque must be able to stop the virtual arm.


@dataclass(frozen=True, slots=True)
class Pull:
    """Gains of the errors on the virtual arm; defaults of FZI's example."""

    linear: float = 0.05
    """P."""
    angular: float = 1.5
    damping: float = 0.005
    """D, s."""
    scale: float = 0.5
    iterations: int = 1
    """Iterations of the virtual arm in a cycle: more are faster."""


_PULL = Pull()


class VirtualArm(NamedTuple):
    """The virtual arm after a cycle."""

    position: Vector
    """(n,), rad."""
    velocity: Vector
    force: Vector
    """f of the last iteration, (6,), N and N·m."""


class ComplianceState(NamedTuple):
    """Memory of the controller."""

    virtual: VirtualArm
    """Where it will be when the next cycle begins."""
    reference: Vector
    """q_r, (n,), rad."""
    speed: Vector
    """q̇_r, (n,), rad/s."""
    setpoint: Pose
    t: float
    due: float
    """When the next cycle begins, s."""
    carried: Vector
    """What is felt, smoothed, (6,), N and N·m."""


@dataclass(frozen=True, slots=True, eq=False)
class Compliance:
    """Lead the tool to a target, and give way to what it feels, with the stiffness of a spring."""

    model: ArmModel
    target: CartesianTarget
    compensation: WrenchCompensation | None = None
    """None: nothing is felt."""
    stiffness: Stiffness = _FZI
    pull: Pull = _PULL
    cycle: float = 0.01
    """s."""
    bandwidth: float = 18.0
    """ω of the follower, rad/s. A stiffer one asks for torques that change faster than the arm's may;
    docs/explanation/arm_control.md."""
    lag: float = 0.05
    """rad."""
    smoothing: Smoothing | None = SMOOTH
    light: ArmModel = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "light", self.model.light())

    def start(self, state: HandState) -> ComplianceState:
        if self.compensation is not None and not state.wrench.size:
            raise ConfigError(
                f"{self.model.spec.name} reports no wrench: leave out the compensation, or take the impedance"
            )
        q, nothing = state.position, np.zeros(len(state.position))
        return ComplianceState(
            VirtualArm(q, nothing, np.zeros(6)), q, nothing, self.model.pose(q), state.t, state.t, np.zeros(6)
        )

    def __call__(self, state: HandState, memory: ComplianceState) -> tuple[TorqueCommand, ComplianceState]:
        dt, q, v = state.t - memory.t, state.position, state.velocity
        reference, speed = memory.reference + memory.speed * dt, memory.speed
        reference = np.minimum(np.maximum(reference, q - self.lag), q + self.lag)
        setpoint = approach(memory.setpoint, self.target.pose, dt, self.smoothing)
        virtual, due, felt = memory.virtual, memory.due, self._felt(state)
        if state.t >= due - 1e-9:
            virtual = advance_virtual_arm(
                self, virtual._replace(position=reference), setpoint, felt + self.target.wrench
            )
            speed, due = (virtual.position - reference) / self.cycle, due + self.cycle
        carried = memory.carried + (felt - memory.carried) * min(dt / _CARRIED, 1.0)
        wanted = self.bandwidth**2 * (reference - q) + 2.0 * self.bandwidth * (speed - v)
        follow = self.model.inertia(q) @ wanted
        torque = follow + self.model.coriolis(q, v) - self.model.motion(q)[2].T @ carried
        return TorqueCommand(torque + freed(self.model, follow)), ComplianceState(
            virtual, reference, speed, setpoint, state.t, due, carried
        )

    def _felt(self, state: HandState) -> Vector:
        """At the tool, in the axes of the base, (6,)."""
        if self.compensation is None:
            return np.zeros(6)
        axes = self.model.flange(state.position).rotation
        return self.compensation.base_wrench(state.wrench, axes, state.gravity, self.model.tool.position)


def advance_virtual_arm(law: Compliance, virtual: VirtualArm, setpoint: Pose, wrench: Vector) -> VirtualArm:
    """One cycle of the virtual arm from where it is, no faster than the joints may go."""
    begin, v, last = virtual
    q = begin
    spec, pull = law.model.spec, law.pull
    stiffness, share = law.stiffness.diagonal(), np.repeat([pull.linear, pull.angular], 3)
    for _ in range(pull.iterations):
        place, axes, jacobian = law.model.motion(q)
        error = np.concatenate([setpoint.position - place, rotation_between(axes, setpoint.rotation)])
        force = stiffness * np.clip(error, -_MOST, _MOST) + wrench
        effort = pull.scale * (share * force + pull.damping * (force - last) / _STEP)
        pulled = np.linalg.solve(law.light.inertia(q), jacobian.T @ effort)
        q = np.clip(q + v * _STEP, spec.lower, spec.upper)
        v, last = _KEPT * (v + pulled * _STEP), force
    over = _too_fast(law.model, begin, (q - begin) / law.cycle)
    return VirtualArm(begin + (q - begin) / over, v / over, last)


def _too_fast(model: ArmModel, position: Vector, speed: Vector) -> float:
    """How many times faster than the real arm may go, or could stop, a speed is, 1 at least.

    With a jerk of Ṫ M⁻¹ it stops within 2 √(|M q̇| / Ṫ): that is no more than 2 `_BRAKED`.
    """
    motor, over = model.spec.actuation, 1.0
    if motor.velocity_limit is not None:
        fastest = motor.velocity_limit
        if model.spec.slowing is not None:
            down, up = model.spec.slowing.speeds(position, fastest)
            fastest = np.where(speed < 0.0, -down, up)
        over = max(over, float(np.abs(speed / (fastest * _SHARE)).max()))
    if motor.torque_rate is not None:
        over = max(over, float(np.abs(model.inertia(position) @ speed / motor.torque_rate).max()) / _BRAKED**2)
    return over
