"""A python-can bus shared by the hands of this program: frames out, frames in with their time, errors as LinkErrors."""

from __future__ import annotations

import errno
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, TypeAlias

import can

from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.wire.frames import Frame
from allegro_twin.wire.load import Load, check_load

Bus: TypeAlias = can.BusABC
"""Any bus that python-can knows."""
QUEUE = 4096
"""Frames kept for a hand that nobody reads; the oldest give way."""
BUS_OFF = 0x40  # linux/can/error.h CAN_ERR_BUSOFF, which python-can leaves in the identifier of an error frame.
_FULL = {errno.ENOBUFS, errno.EAGAIN}


class Stamped(NamedTuple):
    """A frame and when it came, s on the bus's own clock."""

    frame: Frame
    t: float


class Link:
    """One bus. Raises LinkError for whatever ends it; `ports` are the hands that listen."""

    def __init__(self, bus: can.BusABC, bitrate: int = 1_000_000, closed: Callable[[], None] = lambda: None) -> None:
        self._bus, self.bitrate, self._closed = bus, bitrate, closed
        self._ports: list[Port] = []
        self._sending, self._receiving = threading.Lock(), threading.Lock()
        self._listeners: list[Callable[[can.Message], None]] = []
        self.error_frames = 0
        self.lockstep = bool(getattr(bus, "lockstep", False))
        """Whether time on this bus passes only while somebody waits for a frame."""

    @property
    def name(self) -> str:
        return str(self._bus.channel_info)

    def now(self) -> float:
        """Seconds on a clock that never goes back."""
        return float(self._bus.now) if self.lockstep else time.monotonic()  # type: ignore[attr-defined]

    def port(self, load: Load | None = None) -> Port:
        """A listener of its own: every port receives every frame. Raises ConfigError when the bus cannot carry its
        `load` beside the others'."""
        port = Port(self, load)
        check_load([*(other.load for other in self._ports), load], self.bitrate, self.name)
        self._ports.append(port)
        return port

    def listen(self, listener: Callable[[can.Message], None]) -> None:
        """Tell of every frame, sent or received: for bus logs."""
        self._listeners.append(listener)

    def send(self, frames: Iterable[Frame]) -> bool:
        """Put frames on the bus. False when the transmit queue was full and some were lost."""
        try:
            with self._sending:
                for frame in frames:
                    message = can.Message(
                        arbitration_id=frame.id,
                        is_extended_id=False,
                        is_remote_frame=frame.remote,
                        data=frame.data,
                        is_rx=False,
                        timestamp=self.now() if self._listeners else 0.0,
                    )
                    self._bus.send(message)
                    for listener in self._listeners:
                        listener(message)
        except (can.CanError, OSError) as error:
            if getattr(error, "error_code", getattr(error, "errno", None)) in _FULL:
                return False
            raise LinkError(f"cannot send on {self.name}: {error}; is the interface up and plugged in?") from error
        return True

    def pump(self, timeout: float) -> bool:
        """Wait for a frame and hand it to all ports. False when none came."""
        if not self._receiving.acquire(timeout=timeout if timeout > 0.0 else -1):
            return False
        try:
            message = self._bus.recv(timeout)
            if message is None:
                return False
            self._deliver(message)
            while self.lockstep and (message := self._bus.recv(0.0)) is not None:
                self._deliver(message)
        except (can.CanError, OSError, ValueError) as error:
            raise LinkError(f"cannot receive on {self.name}: {error}; is the interface up and plugged in?") from error
        finally:
            self._receiving.release()
        return True

    def _deliver(self, message: can.Message) -> None:
        for listener in self._listeners:
            listener(message)
        if message.is_error_frame:
            self.error_frames += 1
            if message.arbitration_id & BUS_OFF:
                raise LinkError(f"{self.name} is bus-off; check the wiring, then restart it: ip link set <if> up")
        elif message.is_rx and not message.is_extended_id:
            frame = Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame)
            stamped = Stamped(frame, message.timestamp or self.now())
            for port in self._ports:
                port.queue.append(stamped)

    def leave(self, port: Port) -> None:
        """The last one out closes the bus."""
        if port not in self._ports:
            return
        self._ports.remove(port)
        if not self._ports:
            self._closed()
            self._bus.shutdown()


class Port:
    """One hand's end of a link."""

    def __init__(self, link: Link, load: Load | None) -> None:
        self.link, self.load = link, load
        self.queue: deque[Stamped] = deque(maxlen=QUEUE)

    def send(self, frames: Iterable[Frame]) -> bool:
        return self.link.send(frames)

    def receive(self, timeout: float) -> Stamped | None:
        """The next frame; None after `timeout` seconds without one."""
        deadline = self.link.now() + timeout
        while not self.queue and self.link.pump(max(deadline - self.link.now(), 0.0)):
            pass  # What came may have been another program's, or an error frame.
        return self.queue.popleft() if self.queue else None

    def close(self) -> None:
        self.link.leave(self)


_open: dict[tuple[str, str], Link] = {}


def shared(interface: str, channel: str, bitrate: int, options: Mapping[str, Any]) -> Link:
    """The link on a bus: hands of one program on one bus share it, for most adapters open only once."""
    key = (interface, channel)
    if key not in _open:
        bus = open_bus(interface, channel, bitrate, options)
        _open[key] = Link(bus, bitrate, lambda: _open.__delitem__(key))
    return _open[key]


def open_bus(interface: str, channel: str, bitrate: int, options: Mapping[str, Any]) -> can.BusABC:
    """A python-can bus. Raises LinkError with the way out; never opens anything else in its place."""
    where = f"{interface} {channel}".strip()
    try:
        return can.Bus(
            channel=channel or None, interface=interface, bitrate=bitrate, ignore_config=True, **dict(options)
        )
    except can.CanInterfaceNotImplementedError as error:
        raise LinkError(f"{where}: the driver is missing ({error}); install python-can[{interface}]") from error
    except NotImplementedError as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise ConfigError(f"python-can has no interface {interface!r}; there are: {known}") from error
    except PermissionError as error:
        raise LinkError(f"{where}: no permission ({error}); on a serial port, join the group dialout") from error
    except (can.CanError, OSError) as error:
        raise LinkError(f"{where} does not open: {error}; is it plugged in and up? `allegro-twin check`") from error
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}: python-can does not take these settings: {error}") from error
