"""Hands on a bus whose every frame a test can spoil."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Self

import can
import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import SimulatedScene, open_backend
from allegro_twin.app.serve_can import virtual_firmware
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.config import CanSettings, FaultSettings
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.can.driver.host_settings import CanHostSettings
from allegro_twin.drivers.can.link.adapter import AdapterLink
from allegro_twin.drivers.can.link.shared_bus import BusPort
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.drivers.can.virtual.lockstep import LockstepBus
from allegro_twin.drivers.can.virtual.serve import serve
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.hands.description.calibration import Version
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import Side
from allegro_twin.types import HandState, TorqueCommand
from tests.conftest import can_config
from tests.patience import comes_true

PERIOD = 0.003
HALF_COUNT = {"v5": 0.5 * np.radians(0.088), "v5plus": 0.5 * np.radians(0.088)}
"""rad; on v1 to v4 half of 333.3° / 65536."""


def half_count(version: Version) -> float:
    return float(HALF_COUNT.get(version, 0.5 * np.radians(333.3 / 65536)))


class SpoiltBus(LockstepBus):
    """A lockstep bus with hooks in its cable."""

    def __init__(self, hands: VirtualHands) -> None:
        self.sending: Callable[[can.Message], None] = lambda message: None
        """Called before a frame goes out; raises what the driver would."""
        self.receiving: Callable[[], None] = lambda: None
        """Called before a frame is waited for."""
        self.strange: deque[can.Message] = deque()
        """Frames that arrive before anything else."""
        self.sent: list[can.Message] = []
        super().__init__(hands)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.sending(msg)
        self.sent.append(msg)
        super().send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self.receiving()
        if self.strange:
            message = self.strange.popleft()
            message.timestamp = self.now
            return message
        return super().recv(timeout)


class Bench:
    """A virtual hand, the bus to it and the backend that drives it."""

    def __init__(
        self,
        version: Version = "v4",
        plan: FaultSettings | None = None,
        settings: CanHostSettings | None = None,
        *,
        speaks: Version | None = None,
        side: Side = "right",
        is_side: Side | None = None,
        hand_codec: Codec | None = None,
        **backend: Any,
    ) -> None:
        """`speaks` and `is_side`: of the hand that is there in truth."""
        config = can_config(speaks or version, side=is_side or side, period=PERIOD, **backend)
        self.scene = SimulatedScene()
        self.firmware: Firmware = virtual_firmware(config, self.scene, step=PERIOD, restart=True)
        self.hands = VirtualHands([self.firmware], plan)
        self.bus = SpoiltBus(self.hands)
        self.opened = 0
        gravity = None if version.startswith(("v4", "v5")) else (0.0, 0.0, -9.81)
        settings = settings or CanHostSettings(gravity=gravity, imu_period=0.0 if gravity else 0.03)
        self.backend = CanBackend(load_spec(side=side), make_codec(version), self._open, settings)

    def _open(self) -> BusPort:
        self.opened += 1
        return AdapterLink(self.bus).port()

    def reset(self) -> HandState:
        return self.backend.reset()

    def step(self, torque: float = 0.02) -> HandState:
        """Command a torque that sweeps the joints to and fro, and read."""
        tick = self.firmware.state.tick
        self.backend.write(TorqueCommand(torque * np.sin(0.05 * tick + np.arange(16.0))))
        return self.backend.read()

    def limp(self) -> bool:
        """Whether the hand's motors do nothing."""
        return not self.firmware.serving or not any(self.firmware.torque)


def frame(identifier: int, data: bytes = b"", **more: Any) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, **({"is_extended_id": False} | more))


class Serving:
    """Hands served in real time on a bus by a thread, which ends with the block."""

    def __init__(self, bus: can.BusABC, *configs: RunConfig, plan: FaultSettings | None = None) -> None:
        scenes = [SimulatedScene() for _ in configs]
        self.firmwares = [
            virtual_firmware(c, s, step=PERIOD, restart=True) for c, s in zip(configs, scenes, strict=True)
        ]
        self.hands, self.bus = VirtualHands(self.firmwares, plan), bus
        self.error: Exception | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self.bus.shutdown()
        assert self.error is None

    def _serve(self) -> None:
        try:
            for _ in serve(self.hands, self.bus):
                if self._over.is_set():
                    return
        except Exception as error:  # noqa: BLE001  # It is raised where the block ends.
            self.error = error


def driven(interface: str, channel: str, version: Version = "v4", **backend: Any) -> CanBackend:
    """A CAN backend on a bus that python-can opens, with patience for a busy machine."""
    options: dict[str, Any] = {"interface": interface, "channel": channel, "timeout": 2.0, "deadman": None} | backend
    config = can_config(version, **options)
    assert isinstance(config.backend, CanSettings)
    made = open_backend(config)
    assert isinstance(made, CanBackend)
    return made


def soon_limp(there: Serving) -> bool:
    """Whether the first hand's motors go off, now that its driver is gone."""
    return comes_true(lambda: not there.firmwares[0].serving)
