"""A Franka arm over its control interface (FCI) at 1 kHz, by pylibfranka: torques in, the state of every joint out.

The arm carries itself and the load that it is told of; a torque of ours comes on top. Every millisecond the arm sends a
state and expects a torque: the last command is held, and changes by at most 1 N·m a millisecond, which is what the
arm takes. Untried on an arm; docs/how-to/control_an_arm.md.
"""

from __future__ import annotations

from contextlib import suppress
from types import ModuleType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from allegro_twin.backend import torque_of
from allegro_twin.errors import ArmReflex, CommandError, ConfigError, HandError, HandFault, LinkError
from allegro_twin.files.schema import Settings
from allegro_twin.kinematics.arm import ArmModel
from allegro_twin.kinematics.orientation import STANDARD_GRAVITY
from allegro_twin.spec.arm import ArmSpec, Load
from allegro_twin.types import Array, Command, HandState, Vector, frozen

CYCLE = 0.001
"""s, of the interface."""
STEP = 1.0
"""N·m that a joint's torque may change in a cycle: libfranka, rate_limiting.h, kMaxTorqueRate 1000 N·m/s."""
REFLEXES = ("joint_reflex", "cartesian_reflex")
_NO_TURN = np.eye(4).ravel(order="F")
_SAME = 1e-6  # Of the entries of a frame.


class FrankaSettings(Settings):
    """Address of the arm."""

    host: str
    """Address of the control box, as in Desk."""
    realtime: Literal["enforce", "ignore"] = "enforce"
    """`ignore`: also on a kernel without PREEMPT_RT, which will miss cycles."""
    cycles: Annotated[int, Field(ge=1, le=10)] = 1
    """Milliseconds that a command is held for: the period of the controller."""


class CollisionThresholds(NamedTuple):
    """libfranka's `setCollisionBehavior`; the same while the arm accelerates and while it does not."""

    lower_torque: tuple[float, ...]
    """(7,), N·m: beyond the lower ones there is contact."""
    upper_torque: tuple[float, ...]
    """Beyond the upper ones the arm stops."""
    lower_force: tuple[float, ...]
    """(6,), N and N·m."""
    upper_force: tuple[float, ...]


