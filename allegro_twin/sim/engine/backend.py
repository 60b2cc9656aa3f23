"""The hand in MuJoCo: lockstep, as fast as it goes, the same bits every time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import mujoco
import numpy as np

from allegro_twin.backend import position_of, torque_of
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.sim.drivetrain.drivetrain import Drivetrain, drives_joints
from allegro_twin.sim.drivetrain.servos import ONE, Servos
from allegro_twin.sim.drivetrain.transmission import ActuatorLengths
from allegro_twin.sim.engine.mouse_force import SECONDS, MouseDrag, MouseForce
from allegro_twin.sim.engine.world import World
from allegro_twin.sim.model.joints import JointChange, PostureMap, as_slice, motor_joints, set_joint_losses
from allegro_twin.sim.model.wrist import WRIST_JOINTS
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.spec.drivetrain import Ailment, Drive
from allegro_twin.types import NO_WRENCH, Array, Command, HandState, Vector, frozen

ENGINE = f"mujoco {mujoco.__version__}"
"""What the figures of a simulation depend on."""
_NO_WRIST = np.zeros((0, 6))
Places: TypeAlias = slice | list[int]
"""Places of a device's joints in an array of the simulation."""
_STIFFNESS, _DAMPING = 7.0, 0.6
"""Stiffness and damping of the wrist's servos per N·m of torque limit: N·m/rad and N·m·s/rad. OWN: a hand's weight
moves it a millimetre."""


class Push(NamedTuple):
    """External push on a body."""

    body: str
    force: Array
    """On its centre of mass in every control period from the reset on, (k, 3), N, world; nothing after the last."""


class DeviceState(NamedTuple):
    """State of a device besides the physics."""

    posture: Vector
    """At reset, (n,), rad."""
    tick: int
    parts: tuple[Any, ...]
    """States of its servos, its drive and its hold; None for one that it has not."""


