"""The backend block of a hand on a CAN bus, real or virtual: docs/reference/can_protocol.md."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from allegro_twin.drivers.base.faults import FaultEvent, check_amount
from allegro_twin.files.schema import Gravity, Positive, Probability, Seed, Settings
from allegro_twin.hands.description.calibration import Version
from allegro_twin.hands.settings import TaskSettings
from allegro_twin.plugins import BackendSettings
from allegro_twin.sim.settings import SceneSettings
from allegro_twin.spec.drivetrain import POSSIBLE, Ailment

VIRTUAL = "allegro-virtual"
"""The interface that is a bus inside this program."""


class BusFaultEvent(FaultEvent):
    """Something that goes wrong on a virtual hand's bus at a given moment."""

    what: Literal["silence", "overheat", "joint_timeout", "bus_off", "power_cut", "recover"] | Ailment
    which: Annotated[int, Field(ge=0, le=15)] = 0
    """`silence`: the finger, 0 … 3; `overheat` and what goes wrong with the hand itself: the joint, 0 … 15."""
    amount: float | None = None
    """Amount of a fault of the hand itself; docs/reference/hand_files.md#faults."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.what in POSSIBLE:
            check_amount(self.what, self.amount, *POSSIBLE[self.what])
        return self


class FaultSettings(Settings):
    """Faults of a virtual hand's frames, by chance (per frame) and by script."""

    # Chance acts in both directions, except `delay` and `reorder`: hand to host. `corrupt` turns a bit over or cuts the
    # data short: what a CRC would have caught, so the worst case. `reorder` takes the frames of one moment.

    drop: Probability = 0.0
    duplicate: Probability = 0.0
    corrupt: Probability = 0.0
    delay: Probability = 0.0
    delay_by: Positive = 0.001
    """s."""
    reorder: Probability = 0.0
    failures: Annotated[float, Field(ge=0)] = 0.0
    """Things that go wrong with the hand itself, a minute."""
    seed: Seed = 0
    script: tuple[BusFaultEvent, ...] = ()


class FirmwareSettings(Settings):
    """Firmware of a virtual hand, where sources disagree. docs/reference/can_protocol.md"""

    servo: Literal["required", "ignored"] = "required"
    """`ignored`: torques act and reports come without "servo on", as notes on a real v4 say."""
    clip: Literal["driver", "full"] = "driver"
    """The most that a motor follows: what the manufacturer's driver sends, or its full PWM."""


class CanSettings(BackendSettings):
    """A hand on a CAN bus, real or virtual."""

    wire_keys: ClassVar[tuple[str, ...]] = ("channel", "options")

    kind: Literal["can"]
    version: Version | None = None
    """Version of the hand; default: what its own file says."""
    interface: str = "socketcan"
    """python-can's name of the adapter; `allegro-virtual` puts a simulated hand on a bus inside this program."""
    channel: str = "can0"
    bitrate: Annotated[int, Field(gt=0)] = 1_000_000
    """bit/s. Every hand's: manual v4.0, Baud-Rate."""
    device: Annotated[int, Field(ge=0, le=3)] = 0
    """v4: the hand's id on a shared bus."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Further arguments of the python-can interface."""
    identify: bool = True
    """Ask the hand who it is and refuse the wrong one; `false` for a hand that does not answer."""
    timeout: Positive = 0.05
    """s without a whole report after which the hand counts as silent."""
    deadman: Positive | None = 0.3
    """s without a call from the program after which the hand is cut off; null: never. docs/explanation/safety.md says
    why 0.3."""
    keeper: bool = True
    """Have a process of its own watch, which also leaves the hand limp when the program dies;
    docs/explanation/safety.md."""
    velocity_cutoff: Positive = 30.0
    """Hz, of the low-pass behind joint velocities."""
    gravity: Gravity | None = None
    """In the palm frame, m/s²: how the hand is mounted, where its IMU is not to be used."""
    imu: Annotated[float, Field(ge=0)] = 0.0
    """s between reports of the IMU, which then tells gravity; 0: off. No source confirms its layout."""
    realtime: bool | Literal["try"] = False
    """Ask the kernel for real-time scheduling (Linux; needs permission), so that a busy machine misses no period;
    `try`: go on with a warning where it is not allowed."""
    firmware: FirmwareSettings | None = None
    """How a virtual hand differs from what the manual says of one."""
    scene: SceneSettings | None = None
    """How a virtual hand stands where the task has no scenario; for `interface: allegro-virtual` and `allegro-twin
    firmware`."""
    faults: FaultSettings | None = None
    """What goes wrong on a virtual hand's bus."""

    @property
    def virtual(self) -> bool:
        return self.interface == VIRTUAL

    def contradictions(self, task: TaskSettings) -> Iterator[str]:
        yield from super().contradictions(task)
        if task.episode is not None and self.virtual and self.imu > 0:
            yield "backend.imu: the palm of an episode reports no gravity: leave it out"

    @property
    def place(self) -> str:
        return "virtual" if self.virtual else f"on {self.interface} {self.channel}"