class FrankaArm:
    """An arm on the FCI as a backend. For one thread, which runs in real time; `close` it."""

    live = True
    """Time passes by itself."""

    def __init__(
        self, fci: ModuleType, robot: Any, spec: ArmSpec, cycles: int = 1, collision: CollisionThresholds | None = None
    ) -> None:
        """`fci` is pylibfranka and `robot` its connection; `collision`: None leaves what the arm has."""
        self._fci, self._robot, self._spec, self._cycles, self._collision = fci, robot, spec, cycles, collision
        self._model = ArmModel(spec)
        self._control: Any = None
        self._torque = self._sent = np.zeros(spec.n_joints)
        self._error: HandError | None = HandFault(f"{spec.name} has no session yet: reset it")
        self._begin, self._missed = 0.0, 0

    @property
    def spec(self) -> ArmSpec:
        """Which arm this is."""
        return self._spec

    @property
    def period(self) -> float:
        """s."""
        return self._cycles * CYCLE

    @property
    def missed(self) -> int:
        """Cycles of the interface without a command of ours since the reset."""
        return self._missed

    def reset(self) -> HandState:
        """Begin a session: thresholds and load are set, and the arm holds itself. Raises LinkError, HandFault."""
        self._stop()
        state = self._asked(self._open)
        self._begin, self._missed = state.time.to_sec(), 0
        return self._state(state)

    def write(self, command: Command) -> None:
        """From now on these torques. Raises CommandError, and what has ended the session."""
        torque = torque_of(command, self._spec)
        if self._error is not None:
            raise self._error
        limit = self._spec.actuation.torque_limit
        if (np.abs(torque) > limit + 1e-9).any():
            joint = int(np.argmax(np.abs(torque) - limit))
            name = self._spec.joints[joint]
            raise CommandError(f"{name}: {torque[joint]:.1f} N·m is beyond {limit[joint]:g} N·m; put a guard before it")
        self._torque = torque

    def read(self) -> HandState:
        """Let a period pass. Raises ArmReflex, HandFault, LinkError, which end the session."""
        if self._error is not None:
            raise self._error
        return self._state(self._asked(self._cycle))

    def recover(self) -> HandState:
        """Take commands again after a reflex, in the same session: `automaticErrorRecovery`."""
        self._stop()
        return self._state(self._asked(self._open))

    def close(self) -> None:
        """The arm holds itself, until a reset. Idempotent."""
        self._stop()
        self._error = HandFault(f"{self._spec.name} is closed: reset it")

    def _open(self) -> Any:
        """Recover where an error stands, configure, and begin to control."""
        robot, spec = self._robot, self._spec
        state = robot.read_once()
        if state.robot_mode == self._fci.RobotMode.UserStopped:
            raise HandFault(f"{spec.name} is stopped by its button: release it, and reset")
        if state.robot_mode == self._fci.RobotMode.Reflex or bool(state.current_errors):
            robot.automatic_error_recovery()
        robot.set_EE(_NO_TURN.tolist())
        robot.set_K(_NO_TURN.tolist())
        load = spec.load or Load(0.0, frozen(np.zeros(3)))
        robot.set_load(float(load.mass), [float(x) for x in load.centre], [0.0] * 9)
        if self._collision is not None:
            robot.set_collision_behavior(*(list(each) for each in self._collision))
        self._control = robot.start_torque_control()
        state, _ = self._control.readOnce()
        if np.abs(np.array(state.F_T_EE) - _NO_TURN).max() > _SAME:
            raise ConfigError(
                f"{spec.name}: Desk has an end effector whose frame is not the flange's: choose none there"
            )
        self._torque = self._sent = np.zeros(spec.n_joints)
        self._send()
        self._error = None
        return state

    def _cycle(self) -> Any:
        """A period: a state and a torque every millisecond."""
        state: Any = None
        for _ in range(self._cycles):
            state, since = self._control.readOnce()
            self._missed += max(round(since.to_sec() / CYCLE) - 1, 0)
            self._send()
        return state

    def _send(self) -> None:
        self._sent = self._sent + np.clip(self._torque - self._sent, -STEP, STEP)
        self._control.writeOnce(self._fci.Torques(self._sent.tolist()))

    def _asked(self, ask: Any) -> Any:
        """What `ask` returns, with libfranka's errors as ours."""
        try:
            return ask()
        except HandError as error:
            self._fail(error)
        except self._fci.NetworkException as error:
            self._fail(LinkError(f"{self._spec.name} does not answer: {_line(error)}; see to the cable, and reset it"))
        except self._fci.ControlException as error:
            self._fail(self._fault(_line(error)))
        except RuntimeError as error:  # Every other exception of libfranka.
            self._fail(HandFault(f"{self._spec.name} refuses: {_line(error)}; see Desk, and reset it"))
        raise AssertionError

    def _fail(self, error: HandError) -> None:
        self._stop()
        self._error = error
        raise error

    def _fault(self, said: str) -> HandError:
        """What stopped the arm, by the errors that it reports."""
        try:
            state = self._robot.read_once()
        except RuntimeError:
            return HandFault(f"{self._spec.name} has stopped: {said}; see Desk, and reset it")
        errors = state.last_motion_errors if bool(state.last_motion_errors) else state.current_errors
        names = [name for name in dir(errors) if not name.startswith("_") and getattr(errors, name) is True]
        reflex = next((name for name in REFLEXES if name in names), None)
        if reflex is None:
            return HandFault(f"{self._spec.name} has stopped: {', '.join(names) or said}; free it, and reset it")
        wrench = tuple(float(x) for x in state.O_F_ext_hat_K)
        force = float(np.linalg.norm(wrench[:3]))
        return ArmReflex(
            f"{reflex}: {self._spec.name} met something, {force:.0f} N on its flange, and holds itself: free it, and "
            "recover() or reset() it", reflex, wrench,
        )  # fmt: skip

    def _state(self, state: Any) -> HandState:
        t, n = state.time.to_sec() - self._begin, self._spec.n_joints
        position = frozen(np.array(state.q, np.float64))
        return HandState(
            t=t, tick=round(t / self.period), position=position, velocity=frozen(np.array(state.dq, np.float64)),
            torque=frozen(np.array(state.tau_J_d, np.float64)), temperature=frozen(np.full(n, np.nan)),
            gravity=_GRAVITY, wrench=self._wrench(position, np.array(state.K_F_ext_hat_K, np.float64)),
        )  # fmt: skip

    def _wrench(self, position: Vector, outside: Vector) -> Vector:
        """As a sensor on the flange has it, (6,): the estimate has the load's weight taken away."""
        load = self._spec.load
        if load is None:
            return frozen(outside)
        axes: Array = self._model.flange(position).rotation
        force = load.mass * (axes.T @ _GRAVITY)
        return frozen(outside + np.concatenate([force, np.cross(np.asarray(load.centre), force)]))

    def _stop(self) -> None:
        if self._control is not None:
            self._control = None
            with suppress(RuntimeError):  # An arm that has stopped by itself has nothing to stop.
                self._robot.stop()


def open_franka(settings: FrankaSettings, spec: ArmSpec, collision: CollisionThresholds | None = None) -> FrankaArm:
    """Connect to an arm. Raises ConfigError without the extra, LinkError where none answers."""
    try:
        import pylibfranka
    except ImportError as error:
        raise ConfigError(
            f"an arm on the FCI needs pylibfranka: pip install 'allegro-twin[franka]' ({error})"
        ) from error
    fci: Any = pylibfranka
    config = fci.RealtimeConfig.kEnforce if settings.realtime == "enforce" else fci.RealtimeConfig.kIgnore
    try:
        robot = fci.Robot(settings.host, config)
    except fci.NetworkException as error:
        raise LinkError(
            f"no arm at {settings.host}: {_line(error)}; see to the cable, and activate the FCI in Desk"
        ) from error
    except RuntimeError as error:
        raise LinkError(f"{settings.host}: {_line(error)}") from error
    return FrankaArm(fci, robot, spec, settings.cycles, collision)


_GRAVITY = frozen([0.0, 0.0, -STANDARD_GRAVITY])


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