class SimBackend:
    """A hand, or an arm, in a compiled scene; or in a world that it shares with others.

    Who shares a world shares its time: a state is of the moment up to which the one who is ahead has gone, and a period
    that another's reading has let pass counts as missed. `loop.interleave` takes turns so that none is.
    A reset begins the world anew, unless it is new and this device has not been reset in it.

    `drive` holds the wrist's set-points for every physics step, shape (k, 6); after the last one the wrist stays.
    `posture` is the joint position at reset, shape (n,), rad; by default the spec's rest. Joints that follow begin
    where they are when nothing is in their way.
    `pushing` is what pushes a body of the scene.
    Raises ConfigError for a period that is not a whole number of the model's timesteps.
    """

    live = False
    """Time passes only while this backend reads."""

    def __init__(
        self,
        spec: HandSpec,
        scene: mujoco.MjModel | World,
        *,
        period: float = 0.003,
        posture: Vector | None = None,
        drive: Array = _NO_WRIST,
        pushing: Push | None = None,
    ) -> None:
        self.world = scene if isinstance(scene, World) else World(scene)
        self.model, self.data = self.world.model, self.world.data
        model = self.model
        self.substeps = substeps(period, model.opt.timestep)
        self._spec, self._period = spec, period
        self._motors = as_slice([model.actuator(name).id for name in spec.joints])
        self._servos = None if "torque" in spec.commands else Servos(spec, [model], period)
        self._lengths = ActuatorLengths(spec, model)
        joints = list(motor_joints(spec, model).values())
        self._qpos = as_slice([model.jnt_qposadr[joint] for joint in joints])
        self._dof = as_slice([model.jnt_dofadr[joint] for joint in joints])
        self._pose = PostureMap(spec, model)
        self._root = model.body(spec.root).id
        self._posture = spec.rest if posture is None else spec.posture(posture)
        self.drive, self.pushing = drive, pushing
        self._pushed = None if pushing is None or not pushing.force.any() else model.body(pushing.body).id
        self._wrist = [model.actuator(name).id for name in WRIST_JOINTS] if len(drive) else []
        self._unknown = frozen(np.full(spec.n_actuators, math.nan))
        self._train = None if spec.drive is None else Drivetrain(spec, spec.drive, model, self._motors)
        self._holding = ArmHold(spec, period, self._qpos, self._dof) if isinstance(spec, ArmSpec) else None
        self._feels = flange_sensors(spec, model)
        self.watch: Callable[[Vector, Vector, Vector], Vector | None] | None = None
        """What a device does by itself, asked before every physics step with positions, speeds and the torques of the
        last step, (n,) each: torques instead of the commanded ones, (n,), N·m; None: it obeys."""
        self.mouse = MouseForce(model, self.data)
        self._session, self._tick = 0, 0
        self.world.join(self)

    @property
    def spec(self) -> HandSpec:
        return self._spec

    @property
    def period(self) -> float:
        return self._period

    @property
    def posture(self) -> Vector:
        """At reset, (n,), rad."""
        return self._posture

    @posture.setter
    def posture(self, posture: Vector) -> None:
        self._posture = self._spec.posture(posture)

    @property
    def true_position(self) -> Vector:
        """Where the joints are, (n,), rad, whatever lies between them and what the hand reports."""
        return frozen(self._moved()[0])

    @property
    def every_step(self) -> bool:
        """Whether it has something to do at every physics step."""
        return (
            self.world.steps < len(self.drive) or self._train is not None or self.mouse.active or self.watch is not None
        )

    def reset(self) -> HandState:
        if self.world.steps or self._session == self.world.session:
            self.world.restart()
        else:
            self.lay()
        self._session = self.world.session
        mujoco.mj_forward(self.model, self.data)
        if self._servos is not None:
            self._servos.reset(ONE, self._moved()[0][None])
        return self._state()

    def lay(self) -> None:
        """Its part of a state at reset."""
        self._pose(self._posture, self.data.qpos)
        self.data.ctrl[self._motors] = 0.0
        if self._servos is not None:
            self._servos.limp(ONE)
        if self._wrist:
            self.data.ctrl[self._wrist] = self.drive[0]
        if self._train is not None:
            self._train.reset()
        if self._holding is not None:
            self._holding.reset()
        self.mouse.reset()
        self._tick = 0

    def save(self) -> DeviceState:
        """Its state besides the physics; what pushes and drives the scene, and the mouse, are no part of it."""
        parts = (self._servos, self._train, self._holding)
        return DeviceState(self._posture, self._tick, tuple(None if part is None else part.save() for part in parts))

    def restore(self, state: DeviceState) -> None:
        """Go on from what `save` returned, after the world has been restored."""
        self._posture, self._tick, parts = state
        self._session = self.world.session
        for part, kept in zip((self._servos, self._train, self._holding), parts, strict=True):
            if part is not None:
                part.restore(kept)
        self.mouse.reset()

    def write(self, command: Command) -> None:
        self._present()
        if self._servos is not None:
            wanted = position_of(command, self._spec)
            self._servos.command(ONE, wanted.position[None], wanted.effort, wanted.duration or 0.0)
            return
        torque = torque_of(command, self._spec)
        if self._holding is not None:
            self._holding.heard()
        if self._train is None:
            self.data.ctrl[self._motors] = torque
        else:
            self._train.command(torque)

    def read(self) -> HandState:
        self._present()
        self.world.advance((self._tick + 1) * self.substeps)
        self._tick = self.world.steps // self.substeps
        return self._state()

    def begin_period(self) -> None:
        """What is done once a period, just before it."""
        if self._pushed is not None and self.pushing is not None:
            now = self.world.steps // self.substeps
            rows = self.pushing.force[now : now + 1]
            self.data.xfrc_applied[self._pushed, :3] = rows[0] if len(rows) else 0.0
        if self._servos is not None:
            self.data.ctrl[self._motors] = self._servos.commands(ONE)[0]
        if self._holding is not None:
            torque = self._holding.torque(self.data)
            if torque is not None:
                self.data.ctrl[self._motors] = torque

    def before_step(self, step: int) -> None:
        """What is done before every physics step."""
        if step < len(self.drive):
            self.data.ctrl[self._wrist] = self.drive[step]
        if self._train is not None:
            self._train.step(self.data)
        if self.mouse.active:
            self.mouse.step(step)
        if self.watch is not None:
            data = self.data
            position, velocity = data.qpos[self._qpos].copy(), data.qvel[self._dof].copy()
            own = self.watch(position, velocity, data.actuator_force[self._motors].copy())
            if own is not None:
                data.ctrl[self._motors] = own

    def drag(self, body: str, point: Vector, target: Vector) -> None:
        """Pull a body with the mouse until `let_go`, for five seconds at most: a point on it, (3,), m, in its frame,
        towards a point of the world, (3,), m. Any thread may call it."""
        steps = round(SECONDS / self.model.opt.timestep)
        self.mouse.drag = MouseDrag(self.model.body(body).id, point, target, self.world.steps + steps)

    def let_go(self) -> None:
        """End the force of the mouse, from the next physics step on. Any thread may call it."""
        self.mouse.drag = None

    def push(self, torque: Vector) -> None:
        """Torques on the joints from outside, (n,), N·m, until replaced: a person who leads the fingers."""
        self.data.qfrc_applied[self._dof] = torque

    def suffer(self, what: Ailment, joint: int, amount: float) -> None:
        """Something goes wrong with a joint, or every contact, for good. Raises ConfigError for what cannot."""
        if what == "slippery":
            self.model.geom_friction[:, 0] *= amount
            return
        if self._servos is not None and (what == "weak" or not drives_joints(self._spec, self.model)):
            raise ConfigError(f"{self._spec.name} moves by servos of its own: `{what}` is of motors at joints")
        if self._train is None:
            self._train = Drivetrain(self._spec, Drive.from_values({}, self._spec.n_joints), self.model, self._motors)
            self._train.command(self.data.ctrl[self._motors].copy())
        self._train.suffer(what, joint, amount)

    def become(self, change: JointChange, friction: float | None = None) -> None:
        """Go on as another hand, and where `friction` is given with that sliding friction of every contact; a hand that
        closes its own loop keeps its strength."""
        if friction is not None:
            self.model.geom_friction[:, 0] = friction
        set_joint_losses(self._spec, self.model, change)
        if change.strength != 1.0:
            for joint in range(self._spec.n_joints):
                self.suffer("weak", joint, change.strength)
            self.model.actuator_ctrlrange[self._motors] *= change.strength
            self.model.actuator_forcerange[self._motors] *= change.strength
        if self._train is not None and change.frictionloss is not None:
            self._train.rub(change.frictionloss)

    def close(self) -> None:
        if self._servos is not None:
            self._servos.limp(ONE)
        else:
            self.data.ctrl[self._motors] = 0.0

    def mass_of(self, body: str) -> float:
        """Mass of a body of the scene, kg."""
        return float(self.model.body_mass[self.model.body(body).id])

    def meta(self) -> dict[str, str]:
        """What a recording should say of the simulation: the engine, and a hash of the model as it was stepped."""
        if self._servos is None:
            return {"engine": ENGINE, "model": self.world.hash()}
        with self._servos.able():
            return {"engine": ENGINE, "model": self.world.hash()}

    def _present(self) -> None:
        if self._session != self.world.session:
            raise HandFault(f"the scene of {self._spec.name} was begun anew by another; reset it, too")

    def _moved(self) -> tuple[Array, Array]:
        """Position and velocity of what is driven, (n,) each."""
        data = self.data
        if self._servos is None:
            return data.qpos[self._qpos].copy(), data.qvel[self._dof].copy()
        if self._lengths.sums:
            return self._lengths.position(data.qpos), self._lengths.velocity(data.qvel)
        return self._lengths.look(self.model, data)

    def _state(self) -> HandState:
        data = self.data
        position, velocity = self._moved()
        if not math.isfinite(position.sum()):
            raise HandFault(f"the simulation diverged at {self._tick * self._period:.3f} s: {self.world.warned()}")
        torque = data.actuator_force[self._motors].copy()
        gravity = self.model.opt.gravity @ data.xmat[self._root].reshape(3, 3)
        if self._train is not None:
            position, gravity = self._train.reported(position, data), self._train.reported_gravity(gravity)
        wrench = NO_WRENCH if self._feels is None else -data.sensordata[self._feels]
        for array in (position, velocity, torque, gravity, wrench):
            array.setflags(write=False)
        t = self._tick * self._period
        return HandState(t, self._tick, position, velocity, torque, self._unknown, gravity, wrench)


