"""The backend block of a hand of qb electronics: docs/reference/serial_protocols.md."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from allegro_twin.drivers.polled.config import PolledSettings


class QbSettings(PolledSettings):
    """A hand of qb electronics on RS-485, real or virtual."""

    kind: Literal["qb"]
    baud: Annotated[int, Field(gt=0)] = 2_000_000
    """bit/s, as it is set in the hand: 2000000 or 460800."""
    id: Annotated[int, Field(ge=1, le=127)] = 1
    """Identifier of the device; 120 is reserved."""
