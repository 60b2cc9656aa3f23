"""A client of socketcand, a bus over TCP: nothing waits to be sent, and nothing that was sent is lost at the end."""

from __future__ import annotations

import errno
import select
import socket
import time
from collections import deque
from contextlib import suppress
from typing import Any

import can

from allegro_twin.drivers.base.keeper.keeper import LinkAddress

_CONNECT, _FAREWELL = 5.0, 0.5
"""s for the server to answer; for what was said last to be heard."""
_LONGEST = 4096
"""Characters of a message that may lack its end."""


class SocketcandBus(can.BusABC):
    """A raw bus of a server. Takes python-can's arguments; `tcp_tune` is always on.

    python-can's own client leaves Nagle's algorithm on, which holds the last frames back, and closes with frames
    unread, which makes TCP throw away what was sent. Raises can.CanInitializationError or can.CanOperationError.
    """

    def __init__(self, channel: str, host: str, port: int, tcp_tune: bool = True, **ignored: Any) -> None:
        self._text, self._queue = "", deque[can.Message]()
        self.address: LinkAddress = {"kind": "socketcand", "host": str(host), "port": int(port), "channel": channel}
        try:
            self._socket = socket.create_connection((str(host), int(port)), timeout=_CONNECT)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._expect("hi")
            self._say(f"< open {channel} >")
            self._expect("ok")
            self._say("< rawmode >")
            self._expect("ok")
        except (OSError, can.CanOperationError) as error:
            if hasattr(self, "_socket"):
                self._socket.close()
            raise can.CanInitializationError(str(error), getattr(error, "errno", None)) from error
        self.channel_info = f"socketcand {host}:{port} {channel}"
        super().__init__(channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """A remote frame is sent without data: the protocol has none."""
        data = b"" if msg.is_remote_frame else bytes(msg.data)
        identifier = f"{msg.arbitration_id:08X}" if msg.is_extended_id else f"{msg.arbitration_id:03X}"
        self._say(" ".join(["< send", identifier, f"{len(data):X}", *(f"{byte:x}" for byte in data), ">"]))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._queue:
            for words in self._hear(timeout):
                if (message := _message(words)) is not None:
                    self._queue.append(message)
        return (self._queue.popleft() if self._queue else None), False

    def shutdown(self) -> None:
        """Let the server hear the last words: the end is said, and its own end waited for."""
        super().shutdown()
        deadline = time.monotonic() + _FAREWELL
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
            while (left := deadline - time.monotonic()) > 0.0:
                if select.select([self._socket], [], [], left)[0] and not self._socket.recv(1 << 16):
                    break
        self._socket.close()

    def fileno(self) -> int:
        return self._socket.fileno()

    def _say(self, text: str) -> None:
        try:
            self._socket.sendall(text.encode())
        except TimeoutError as error:
            raise can.CanOperationError("the server takes no more", errno.ENOBUFS) from error
        except OSError as error:
            raise can.CanOperationError(f"the connection is gone: {error}", error.errno) from error

    def _expect(self, word: str) -> None:
        deadline = time.monotonic() + _CONNECT
        while not (heard := self._hear(max(deadline - time.monotonic(), 0.0))):
            if time.monotonic() > deadline:
                raise can.CanOperationError(f"the server does not say `{word}`: is it socketcand?")
        if heard[0] != [word]:
            raise can.CanOperationError(f"the server says `{' '.join(heard[0])}` instead of `{word}`")

    def _hear(self, timeout: float | None) -> list[list[str]]:
        """The words of every whole message that has come."""
        try:
            if not select.select([self._socket], [], [], timeout)[0]:
                return []
            data = self._socket.recv(1 << 16)
        except OSError as error:
            raise can.CanOperationError(f"the connection is gone: {error}", error.errno) from error
        if not data:
            raise can.CanOperationError("the server closed the connection", errno.ECONNRESET)
        *messages, rest = (self._text + data.decode("ascii", "replace")).split(">")
        self._text = rest[-_LONGEST:]
        return [message.split("<")[-1].split() for message in messages]


def _message(words: list[str]) -> can.Message | None:
    """`frame ID SECONDS DATA` or `error ID SECONDS`; None for anything else."""
    try:
        match words:
            case ["frame", identifier, stamp, *data]:
                return can.Message(
                    arbitration_id=int(identifier, 16),
                    is_extended_id=len(identifier) > 3,
                    timestamp=float(stamp),
                    data=bytes.fromhex("".join(data)),
                )
            case ["error", identifier, stamp, *_]:
                # No details come with it.
                return can.Message(
                    arbitration_id=int(identifier, 16) & 0x1FFFFFFF, is_error_frame=True, timestamp=float(stamp),
                    data=b"\0",
                )  # fmt: skip
    except ValueError:
        return None
    return None
