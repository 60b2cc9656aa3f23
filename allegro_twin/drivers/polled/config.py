"""The backend blocks of hands that answer when they are asked: docs/reference/serial_protocols.md."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from allegro_twin.drivers.base.faults import FaultEvent, LineNoise
from allegro_twin.drivers.base.host_settings import VIRTUAL_PORT
from allegro_twin.files.schema import PerJoint, Positive, Settings
from allegro_twin.plugins import BackendSettings
from allegro_twin.sim.settings import SceneSettings


class LineSettings(Settings):
    """Motors of a polled hand, in the hand's file."""

    torque_per_ampere: PerJoint
    """What a current is worth at the actuator, N·m/A."""


class PolledFaultEvent(FaultEvent):
    """Something that goes wrong with a virtual hand at a given moment."""

    what: Literal["dead_motor", "torn_tendon", "silence", "power_cut", "recover"]
    which: Annotated[int, Field(ge=0)] = 0
    """The actuator, of `dead_motor` and `torn_tendon`."""


class PolledFaultSettings(LineNoise):
    """Faults of a virtual hand and its line."""

    script: tuple[PolledFaultEvent, ...] = ()


class PolledSettings(BackendSettings):
    """Settings that all polled hands share."""

    wire_keys: ClassVar[tuple[str, ...]] = ("latency", "keeper")

    kind: str
    baud: Annotated[int, Field(gt=0)]
    """bit/s."""
    port: str = "/dev/ttyUSB0"
    """`virtual` puts a simulated hand on a line inside this program."""
    mode: str = "position"
    """How the hand is to close its loop; one of those that it takes."""
    torque_per_ampere: PerJoint | None = None
    """What a motor's current is worth at its actuator, N·m/A; default: the block `line` of the hand's file."""
    watchdog: Positive = 0.2
    """s without a word from the program after which the hand lets go by itself, in steps of 0.02 s."""
    keeper: bool = True
    """Have a process of its own switch the motors off when the program dies."""
    latency: Positive = 0.02
    """s that the adapter may hold an answer back."""
    tries: Annotated[int, Field(ge=1)] = 3
    """How often the hand is asked before it counts as silent."""
    scene: SceneSettings | None = None
    """How a virtual hand stands where the task has no scenario."""
    faults: PolledFaultSettings | None = None
    """What goes wrong with a virtual hand."""

    @property
    def virtual(self) -> bool:
        return self.port == VIRTUAL_PORT

    @property
    def place(self) -> str:
        return "virtual" if self.virtual else f"on {self.port}"