def substeps(period: float, timestep: float) -> int:
    """Physics steps in a control period. Raises ConfigError unless it is a whole number of them."""
    count = round(period / timestep) if math.isfinite(period) else 0
    if count < 1 or abs(count * timestep - period) > 1e-9:
        raise ConfigError(f"period {period} s is not a whole number of physics steps of {timestep} s")
    return count


class ArmHold:
    """Counts an arm's periods without a command, and holds it from `silence` on; also before the first command."""

    def __init__(self, spec: ArmSpec, period: float, qpos: Places, dof: Places) -> None:
        self._patience = max(round(spec.silence / period), 1)
        self._limit, self._qpos, self._dof = spec.actuation.torque_limit, qpos, dof
        self._missed = self._patience
        self._at: Vector | None = None

    def reset(self) -> None:
        """Nobody has commanded it yet."""
        self._missed, self._at = self._patience, None

    def save(self) -> tuple[int, Vector | None]:
        """Copy of the state that decides how it goes on."""
        return self._missed, self._at

    def restore(self, state: tuple[int, Vector | None]) -> None:
        """Go on from what `save` returned."""
        self._missed, self._at = state

    def heard(self) -> None:
        """A command came."""
        self._missed, self._at = 0, None

    def torque(self, data: mujoco.MjData) -> Vector | None:
        """For the period that begins, (n,), N·m; None: what was commanded last."""
        self._missed += 1
        if self._missed <= self._patience:
            return None
        if self._at is None:
            self._at = data.qpos[self._qpos].copy()
        error = self._at - data.qpos[self._qpos]
        wanted: Vector = self._limit * (_STIFFNESS * error - _DAMPING * data.qvel[self._dof])
        return np.minimum(np.maximum(wanted, -self._limit), self._limit)


def flange_sensors(spec: HandSpec, model: mujoco.MjModel) -> Places | None:
    """Where an arm's sensors of force and torque are among all that the simulation senses."""
    if not isinstance(spec, ArmSpec):
        return None
    found: list[int] = []
    for kind in ("force", "torque"):
        start = int(model.sensor(f"{spec.flange}_{kind}").adr[0])
        found += range(start, start + 3)
    return slice(found[0], found[-1] + 1) if found == list(range(found[0], found[0] + 6)) else found
