"""A link over any adapter that python-can knows."""

from __future__ import annotations

import errno
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress

import can

from allegro_twin.drivers.base.keeper.keeper import LinkAddress
from allegro_twin.drivers.can.codec.frames import LOST, Frame, JointFrames, single
from allegro_twin.drivers.can.link.shared_bus import Link, Stamped
from allegro_twin.drivers.can.link.timestamps import Stamps
from allegro_twin.errors import LinkError

BUS_OFF, _CONTROLLER, _OVERFLOW = 0x40, 0x04, 0x01
"""linux/can/error.h: CAN_ERR_BUSOFF, CAN_ERR_CRTL, and in data byte 1 CAN_ERR_CRTL_RX_OVERFLOW."""
_FULL = {errno.ENOBUFS, errno.EAGAIN}
_HELD = 256
"""Sent frames that wait to be logged until something is received; a hand that answers does so after a dozen."""
_BATCH, _TURN = 64, 0.002
"""Frames, and s, after which what was read is handed over though more may wait: on a host slower than its bus there is
always more."""


class PortTaken(can.CanInitializationError):
    """Another program drives the hand at this port; its text has the way out."""


def number(error: BaseException) -> int | None:
    """The errno of an error, wherever python-can keeps it."""
    found = getattr(error, "error_code", None) or getattr(error, "errno", None)
    if found is None and isinstance(error.__cause__, OSError):
        return error.__cause__.errno
    return found


def full(error: can.CanError | OSError) -> bool:
    """Whether a frame could not be sent only because too many others wait."""
    # Where the socket's own buffer is full, python-can gives no number.
    return number(error) in _FULL or str(error) == "Transmit buffer full"


def received(bus: can.BusABC, timeout: float) -> can.Message | None:
    """The next message, waiting at most `timeout` s; what `bus.recv` does, but python-can measures its waiting with the
    time of day, and where that is set back it waits for ever."""
    kind = type(bus)
    if kind.recv is not can.BusABC.recv or kind._recv_internal is can.BusABC._recv_internal:
        return bus.recv(timeout)
    message, filtered = bus._recv_internal(timeout)
    return message if message is None or filtered or bus._matches_filters(message) else None


def bus_off(name: str) -> str:
    """What to say of a bus that is off."""
    return f"{name} is bus-off; check the wiring, then restart it: ip link set <if> up"


class AdapterLink(Link):
    """Frames go through a `can.BusABC`.

    `local`: what other programs of this computer send comes as a frame of the bus, marked as sent from here, and what
    this socket sends does not come back (SocketCAN). Elsewhere such marks are an adapter's echo of our own frames.
    """

    def __init__(
        self,
        bus: can.BusABC,
        bitrate: int = 1_000_000,
        name: str | None = None,
        closed: Callable[[], None] = lambda: None,
        *,
        local: bool = False,
        address: LinkAddress | None = None,
    ) -> None:
        super().__init__(name or str(bus.channel_info), bitrate)
        self._address = address
        self._bus, self._closed, self._local, self._stamps = bus, closed, local, Stamps()
        self.lockstep = bool(getattr(bus, "lockstep", False))
        self._untold: deque[can.Message] = deque()  # Sent, with our time, before anything told the clock of stamps.
        self._telling = threading.Lock()

    @property
    def address(self) -> LinkAddress | str:
        return self._address or super().address

    def now(self) -> float:
        return float(self._bus.now) if self.lockstep else time.monotonic()  # type: ignore[attr-defined]

    def _send(self, frames: Sequence[Frame | JointFrames]) -> bool:
        try:
            for frame in single(frames):
                message = can.Message(
                    arbitration_id=frame.id,
                    is_extended_id=False,
                    is_remote_frame=frame.remote,
                    data=frame.data,
                    is_rx=False,
                    timestamp=self.now() if self._listeners else 0.0,
                )
                self._bus.send(message)
                if self._listeners:
                    self._untold.append(message)
                    self._tell_sent(waiting=len(self._untold) < _HELD)
        except (can.CanError, OSError) as error:
            if full(error):
                return False
            raise LinkError(f"cannot send on {self.name}: {error}; is the interface up and plugged in?") from error
        return True

    def _receive(self, timeout: float) -> Sequence[Stamped]:
        came: list[Stamped] = []
        try:
            message = received(self._bus, timeout)
            enough = self.now() + _TURN
            while message is not None:
                self._take(message, came)
                if len(came) >= _BATCH or (not self.lockstep and self.now() > enough):
                    return came
                message = received(self._bus, 0.0)
        except (can.CanError, OSError, ValueError, IndexError) as error:  # Drivers parse what adapters say.
            raise LinkError(f"cannot receive on {self.name}: {error}; is the interface up and plugged in?") from error
        self._stamps.empty(self.now())
        return came

    def _take(self, message: can.Message, came: list[Stamped]) -> None:
        now = self.now()
        t = now if self.lockstep and not message.timestamp else self._on_our_clock(message.timestamp, now)
        if self._listeners:
            self._tell_sent()
            message.timestamp = message.timestamp or t - self._log_offset()
        for listener in self._listeners:
            listener(message)
        if message.is_error_frame:
            self.error_frames += 1
            if message.arbitration_id & BUS_OFF:
                raise LinkError(bus_off(self.name))
            if message.arbitration_id & _CONTROLLER and len(message.data) > 1 and message.data[1] & _OVERFLOW:
                came.append(Stamped(LOST, t))
        elif (message.is_rx or self._local) and not message.is_extended_id:
            frame = Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame)
            came.append(Stamped(frame, t))

    def _tell_sent(self, *, waiting: bool = False) -> None:
        """Tell the listeners of what was sent, on the clock of the stamps; `waiting`: not before that is known."""
        if waiting and not self.lockstep and self._stamps.offset is None:
            return
        with self._telling:
            while self._untold:
                message = self._untold.popleft()
                message.timestamp -= self._log_offset()
                for listener in self._listeners:
                    listener(message)

    def _log_offset(self) -> float:
        """What to take from our time for that of a log, s. An adapter without stamps has the time of day."""
        if self.lockstep:
            return 0.0
        known = self._stamps.offset
        return time.monotonic() - time.time() if known is None else known

    def _on_our_clock(self, stamp: float, now: float) -> float:
        return stamp if self.lockstep else self._stamps(stamp, now)

    def _close(self) -> None:
        self._tell_sent()
        self._closed()
        with suppress(can.CanError, OSError):  # It may be unplugged already.
            self._bus.shutdown()
