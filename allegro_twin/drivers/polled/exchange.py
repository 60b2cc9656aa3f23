"""A question and its answer, asked again when one of them got lost; and what is on a line where nobody answers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from allegro_twin.drivers.base.difference_quotient import Exchanged
from allegro_twin.drivers.base.serial_line import BITS, FLOOD, SerialLine
from allegro_twin.errors import ConfigError, LinkError, LinkTimeout, ProtocolError

Answer = TypeVar("Answer")
_SHOWN = 24
"""Bytes of an answer that nobody understands."""
_MARKS = {
    b"\xff\xff\xfd\x00": "a DYNAMIXEL servo (backend.kind dynamixel)",
    b"\x4c\xaa": "a Schunk SVH, whose protocol is not here",
    b"::": "a qb device (backend.kind qb)",
    b"\x5a\x19": "a hand of our Schunk layout (backend.kind schunk)",
}
"""How other hands' answers begin."""


class Exchange:
    """`who` is asked, `tries` times before it counts as silent; `latency`: s of an answer beside its bytes."""

    def __init__(self, port: SerialLine, who: str, latency: float, tries: int) -> None:
        self.port, self.who = port, who
        self._latency, self._tries = latency, tries
        self.silent = self.garbled = 0
        """How often an answer did not come, or came garbled, and was asked for again."""
        self.heard = b""
        """What came last."""
        self.when = Exchanged(0.0, 0.0)
        """Times of the last answer."""

    def __call__(self, question: bytes, read: Callable[[bytes], Answer | None], size: int) -> Answer:
        """`read` finds the answer, of so many bytes, in what has come. Raises LinkTimeout or ProtocolError."""
        for left in reversed(range(self._tries)):
            found = self._once(question, read, size)
            if found is not None:
                return found
            if left:
                self.garbled, self.silent = self.garbled + bool(self.heard), self.silent + (not self.heard)
        if self.heard:
            shown = self.heard[:_SHOWN].hex(" ")
            raise ProtocolError(f"{self.who} on {self.port.name} answers what nobody understands: {shown}")
        raise LinkTimeout(f"{self.who} on {self.port.name} is silent; is it powered and plugged in?")

    def warnings(self) -> list[str]:
        """What went wrong without ending the session."""
        counted = {"answers did not come": self.silent, "answers were garbled": self.garbled}
        return [f"{number} {what} and were asked for again" for what, number in counted.items() if number]

    def find(
        self, knock: Callable[[], None], mark: bytes, bauds: Sequence[int], other: Callable[[], str] = str
    ) -> None:
        """See that it answers. Raises ConfigError for another hand, LinkTimeout that says at which speed it does.

        `mark`: what its answers begin with; `bauds`: the speeds that it could have; `other`: who answers in its place.
        """
        wanted, where = self.port.baud, f"{self.port.name} at {self.port.baud} baud"
        try:
            return knock()
        except (LinkTimeout, ProtocolError) as error:
            if speaks := _stranger(self.heard, mark):
                raise ConfigError(f"on {where} speaks {speaks}, not {self.who}") from error
            heard = self.heard
        if instead := other():
            raise LinkTimeout(f"no answer from {self.who} on {where}; {instead}")
        for baud in bauds:
            if baud != wanted and self._answers(knock, baud):
                raise LinkTimeout(f"no answer from {self.who} on {where}; it answers at {baud}: set backend.baud so")
        if heard:
            raise ProtocolError(f"on {where} comes what {self.who} does not say: {heard[:_SHOWN].hex(' ')}")
        raise LinkTimeout(f"no answer from {self.who} on {where}, nor at any other speed: check power and cable")

    def _answers(self, knock: Callable[[], None], baud: int) -> bool:
        try:
            self.port.rebaud(baud)
            knock()
        except (LinkError, ProtocolError):
            return False  # Not at this speed, or this adapter cannot speak so.
        return True

    def _once(self, question: bytes, read: Callable[[bytes], Answer | None], size: int) -> Answer | None:
        port, self.heard = self.port, b""
        port.clear()
        asked = port.now()
        port.send(question)
        overdue = port.now() + (len(question) + size) * BITS / port.baud + self._latency
        while len(self.heard) < FLOOD:
            more = port.receive(FLOOD - len(self.heard), overdue - port.now())
            if not more:
                break
            self.heard += more
            found = read(self.heard)
            if found is not None:
                self.when = Exchanged(asked, port.now())
                return found
        return None


def _stranger(heard: bytes, own: bytes) -> str:
    """Who says such a thing, if it is known and not one's own mark; else nothing."""
    return next((who for mark, who in _MARKS.items() if mark != own and mark in heard), "")
