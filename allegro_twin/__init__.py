"""A simulator-first digital twin of the Wonik Allegro Hand.

What is named here is loaded when it is first asked for, so `import allegro_twin` takes no time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports
from allegro_twin.version import __version__

if TYPE_CHECKING:
    from allegro_twin.app.config import load_config
    from allegro_twin.backend import HandBackend
    from allegro_twin.errors import (
        ArmReflex,
        CommandError,
        ConfigError,
        EndOfRecording,
        HandError,
        HandFault,
        LinkError,
        LinkTimeout,
        MotionInterrupted,
        MotionStalled,
        ProtocolError,
        RecordingError,
        SelfCollision,
        TooFast,
        WrongPose,
    )
    from allegro_twin.hands.library.library import Library
    from allegro_twin.loop import interleave, paced, run, until
    from allegro_twin.spec import HandSpec
    from allegro_twin.surfaces.hand import Hand
    from allegro_twin.types import Command, HandState, PositionCommand, Sample, TorqueCommand

__all__ = [
    "ArmReflex",
    "Command",
    "CommandError",
    "ConfigError",
    "EndOfRecording",
    "Hand",
    "HandBackend",
    "HandError",
    "HandFault",
    "HandSpec",
    "HandState",
    "Library",
    "LinkError",
    "LinkTimeout",
    "MotionInterrupted",
    "MotionStalled",
    "PositionCommand",
    "ProtocolError",
    "RecordingError",
    "Sample",
    "SelfCollision",
    "TooFast",
    "TorqueCommand",
    "WrongPose",
    "__version__",
    "interleave",
    "load_config",
    "paced",
    "run",
    "until",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "app.config": ("load_config",),
        "backend": ("HandBackend",),
        "errors": (
            "ArmReflex",
            "CommandError",
            "ConfigError",
            "EndOfRecording",
            "HandError",
            "HandFault",
            "LinkError",
            "LinkTimeout",
            "MotionInterrupted",
            "MotionStalled",
            "ProtocolError",
            "RecordingError",
            "SelfCollision",
            "TooFast",
            "WrongPose",
        ),
        "hands.library.library": ("Library",),
        "loop": ("interleave", "paced", "run", "until"),
        "spec": ("HandSpec",),
        "surfaces.hand": ("Hand",),
        "types": ("Command", "HandState", "PositionCommand", "Sample", "TorqueCommand"),
    },
)
