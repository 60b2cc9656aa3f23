"""The backend block of a Schunk hand on our layout of its frames: docs/reference/serial_protocols.md."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from allegro_twin.drivers.polled.config import PolledSettings


class SchunkSettings(PolledSettings):
    """A Schunk hand whose frames are not public: this layout is ours, and no real hand speaks it."""

    kind: Literal["schunk"]
    baud: Annotated[int, Field(gt=0)] = 1_000_000
    """bit/s. A lab's report on the hand."""
