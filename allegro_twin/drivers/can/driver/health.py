"""Link health: counts of faults that do not end a session, and their text."""

from __future__ import annotations

import logging
from dataclasses import dataclass, fields

from allegro_twin.drivers.can.codec.messages import Message

log = logging.getLogger(__name__)


@dataclass(slots=True)
class Health:
    """Counts since reset."""

    states: int = 0
    """Whole states that were used."""
    missed: int = 0
    """Periods without a state."""
    incomplete: int = 0
    """Times that a finger's report was lost, late or double."""
    doubtful: int = 0
    """Periods not used because their reports may be of two."""
    behind: int = 0
    """States that were used though newer frames waited to be read."""
    overflows: int = 0
    """Times that the receiver lost frames."""
    malformed: int = 0
    """Frames of this hand that could not be read."""
    unknown: int = 0
    """Frames of nobody we know."""
    errors: int = 0
    """Error frames."""
    unsent: int = 0
    """Commands that the transmit queue did not take."""
    throttled: int = 0
    """Reports of motors that throttle themselves because they are hot."""

    def note(self, name: str, why: Message | Exception | str) -> None:
        """Count something; the first of its kind is logged."""
        count = getattr(self, name)
        setattr(self, name, count + 1)
        if count == 0:
            log.warning("%s: %s", name, why)

    def lines(self) -> list[str]:
        """One line for each kind of trouble that there was."""
        return [
            f"{getattr(self, name)} {text}"
            for name, text in _WORDS.items()
            if getattr(self, name)
        ]  # fmt: skip


_WORDS = {
    "missed": "periods without a state",
    "incomplete": "times that a finger's report was lost, late or double",
    "doubtful": "periods not used because their reports may be of two",
    "behind": "states read late: this computer is slower than the bus",
    "overflows": "times that the receiver lost frames",
    "malformed": "malformed frames",
    "unknown": "frames with unknown identifiers",
    "errors": "error frames on the bus",
    "unsent": "commands that the full transmit queue did not take",
    "throttled": "reports of hot motors that throttle themselves",
}
assert set(_WORDS) <= {field.name for field in fields(Health)}
