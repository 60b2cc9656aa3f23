"""What went wrong on a link without ending it: counted, and told in words."""

from __future__ import annotations

import logging
from dataclasses import dataclass, fields

from allegro_twin.wire.messages import Message

log = logging.getLogger(__name__)


@dataclass(slots=True)
class Health:
    """Counts since reset."""

    states: int = 0
    """Whole states that were used."""
    missed: int = 0
    """Periods without a state."""
    incomplete: int = 0
    """Moments of which some finger's report was lost."""
    doubtful: int = 0
    """Moments thrown away because a finger contradicted itself."""
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

    def words(self) -> list[str]:
        """One line for each kind of trouble that there was."""
        return [
            f"{getattr(self, name)} {text}"
            for name, text in _WORDS.items()
            if getattr(self, name)
        ]  # fmt: skip


_WORDS = {
    "missed": "periods without a state",
    "incomplete": "moments in which a finger's report was lost",
    "doubtful": "moments thrown away because a finger contradicted itself",
    "malformed": "malformed frames",
    "unknown": "frames with unknown identifiers",
    "errors": "error frames on the bus",
    "unsent": "commands that the full transmit queue did not take",
    "throttled": "reports of hot motors that throttle themselves",
}
assert set(_WORDS) <= {field.name for field in fields(Health)}
