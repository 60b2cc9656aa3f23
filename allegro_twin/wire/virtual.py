"""A bus that exists in this program only, with virtual hands on it: waiting for a frame is what lets time pass."""

from __future__ import annotations

from collections import deque
from typing import Any

import can

from allegro_twin.wire.frames import Frame
from allegro_twin.wire.hands import VirtualHands
from allegro_twin.wire.link import BUS_OFF

_EPSILON = 1e-9  # Of a step: sums of waiting times are rounded.


class LockstepBus(can.BusABC):
    """Deterministic: the same frames sent at the same moments bring the same frames back, however slow the host is.

    `recv(timeout)` lets at most `timeout` seconds of the hands' time pass.
    """

    lockstep = True

    def __init__(self, hands: VirtualHands, channel: Any = "virtual") -> None:
        self._hands, self._idle = hands, 0.0
        self._queue: deque[can.Message] = deque()
        self.channel_info = f"allegro-virtual {channel}"
        super().__init__(channel)

    @property
    def now(self) -> float:
        """Seconds that have passed for the hands, and that the host has waited since their last step."""
        return self._hands.now + self._idle

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        answers = self._hands.receive(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame))
        if answers:
            self._enqueue(answers)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self._queue:
            return self._queue.popleft()
        left = float("inf") if timeout is None else timeout
        hands = self._hands
        while True:
            to_step, due = hands.step - self._idle, hands.due
            if due - self.now < min(to_step, left):
                to_late = max(due - self.now, 0.0)
                left -= to_late
                self._idle += to_late
                self._enqueue(hands.late(due))
            elif left >= to_step - _EPSILON * hands.step:
                left -= to_step
                self._idle = 0.0
                self._enqueue(hands.tick())
            else:
                break
            if hands.bus_off:
                return can.Message(timestamp=self.now, arbitration_id=BUS_OFF, is_error_frame=True)
            if self._queue:
                return self._queue.popleft()
        self._idle += max(left, 0.0)
        return None

    def _enqueue(self, frames: list[Frame]) -> None:
        now = self.now
        for frame in frames:
            self._queue.append(
                can.Message(
                    timestamp=now,
                    arbitration_id=frame.id,
                    is_extended_id=False,
                    is_remote_frame=frame.remote,
                    data=frame.data,
                )
            )
