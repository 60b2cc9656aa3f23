"""A python-can bus shared by the hands of this program: frames out, frames in with their time, errors as LinkErrors."""

from __future__ import annotations

import errno
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple, TypeAlias

import can

from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.wire.frames import Frame
from allegro_twin.wire.load import Load, check_load

Bus: TypeAlias = can.BusABC
"""Any bus that python-can knows."""
Message: TypeAlias = can.Message
"""A frame as python-can hands it over, with its time and its direction."""
QUEUE = 4096
"""Frames kept for a hand that nobody reads; the oldest give way."""
BUS_OFF = 0x40  # linux/can/error.h CAN_ERR_BUSOFF, which python-can leaves in the identifier of an error frame.
TURN = 0.0005
"""s after which a hand looks whether another hand's thread has received something for it."""
_FULL = {errno.ENOBUFS, errno.EAGAIN}
_FORBIDDEN = {errno.EACCES, errno.EPERM}


class Stamped(NamedTuple):
    """A frame and when it came, s on the bus's own clock."""

    frame: Frame
    t: float


def full(error: can.CanError | OSError) -> bool:
    """Whether a frame could not be sent only because too many others wait."""
    return _number(error) in _FULL


class Link:
    """One bus. Raises LinkError for whatever ends it; `ports` are the hands that listen."""

    def __init__(
        self,
        bus: can.BusABC,
        bitrate: int = 1_000_000,
        name: str | None = None,
        closed: Callable[[], None] = lambda: None,
    ) -> None:
        self._bus, self.bitrate, self._closed = bus, bitrate, closed
        self.name = name or str(bus.channel_info)
        self._ports: list[Port] = []
        self._sending, self._receiving = threading.Lock(), threading.Lock()
        self._listeners: list[Callable[[can.Message], None]] = []
        self._ahead = 0.0
        """Of the bus's clock before ours, s: what is sent must be logged on the clock of what comes."""
        self.error_frames = 0
        self.lockstep = bool(getattr(bus, "lockstep", False))
        """Whether time on this bus passes only while somebody waits for a frame."""
        if not self.lockstep:
            self._ahead = time.time() - time.monotonic()  # Most adapters stamp with the time of day.

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
                        timestamp=self.now() + self._ahead if self._listeners else 0.0,
                    )
                    self._bus.send(message)
                    for listener in self._listeners:
                        listener(message)
        except (can.CanError, OSError) as error:
            if full(error):
                return False
            raise LinkError(f"cannot send on {self.name}: {error}; is the interface up and plugged in?") from error
        return True

    def pump(self, timeout: float) -> bool:
        """Wait for a frame and hand it to all ports. False when none came."""
        if not self._receiving.acquire(timeout=min(timeout, TURN)):
            return False  # Another hand's thread receives, for this one as well.
        try:
            message = self._bus.recv(timeout)
            if message is None:
                return False
            self._deliver(message)
            while self.lockstep and (message := self._bus.recv(0.0)) is not None:
                self._deliver(message)
        except (can.CanError, OSError, ValueError, IndexError) as error:  # Drivers parse what adapters say.
            raise LinkError(f"cannot receive on {self.name}: {error}; is the interface up and plugged in?") from error
        finally:
            self._receiving.release()
        return True

    def _deliver(self, message: can.Message) -> None:
        if self._listeners:
            message.timestamp = message.timestamp or self.now()
            self._ahead = message.timestamp - self.now()
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
            with suppress(can.CanError, OSError):  # It may be unplugged already.
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
        while not self.queue:
            left = deadline - self.link.now()
            if not self.link.pump(max(left, 0.0)) and left <= 0.0:
                break
        return self.queue.popleft() if self.queue else None

    def close(self) -> None:
        self.link.leave(self)


_open: dict[tuple[str, str], Link] = {}


def shared(interface: str, channel: str, bitrate: int, options: Mapping[str, Any]) -> Link:
    """The link on a bus: hands of one program on one bus share it, for most adapters open only once."""
    key = (interface, channel)
    if key not in _open:
        bus = open_bus(interface, channel, bitrate, options)
        _open[key] = Link(bus, bitrate, f"{interface} {channel}", lambda: _open.__delitem__(key))
    return _open[key]


def open_bus(interface: str, channel: str, bitrate: int, options: Mapping[str, Any]) -> can.BusABC:
    """A python-can bus. Raises LinkError with the way out; never opens anything else in its place."""
    where = f"{interface} {channel}".strip()
    try:
        return can.Bus(
            channel=channel or None, interface=interface, bitrate=bitrate, ignore_config=True, **dict(options)
        )
    except (can.CanInterfaceNotImplementedError, ImportError) as error:
        raise LinkError(
            f"{where}: the driver is missing ({error}); install python-can[{interface}] or the adapter's own driver"
        ) from error
    except NotImplementedError as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise ConfigError(f"python-can has no interface {interface!r}; there are: {known}") from error
    except (can.CanError, OSError) as error:
        if _number(error) in _FORBIDDEN:
            raise LinkError(f"{where}: no permission ({error}); on a serial port, join the group dialout") from error
        raise LinkError(f"{where} does not open: {error}; {_way_out(interface, channel, bitrate)}") from error
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}: python-can does not take these settings: {error}") from error


def _number(error: Exception) -> int | None:
    """The errno of an error, wherever python-can keeps it."""
    found = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if found is None and isinstance(error.__cause__, OSError):
        return error.__cause__.errno
    return found


def _way_out(interface: str, channel: str, bitrate: int) -> str:
    """What to do about a bus that does not open."""
    match interface:
        case "socketcan":
            return f"plug the adapter in, then: ip link set {channel} up type can bitrate {bitrate}"
        case "slcan":
            return "is the adapter plugged in, or `allegro-twin firmware` running, and is this its port?"
        case "socketcand":
            return "is the daemon, or `allegro-twin firmware`, running there?"
    return "is the adapter plugged in, and its driver installed?"
