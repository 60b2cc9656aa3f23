"""A simulator-first digital twin of the Wonik Allegro Hand."""

from allegro_twin.backend import HandBackend
from allegro_twin.errors import (
    CommandError,
    ConfigError,
    EndOfRecording,
    HandError,
    HandFault,
    LinkError,
    LinkTimeout,
    ProtocolError,
    RecordingError,
)
from allegro_twin.loop import paced, run, until
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, Sample, TorqueCommand

__version__ = "0.1.0"

__all__ = [
    "Command",
    "CommandError",
    "ConfigError",
    "EndOfRecording",
    "HandBackend",
    "HandError",
    "HandFault",
    "HandSpec",
    "HandState",
    "LinkError",
    "LinkTimeout",
    "PositionCommand",
    "ProtocolError",
    "RecordingError",
    "Sample",
    "TorqueCommand",
    "paced",
    "run",
    "until",
]
