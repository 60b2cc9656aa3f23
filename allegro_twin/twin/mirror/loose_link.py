"""Whether a link is loose: it falls through its backlash, with its own inertia alone.

A joint's inertia is its motor's, some hundred times its last link's. A link that is loose leaves its motor's tooth
when its weight turns over, or as it comes loose, falls for some periods and lands on the other: what is reported runs
away from what was expected over two periods and more, and swings back. An encoder that jumps does so in one period; a
push on a finger moves its other joints, too.
"""

from __future__ import annotations

import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

AWAY = 0.002  # rad from what was expected, which no motor does in a period or three: 0.7 rad/s out of nothing.
FIRST = 0.03  # Of the largest, what a fall is away a period before: a jump is none.
BACK = 0.25  # Of the largest, how far it swings back when it lands.
ALONE = 0.3  # Of the largest, what other joints of the finger are away at most.
NONE = frozen([0.0])  # Of noise.


class LooseLinkDetector:
    """Keeps three rows of what was reported minus what was expected."""

    def __init__(self, spec: HandSpec) -> None:
        self._fingers = [list(finger.joints) for finger in spec.fingers]
        self._rows: list[Array] = []
        self._noise: list[Vector] = []

    def add(self, off: Array, noise: Vector = NONE) -> tuple[int, float] | None:
        """A row's periods, (k, n), rad, and what noise never makes of them, (n,), rad: the joint whose link fell in the
        row before, and how far it was away, rad."""
        self._noise = [*self._noise[-2:], np.broadcast_to(noise, off.shape[1:])]
        self._rows = [*self._rows[-2:], off]
        if len(self._rows) < 3:
            return None
        seen, k, least = np.concatenate(self._rows), len(off), np.maximum(np.max(self._noise, axis=0), AWAY)
        for own in self._fingers:
            part = seen[:, own]
            out = np.abs(part) > least[own]
            begun = np.argmax(out.any(axis=1))
            if not out.any() or not k <= begun < 2 * k:
                continue
            which = int(np.abs(part[begun : begun + k // 2]).max(axis=0).argmax())
            far = fall_amount(part[:, which], int(begun))
            others = np.abs(np.delete(part, which, axis=1)[begun : begun + k])
            if far and others.max(initial=0.0) < ALONE * far:
                return own[which], far
        return None


def fall_amount(off: Array, begun: int) -> float:
    """How far a joint that was away first in period `begun` was away before it swung back, (k,), rad; 0: no fall."""
    way = off * np.sign(off[begun])
    lobe = way[begun:][: int(np.argmin(way[begun:] > 0.0)) or None]
    top = begun + int(lobe.argmax())
    falls = way[top - 1] > FIRST * way[top] and way[top:].min() < -BACK * way[top]
    return float(way[top]) if falls else 0.0
