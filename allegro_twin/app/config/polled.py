"""The backend blocks of hands that answer when they are asked: docs/hands.md#wires."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from allegro_twin.app.config.backends import Probability, SceneSettings
from allegro_twin.files.schema import PerJoint, Positive, Settings


class LineSettings(Settings):
    """What the file of such a hand says of its motors."""

    torque_per_ampere: PerJoint
    """What a current is worth at the actuator, N·m/A."""


class PolledEvent(Settings):
    """Something that goes wrong with a virtual hand at a given moment."""

    at: Annotated[float, Field(ge=0)]
    """s since the hand was switched on."""
    what: Literal["dead_motor", "torn_tendon", "silence", "power_cut", "recover"]
    which: Annotated[int, Field(ge=0)] = 0
    """The actuator, of `dead_motor` and `torn_tendon`."""


class PolledFaultSettings(Settings):
    """What to do to a virtual hand's line and to the hand."""

    lose: Probability = 0.0
    """Per byte."""
    garble: Probability = 0.0
    """Per byte."""
    seed: int = 0
    script: tuple[PolledEvent, ...] = ()


class PolledSettings(Settings):
    """What all of them have."""

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


class QbSettings(PolledSettings):
    """A hand of qb electronics on RS-485, real or virtual."""

    kind: Literal["qb"]
    baud: Annotated[int, Field(gt=0)] = 2_000_000
    """bit/s, as it is set in the hand: 2000000 or 460800."""
    id: Annotated[int, Field(ge=1, le=127)] = 1
    """Of the device; 120 is reserved."""


class SchunkSettings(PolledSettings):
    """A Schunk hand whose frames are not public: this layout is ours, and no real hand speaks it."""

    kind: Literal["schunk"]
    baud: Annotated[int, Field(gt=0)] = 1_000_000
    """bit/s. A lab's report on the hand."""
