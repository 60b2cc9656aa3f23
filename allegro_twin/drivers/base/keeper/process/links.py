"""The keeper's own ways to a hand: frames out and in, or bytes out. All raise OSError."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import struct
import termios

from . import Orders

_ID, _REMOTE = 0x7FF, 0x40000000  # linux/can.h
Heard = list[tuple[int, bytes]]


class SocketcanSocket:
    """A raw socket of its own, which hears nothing until it has something to say."""

    def __init__(self, channel: str, wanted: list[int]) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self._hear([])
        self._socket.bind((channel,))
        self._socket.setblocking(False)
        self._wanted = wanted

    def begin(self) -> None:
        self._hear(self._wanted)

    def end(self) -> None:
        self._hear([])

    def send(self, identifier: int, data: bytes, remote: bool) -> None:
        self._socket.send(struct.pack("=IB3x8s", identifier | (_REMOTE if remote else 0), len(data), data))

    def receive(self) -> Heard:
        identifier, length, data = struct.unpack("=IB3x8s", self._socket.recv(16))
        return [] if identifier & _REMOTE else [(identifier & _ID, data[:length])]

    def fileno(self) -> int:
        return self._socket.fileno()

    def _hear(self, wanted: list[int]) -> None:
        filters = b"".join(struct.pack("=II", identifier, _ID) for identifier in wanted)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)


class Lines:
    """Messages of text with an end."""

    _shared = False
    """Whether the program may read what was meant for this."""

    def __init__(self, descriptor: int, end: bytes) -> None:
        self._descriptor, self._end, self._rest = descriptor, end, b""
        os.set_blocking(descriptor, False)

    def say(self, text: bytes) -> None:
        while text:
            text = text[os.write(self._descriptor, text) :]

    def heard(self) -> list[bytes]:
        data = os.read(self._descriptor, 1 << 16)
        if not data and not self._shared:
            raise OSError("the other end is gone")
        *whole, rest = (self._rest + data).split(self._end)
        self._rest = rest[-4096:]
        return whole

    def fileno(self) -> int:
        return self._descriptor


class SlcanPort(Lines):
    """The serial port of an slcan adapter that the program opened. Its lock is free when the program is gone; whoever
    has it then says the same at its start."""

    _shared = True

    def __init__(self, fd: int) -> None:
        super().__init__(fd, b"\r")

    def begin(self) -> None:
        with contextlib.suppress(termios.error):
            termios.tcflush(self._descriptor, termios.TCOFLUSH)  # Torques that were not sent yet.
        self.say(b"\rO\r")  # The end of what the program left half said; it may have closed the channel.

    def end(self) -> None:
        pass

    def send(self, identifier: int, data: bytes, remote: bool) -> None:
        self.say(f"{'r' if remote else 't'}{identifier:03X}{len(data)}{data.hex().upper()}\r".encode())

    def receive(self) -> Heard:
        lines = (line.lstrip(b"\a\n") for line in self.heard())
        found: Heard = []
        for line in lines:
            with contextlib.suppress(ValueError):
                if line[:1] == b"t":
                    found.append((int(line[1:4], 16), bytes.fromhex(line[5:].decode())[: int(line[4:5])]))
        return found

    def taken(self) -> bool:
        """Whether another program has the port by now."""
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(self._descriptor, fcntl.LOCK_UN)
        return False


class SocketcandClient(Lines):
    """A second client of the same server, which hears nothing until it has something to say."""

    def __init__(self, host: str, port: int, channel: str) -> None:
        self._raw = False
        self._socket = socket.create_connection((host, port), timeout=5.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for word in (b"", f"< open {channel} >".encode()):
            self._socket.sendall(word)
            answer = b""
            while not answer.endswith(b">"):
                answer += self._socket.recv(1) or b">"
            if answer not in (b"< hi >", b"< ok >"):
                self._socket.close()
                raise OSError(f"the server says {answer.decode('ascii', 'replace')}")
        super().__init__(self._socket.fileno(), b">")

    def begin(self) -> None:
        if not self._raw:
            self.say(b"< rawmode >")
        self._raw = True

    def end(self) -> None:
        pass

    def send(self, identifier: int, data: bytes, remote: bool) -> None:
        self.say(f"< send {identifier:03X} {len(data):X} {' '.join(f'{byte:x}' for byte in data)} >".encode())

    def receive(self) -> Heard:
        found: Heard = []
        for words in (line.decode("ascii", "replace").split("<")[-1].split() for line in self.heard()):
            with contextlib.suppress(ValueError):
                if words[:1] == ["frame"] and len(words) >= 3:
                    found.append((int(words[1], 16), bytes.fromhex("".join(words[3:]))))
        return found


class SerialBytes:
    """The serial line that the program opened to a hand which is told in bytes, and never heard.

    It holds the same lock as the program, and lets go of it when it ends.
    """

    def __init__(self, fd: int, shutdown_frames: str) -> None:
        self._descriptor, self._shutdown_frames = fd, bytes.fromhex(shutdown_frames)

    def say(self) -> None:
        os.write(self._descriptor, self._shutdown_frames)


Bus = SocketcanSocket | SlcanPort | SocketcandClient


def connect(orders: Orders) -> Bus | SerialBytes:
    """The way to the hand. Raises OSError."""
    address = dict(orders.address)
    match address.pop("kind"):
        case "bytes":
            return SerialBytes(**address)
        case "socketcan":
            return SocketcanSocket(**address, wanted=orders.reports + ([orders.ask[0]] if orders.ask else []))
        case "slcan":
            return SlcanPort(**address)
        case _:
            return SocketcandClient(**address)
