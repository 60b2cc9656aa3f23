"""A bus that exists in this program only, with virtual hands on it: waiting for a frame is what lets time pass."""

from __future__ import annotations

from collections import deque
from typing import Any

import can

from allegro_twin.wire.frames import Frame
from allegro_twin.wire.hands import VirtualHands
from allegro_twin.wire.link import BUS_OFF


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
        self._enqueue(self._hands.receive(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame)))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self._queue:
            return self._queue.popleft()
        left = float("inf") if timeout is None else timeout
        while self._idle + left >= self._hands.step * (1 - 1e-9):
            left -= self._hands.step - self._idle
            self._idle = 0.0
            self._enqueue(self._hands.tick())
            if self._hands.bus_off:
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
