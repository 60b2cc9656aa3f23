"""The daemon's side of socketcand: a bus over TCP, for machines without kernel CAN.

Messages stand in angle brackets: `< open can0 >`, `< rawmode >`, `< send 123 2 11 22 >`, `< frame 123 7.5 1122 >`. The
protocol has no remote frames: a request comes as a frame without data.
"""

from __future__ import annotations

import math
import selectors
import socket
import time
from collections import deque
from contextlib import suppress

import can

from allegro_twin.errors import LinkError

DEFAULT_PORT = 29536
"""socketcand's own."""
GRACE = 0.05
"""s from `rawmode` to the first frame: python-can takes an answer for wrong that comes together with a frame."""


CLIENTS = 64
"""At most; further ones are told so and sent away."""


class SocketcandServer(can.BusABC):
    """One bus and its clients, on loopback unless told otherwise; each hears the hand and the others.

    Raises LinkError.
    """

    def __init__(self, channel: str = "can0", host: str = "127.0.0.1", port: int = DEFAULT_PORT) -> None:
        self._channel, self._queue = channel, deque[can.Message]()
        self._clients: dict[socket.socket, _Client] = {}
        try:
            self._server = socket.create_server((host, port))
        except OSError as error:
            raise LinkError(f"cannot listen on {host}:{port}: {error}; is another hand there already?") from error
        self._server.setblocking(False)
        self._waiting = selectors.DefaultSelector()
        self._waiting.register(self._server, selectors.EVENT_READ)
        self.address: tuple[str, int] = self._server.getsockname()[:2]
        self.channel_info = f"socketcand {host}:{self.address[1]} {channel}"
        super().__init__(channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        line = f"< frame {msg.arbitration_id:03X} {time.time():.6f} {bytes(msg.data).hex().upper()} >".encode()
        self._spread(line, None)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._queue:
            for key, _ in self._waiting.select(timeout):
                one = key.fileobj
                if one is self._server:
                    self._accept()
                elif isinstance(one, socket.socket):
                    self._hear(one)
        return (self._queue.popleft() if self._queue else None), False

    def shutdown(self) -> None:
        super().shutdown()
        for connection in [*self._clients, self._server]:
            connection.close()
        self._waiting.close()
        self._clients.clear()

    def _accept(self) -> None:
        try:
            connection, _ = self._server.accept()
        except OSError:
            return  # Gone before it was let in.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(False)
        if len(self._clients) >= CLIENTS:
            with suppress(OSError):
                connection.send(b"< error too many clients >")
            connection.close()
            return
        self._clients[connection] = _Client()
        self._waiting.register(connection, selectors.EVENT_READ)
        self._tell(connection, b"< hi >")

    def _hear(self, connection: socket.socket) -> None:
        client = self._clients.get(connection)
        if client is None:
            return  # Dropped a moment ago, while another client was heard.
        try:
            data = connection.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        for words in client.take(data.decode("ascii", "replace")):
            answer = self._obey(words, connection, client)
            if answer:
                self._tell(connection, answer)

    def _obey(self, words: list[str], origin: socket.socket, client: _Client) -> bytes:
        match words:
            case ["open", channel]:
                return b"< ok >" if channel == self._channel else b"< error no such bus >"
            case ["rawmode"]:
                client.raw_from = time.monotonic() + GRACE
                return b"< ok >"
            case ["echo"]:
                return b"< echo >"
            case ["send", identifier, length, *data]:
                return self._send(identifier, length, data, origin)
        return b"< error unknown command >"

    def _send(self, identifier: str, length: str, data: list[str], origin: socket.socket) -> bytes:
        try:
            message = can.Message(
                arbitration_id=int(identifier, 16),
                is_extended_id=len(identifier) > 3,
                data=bytes(int(byte, 16) for byte in data),
                check=True,
            )
            declared = int(length, 16)
        except ValueError:
            return b"< error malformed frame >"
        if message.dlc != declared:
            return b"< error malformed frame >"
        self._queue.append(message)
        line = f"< frame {message.arbitration_id:03X} {time.time():.6f} {bytes(message.data).hex().upper()} >"
        self._spread(line.encode(), origin)
        return b""

    def _spread(self, line: bytes, origin: socket.socket | None) -> None:
        """To every client that listens but the one it comes from."""
        now = time.monotonic()
        for connection, client in list(self._clients.items()):
            if connection is not origin and client.raw_from <= now:
                self._tell(connection, line)

    def _tell(self, connection: socket.socket, line: bytes) -> None:
        try:
            sent = connection.send(line)
        except BlockingIOError:
            return  # A client that does not read loses frames; the hand goes on.
        except OSError:
            sent = 0
        if sent < len(line):  # It may be gone, but what it said last, zero torque, is still to be heard.
            self._clients[connection].raw_from = math.inf
            with suppress(OSError):
                connection.shutdown(socket.SHUT_WR)

    def _drop(self, connection: socket.socket) -> None:
        if self._clients.pop(connection, None) is not None:
            self._waiting.unregister(connection)
        with suppress(OSError):
            connection.close()


class _Client:
    """State of one client's session."""

    def __init__(self) -> None:
        self.raw_from, self._text = math.inf, ""

    def take(self, text: str) -> list[list[str]]:
        """The words of every complete message."""
        *messages, self._text = (self._text + text).split(">")
        self._text = self._text[-256:]
        return [message.split("<")[-1].split() for message in messages]
