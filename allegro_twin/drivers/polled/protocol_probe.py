"""Whose bytes these are: what other hands' answers begin with."""

from __future__ import annotations

_MARKS = {
    b"\xff\xff\xfd\x00": "a DYNAMIXEL servo (backend.kind dynamixel)",
    b"\x4c\xaa": "a Schunk SVH, whose protocol is not here",
    b"::": "a qb device (backend.kind qb)",
    b"\x5a\x19": "a hand of our Schunk layout (backend.kind schunk)",
}


def stranger(heard: bytes, own: bytes) -> str:
    """Who says such a thing, if it is known and not one's own mark; else nothing."""
    return next((who for mark, who in _MARKS.items() if mark != own and mark in heard), "")
