"""The finding of a check."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

Status: TypeAlias = Literal["works", "absent", "broken"]
"""`absent`: not installed, and needed by some uses only. `broken`: installed or always needed, and does not work."""


class Diagnosis(NamedTuple):
    """One line of `doctor`."""

    what: str
    status: Status
    says: str
    mend: str = ""
    """The fix in one line: a command, or an instruction."""
