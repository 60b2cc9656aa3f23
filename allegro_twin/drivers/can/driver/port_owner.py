"""Who has a device open, for messages."""

from __future__ import annotations

import os
from pathlib import Path


def holder(path: str) -> str:
    """The programs of this computer that have a file open, this one aside, as far as they may be looked at."""
    wanted, found = os.path.realpath(path), []
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        try:
            if any(os.path.realpath(one) == wanted for one in (process / "fd").iterdir()):
                words = (process / "cmdline").read_bytes().split(b"\0")
                found.append(
                    f"`{_short([word.decode(errors='replace') for word in words if word])}` (pid {process.name})"
                )
        except OSError:
            continue  # Gone meanwhile, or another user's.
    return " and ".join(found) or "another program"


def _short(words: list[str]) -> str:
    """A command line without the interpreter and the folders."""
    shown = [os.path.basename(words[0]) if words else "?", *words[1:]]
    if shown[0].startswith("python") and len(shown) > 1:
        shown = [os.path.basename(shown[1]), *shown[2:]] if shown[1] != "-m" else shown[2:]
    return " ".join(shown)[:80]
