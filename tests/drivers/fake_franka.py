"""As much of pylibfranka as the driver asks for, with a simulated arm at its far end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import HandState, TorqueCommand


class NetworkException(RuntimeError):
    """libfranka's."""


class ControlException(RuntimeError):
    """libfranka's."""


class CommandException(RuntimeError):
    """libfranka's."""


class FakeErrors:
    """libfranka's Errors: a flag for each."""

    def __init__(self, *names: str) -> None:
        self.joint_reflex = "joint_reflex" in names
        self.cartesian_reflex = "cartesian_reflex" in names
        self.joint_velocity_violation = "joint_velocity_violation" in names

    def __bool__(self) -> bool:
        return any(vars(self).values())


class FakeTorques:
    """A command."""

    def __init__(self, values: list[float]) -> None:
        assert len(values) == 7
        self.tau_J = np.array(values)


class FakeArm:
    """A control box: the connection, and its torque control."""

    def __init__(self, sim: SimBackend) -> None:
        self.sim, self.calls, self.sent = sim, list[str](), list[np.ndarray]()
        self.mode, self.errors, self.last = "Idle", FakeErrors(), FakeErrors()
        self.wrench = np.zeros(6)
        self.desk = np.eye(4)
        self.thresholds: tuple[Any, ...] = ()
        self.fails: Exception | None = None
        self.skipped = 0
        """Cycles that pass between two states besides the one."""
        self.state: HandState = sim.reset()
        self._cycles = 0

    def read_once(self) -> Any:
        state = self.state
        return SimpleNamespace(
            q=state.position.tolist(), dq=state.velocity.tolist(), tau_J_d=state.torque.tolist(),
            K_F_ext_hat_K=self.wrench.tolist(), O_F_ext_hat_K=self.wrench.tolist(), robot_mode=self.mode,
            F_T_EE=self.desk.ravel(order="F").tolist(), current_errors=self.errors, last_motion_errors=self.last,
            time=SimpleNamespace(to_sec=lambda cycles=self._cycles: 100.0 + 1e-3 * cycles),
        )  # fmt: skip

    def readOnce(self) -> tuple[Any, Any]:  # noqa: N802  # libfranka's name.
        if self.fails is not None:
            raise self.fails
        for _ in range(1 + self.skipped):
            self.state = self.sim.read()
            self._cycles += 1
        return self.read_once(), SimpleNamespace(to_sec=lambda n=1 + self.skipped: 1e-3 * n)

    def writeOnce(self, torques: FakeTorques) -> None:  # noqa: N802  # libfranka's name.
        self.sent.append(torques.tau_J)
        self.sim.write(TorqueCommand(torques.tau_J))

    def start_torque_control(self) -> FakeArm:
        self.calls.append("start")
        return self

    def stop(self) -> None:
        self.calls.append("stop")

    def automatic_error_recovery(self) -> None:
        self.calls.append("recover")
        self.mode, self.errors, self.fails = "Idle", FakeErrors(), None

    def set_EE(self, frame: list[float]) -> None:  # noqa: N802  # libfranka's name.
        assert len(frame) == 16

    set_K = set_EE  # noqa: N815  # libfranka's name.

    def set_load(self, mass: float, centre: list[float], inertia: list[float]) -> None:
        assert (len(centre), len(inertia)) == (3, 9)
        self.calls.append(f"load {mass:g}")

    def set_collision_behavior(self, *thresholds: list[float]) -> None:
        assert [len(each) for each in thresholds] == [7, 7, 6, 6]
        self.thresholds = thresholds

    def collide(self, name: str, wrench: np.ndarray) -> None:
        """Stop by a reflex."""
        self.mode, self.last, self.errors, self.wrench = "Reflex", FakeErrors(name), FakeErrors(name), wrench
        self.fails = ControlException(f'libfranka: Move command aborted: motion aborted by reflex!\n["{name}"]')


FCI: Any = SimpleNamespace(
    NetworkException=NetworkException,
    ControlException=ControlException,
    CommandException=CommandException,
    Torques=FakeTorques,
    RobotMode=SimpleNamespace(Idle="Idle", Move="Move", Reflex="Reflex", UserStopped="UserStopped"),
    RealtimeConfig=SimpleNamespace(kEnforce="enforce", kIgnore="ignore"),
)
"""The module."""
