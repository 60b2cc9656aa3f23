"""A virtual hand in real time on any bus: for a driver in another program, ours or somebody else's."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable, Iterable, Iterator

import can

from allegro_twin.drivers.base.pacing import Served
from allegro_twin.drivers.can.codec.frames import Frame, JointFrames, single
from allegro_twin.drivers.can.link.adapter import full, number, received
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands

_DOWN = {errno.ENETDOWN, errno.ENETUNREACH}
_FLOOD = 1000
"""Frames in one step after which time goes on: far more than a bus can carry."""


def serve(
    hands: VirtualHands, bus: can.BusABC, clock: Callable[[], float] = time.monotonic, *, local: bool = False
) -> Iterator[Served]:
    """Be these hands on this bus; yields after every step, until nobody consumes.

    While the bus is down the hands go on, as a real one does.
    `local`: frames of this computer's other programs count (SocketCAN; see AdapterLink). Raises can.CanError or OSError
    when the bus is gone for good.
    """
    served = Served(hands.period, clock, "frames")
    while True:
        _listen(hands, bus, served.due, served, clock, local=local)
        served.count()
        _say(bus, [*hands.late(hands.now + hands.period), *hands.step()], served)
        yield served


def _listen(
    hands: VirtualHands, bus: can.BusABC, due: float, served: Served, clock: Callable[[], float], *, local: bool
) -> None:
    """Take what comes until the step is over; on a late one, what is there, or a busy machine never hears the host."""
    for _ in range(_FLOOD):
        left = due - clock()
        message = _received(bus, max(left, 0.0))
        if message is None:
            if due - clock() <= 0.0:
                return
            continue
        if message.is_error_frame or message.is_extended_id or not (message.is_rx or local):
            continue
        served.heard += 1
        _say(bus, hands.receive(Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame)), served)


def _received(bus: can.BusABC, timeout: float) -> can.Message | None:
    try:
        return received(bus, timeout)
    except (can.CanError, OSError) as error:
        if number(error) not in _DOWN:
            raise
        threading.Event().wait(timeout)
        return None


def _say(bus: can.BusABC, frames: Iterable[Frame | JointFrames], served: Served) -> None:
    for frame in single(frames):
        message = can.Message(
            arbitration_id=frame.id, is_extended_id=False, is_remote_frame=frame.remote, data=frame.data
        )
        try:
            bus.send(message)
        except (can.CanError, OSError) as error:
            if not full(error) and number(error) not in _DOWN:
                raise
            served.unsaid += 1  # Nobody takes them: a hand goes on without its listener.
        else:
            served.sent += 1
