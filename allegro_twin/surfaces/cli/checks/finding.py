"""What a check has found."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

Status: TypeAlias = Literal["works", "absent", "broken"]
"""`absent`: not there, and only some uses need it. `broken`: it is there, or needed by all, and does not work."""


class Finding(NamedTuple):
    """One line of the doctor's."""

    what: str
    status: Status
    says: str
    mend: str = ""
    """The one line that mends it: a command, or what to do."""
