"""The backend block of a hand made of DYNAMIXEL servos: docs/reference/dynamixel.md."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from allegro_twin.drivers.base.faults import FaultEvent, LineNoise, check_amount
from allegro_twin.drivers.base.host_settings import VIRTUAL_PORT
from allegro_twin.files.schema import PerJoint, Positive, Settings
from allegro_twin.plugins import BackendSettings
from allegro_twin.sim.settings import SceneSettings

Gains = tuple[int, int, int]


class ServoSettings(Settings):
    """Mounting of the servos on the actuators: one value for all, or one for each actuator."""

    model: str = "XM430-W350"
    ids: list[Annotated[int, Field(ge=0, le=252)]]
    """On the bus, in the order of the actuators."""
    current_limit: PerJoint
    """The most that each may draw, A. No default: too much of it breaks hands."""
    zero: PerJoint = 2048.0
    """Tick at which the actuator's position is 0."""
    direction: Literal[1, -1] | list[Literal[1, -1]] = 1
    """-1 where a higher tick is a lower position."""
    gear: PerJoint = 1.0
    """What the actuator moves by in a radian of the shaft, rad."""
    torque_per_ampere: PerJoint | None = None
    """At the shaft, N·m/A; default: stall torque over stall current of the data sheet."""
    gains: Gains | list[Gains] | None = None
    """Position P, I and D as they stand in the servo; default: those that its mode brings. A virtual hand does not heed
    them: it is as stiff as its simulation."""


class ServoFaultEvent(FaultEvent):
    """Something that goes wrong with a virtual hand's servos at a given moment."""

    what: Literal[
        "dead_motor", "torn_tendon", "watchdog", "other_id", "overheat", "overload", "silence", "power_cut", "recover"
    ]  # fmt: skip
    amount: float | None = None
    """`overheat`: °C; `other_id`: the id."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.what == "overheat":
            check_amount(self.what, self.amount, 0.0, 255.0)
        if self.what == "other_id":
            check_amount(self.what, self.amount, 0.0, 252.0)
            if self.amount is not None and self.amount % 1.0:
                raise ValueError(f"amount: an id is a whole number, not {self.amount:g}")
        return self


class ServoFaultSettings(LineNoise):
    """Faults of a virtual hand's line and its servos."""

    script: tuple[ServoFaultEvent, ...] = ()


class DynamixelSettings(BackendSettings):
    """A hand of DYNAMIXEL servos on a serial port, real or virtual, through the vendor's SDK."""

    wire_keys: ClassVar[tuple[str, ...]] = ("latency", "keeper")

    kind: Literal["dynamixel"]
    port: str = "/dev/ttyUSB0"
    """`virtual` puts a simulated hand on a line inside this program."""
    baud: Annotated[int, Field(gt=0)] = 1_000_000
    """bit/s, as it is set in the servos; they come with 57600."""
    servos: ServoSettings | None = None
    """Default: the block `servos` of the hand's own file, or of its model's, in conf/hands."""
    watchdog: Positive = 0.2
    """s without a word from the program after which the hand lets go by itself."""
    keeper: bool = True
    """Have a process of its own switch the motors off when the program dies."""
    latency: Positive = 0.02
    """s that the adapter may hold an answer back."""
    tries: Annotated[int, Field(ge=1)] = 3
    """How often a state is asked for before the hand counts as silent."""
    return_delay: Annotated[int, Field(ge=0, le=254)] = 0
    """What the servos' Return Delay Time is set to, 2 µs each."""
    scene: SceneSettings | None = None
    """How a virtual hand stands where the task has no scenario."""
    faults: ServoFaultSettings | None = None
    """What goes wrong with a virtual hand."""

    @property
    def virtual(self) -> bool:
        return self.port == VIRTUAL_PORT

    @property
    def place(self) -> str:
        return "virtual" if self.virtual else f"on {self.port}"
