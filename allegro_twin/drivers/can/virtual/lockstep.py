"""A virtual hand in the program that drives it: waiting for a frame is what lets its time pass."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

import can

from allegro_twin.drivers.can.codec.frames import Frame, JointFrames, single
from allegro_twin.drivers.can.link.adapter import BUS_OFF, bus_off
from allegro_twin.drivers.can.link.shared_bus import Link, Stamped, StampedJoints
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.errors import LinkError

_EPSILON = 1e-9  # Of a step: sums of waiting times are rounded.


class Lockstep:
    """Hands and their time. Deterministic: the same frames sent at the same moments bring the same frames back, however
    slow the host is."""

    def __init__(self, hands: VirtualHands) -> None:
        self.hands = hands
        self.idle = 0.0
        """s that the host has waited since the hands' last step."""

    @property
    def now(self) -> float:
        """Seconds that have passed for the hands, and that the host has waited since their last step."""
        return self.hands.now + self.idle

    def wait(self, timeout: float) -> Sequence[Frame | JointFrames]:
        """Let at most `timeout` seconds pass, until frames come."""
        left, hands = timeout, self.hands
        while True:
            to_step = hands.period - self.idle
            if hands.faults is not None and (due := hands.due) - self.now < min(to_step, left):
                to_late = max(due - self.now, 0.0)
                left -= to_late
                self.idle += to_late
                frames: Sequence[Frame | JointFrames] = hands.late(due)
            elif left >= to_step - _EPSILON * hands.period:
                left -= to_step
                self.idle = 0.0
                frames = hands.step()
            else:
                self.idle += max(left, 0.0)
                return []
            if frames or (hands.faults is not None and hands.faults.bus_off):
                return frames


class LockstepLink(Link):
    """The way to such hands without an adapter: frames go over as they are."""

    lockstep = True

    def __init__(self, hands: VirtualHands, name: str = "virtual", bitrate: int = 1_000_000) -> None:
        super().__init__(f"allegro-virtual {name}", bitrate)
        self._hands, self._time, self._answers = hands, Lockstep(hands), list[Frame | JointFrames]()

    @property
    def address(self) -> str:
        return "it is inside this program"

    def now(self) -> float:
        return self._hands.now + self._time.idle

    def _send(self, frames: Sequence[Frame | JointFrames]) -> bool:
        if self._listeners:
            self._log(single(frames), sent=True)
        receive = self._hands.receive
        for frame in frames:
            if answers := receive(frame):
                self._answers += answers
        return True

    def _receive(self, timeout: float) -> Sequence[Stamped | StampedJoints]:
        frames: Sequence[Frame | JointFrames] = self._answers
        if frames:
            self._answers = []
        else:
            frames = self._time.wait(timeout)
            if self._hands.faults is not None and self._hands.faults.bus_off:
                self.error_frames += 1
                raise LinkError(bus_off(self.name))
        if self._listeners:
            self._log(single(frames), sent=False)
        now, new = self._hands.now + self._time.idle, tuple.__new__
        return [new(StampedJoints if isinstance(f, JointFrames) else Stamped, (f, now)) for f in frames]  # type: ignore[misc]

    def _close(self) -> None:
        pass

    def _log(self, frames: Sequence[Frame], *, sent: bool) -> None:
        for listener in self._listeners:
            for frame in frames:
                listener(_message(frame, self._time.now, sent=sent))


class LockstepBus(can.BusABC):
    """Lockstep link as a python-can bus, for programs that speak CAN themselves."""

    lockstep = True

    def __init__(self, hands: VirtualHands, channel: Any = "virtual") -> None:
        self._time = Lockstep(hands)
        self._queue: deque[can.Message] = deque()
        self.channel_info = f"allegro-virtual {channel}"
        super().__init__(channel)

    @property
    def now(self) -> float:
        """Seconds on the hands' clock."""
        return self._time.now

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._enqueue(self._time.hands.receive(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame)))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self._queue:
            self._enqueue(self._time.wait(float("inf") if timeout is None else timeout))
            if self._time.hands.bus_off:
                return can.Message(timestamp=self.now, arbitration_id=BUS_OFF, is_error_frame=True)
        return self._queue.popleft() if self._queue else None

    def _enqueue(self, frames: Iterable[Frame | JointFrames]) -> None:
        self._queue.extend(_message(frame, self.now, sent=False) for frame in single(frames))


def _message(frame: Frame, t: float, *, sent: bool) -> can.Message:
    return can.Message(
        timestamp=t,
        arbitration_id=frame.id,
        is_extended_id=False,
        is_remote_frame=frame.remote,
        data=frame.data,
        is_rx=not sent,
    )
