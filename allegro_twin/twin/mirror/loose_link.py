"""Loose link detection: a link that falls through its backlash, with its own inertia alone.

A joint's inertia is its motor's, some hundred times its last link's. A loose link leaves its motor's tooth when its
weight turns over, or as it comes loose. It falls for some periods and lands on the other tooth. The reported position
runs away from the expected one over two periods and more, and swings back. An encoder that jumps does so in one period.
A push on a finger moves its other joints, too. An impact may move one joint alone, but that joint brakes and swings
back less: a motor has inertia to go on with, a link that landed on its tooth has none.
"""

from __future__ import annotations

import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

AWAY = 0.002  # rad from the expected position within three periods, 0.7 rad/s at once: no motor does that.
FIRST = 0.03  # Share of the largest deviation in the period before: a jump has none.
BACK = 0.7  # Share of the largest deviation by which the link swings back when it lands.
LANDS = 0.7  # The same within one period.
# Ours, both: falls of hands 300 to 304 swing back by 0.93 and more, 0.86 and more within a period; joints on which 80 g
# fall by up to 0.55 and 0.5 (hand of other code).
ALONE = 0.3  # Largest share that other joints of the finger deviate by.
NONE = frozen([0.0])  # No noise.


class LooseLinkDetector:
    """Keeps three rows of reported minus expected positions."""

    def __init__(self, spec: HandSpec) -> None:
        self._fingers = [list(finger.joints) for finger in spec.fingers]
        self._rows: list[Array] = []
        self._noise: list[Vector] = []

    def add(self, off: Array, noise: Vector = NONE) -> tuple[int, float] | None:
        """Add a row's periods, (k, n), rad, and the limit of noise, (n,), rad. Returns the joint whose link fell in the
        row before, and its deviation, rad."""
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
    """Largest deviation of a joint that began to deviate in period `begun`, (k,), rad; 0: no fall."""
    way = off * np.sign(off[begun])
    lobe = way[begun:][: int(np.argmin(way[begun:] > 0.0)) or None]
    top = begun + int(lobe.argmax())
    back, at_once = -way[top:].min(), -np.diff(way[top:]).min(initial=0.0)
    falls = way[top - 1] > FIRST * way[top] and back > BACK * way[top] and at_once > LANDS * way[top]
    return float(way[top]) if falls else 0.0
