"""The moments that were seen, to look at again: the newest minutes of them."""

from __future__ import annotations

from collections import deque

import numpy as np

from allegro_twin.surfaces.panel.stream import Frame
from allegro_twin.types import Array, Vector

SECONDS = 60.0
"""Of the hand's clock that are kept."""


class History:
    """Frames of one opening of a hand, oldest first."""

    def __init__(self) -> None:
        self._frames: deque[Frame] = deque()

    def add(self, frame: Frame) -> None:
        """A frame of another opening, or of a clock that began anew, forgets those before it."""
        if self._frames and (self._frames[-1].hand != frame.hand or frame.t <= self._frames[-1].t):
            self._frames.clear()
        self._frames.append(frame)
        while self._frames[0].t < frame.t - SECONDS:
            self._frames.popleft()

    @property
    def span(self) -> float:
        """How far back it goes, s."""
        return self._frames[-1].t - self._frames[0].t if self._frames else 0.0

    @property
    def rate(self) -> float:
        """Frames a second of the hand's clock; 0 while there are too few to say."""
        return (len(self._frames) - 1) / self.span if self.span > 0.0 else 0.0

    def at(self, ago: float) -> Frame | None:
        """The frame so many seconds before the newest, or the nearest that there is."""
        if not self._frames:
            return None
        wanted = self._frames[-1].t - ago
        return min(self._frames, key=lambda frame: abs(frame.t - wanted))

    def rows(self, seconds: float, most: int) -> tuple[Vector, Array, Array, Array]:
        """The newest `seconds`: times, (k,), s, and positions, targets and torques, (k, n); at most so many rows."""
        frames = [frame for frame in self._frames if frame.t >= self._frames[-1].t - seconds]
        frames = frames[:: max(len(frames) // most, 1)] or list(self._frames)[-1:]
        columns = [np.array([getattr(frame, name) for frame in frames]) for name in ("position", "target", "torque")]
        return np.array([frame.t for frame in frames]), columns[0], columns[1], columns[2]
