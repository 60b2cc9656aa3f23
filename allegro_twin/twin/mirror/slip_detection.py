"""Slip detection of a held object.

Fingers that rest and press on something are pushed back by d₀. When the object gives way, the push decreases and the
fingers follow it, by the motors' own torque and against d₀:

    let go  1 − d·d₀ / |d₀|²,    inward  −(q − q₀)·d₀ / |d₀|

A hand that is commanded to move does the same, but its motors' torques show it: a position loop pushes less on a finger
that went inward, and more on one that was pushed outward. Where the motors' part, −τ·d₀ / |d₀|², rises on a finger that
went in or did not move, or falls on one that went out, there was a command. An object that is pulled drags a finger to
the side as well, and some of its motors may give all they have: then the motors' part falls on a finger that went out.
But no loop drives what is dragged: of a command, the motors' work (τ − τ₀)·(q − q₀) is positive.

While the palm turns, weight moves from one finger to another; then, and with one finger alone, only a finger that lets
go altogether counts. An object that is pulled out slowly moves the fingers for longer than they are watched at rest. So
the last rest in which they held something is kept until there is a command: all of them that let go altogether, inward
of where they held it, hold nothing any more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

# All ours, set on grasps by hands 400 to 404 of benchmarks/mirrored_hands.py; LET_GO by 930 to 934.
RESTED, SINCE = 0.24, 0.12
"""s: how long a hand must have rested, and how long ago that may have ended."""
STILL = 0.008
"""rad that a joint moves at most in a hand at rest."""
PRESSED, GRIP = 0.1, 0.3
"""Shares of a motor's limit. A finger that is pushed back by less than the first does not hold; a hand without a finger
pushed back by more than the second does not hold either. Friction beyond the file holds up to 0.08 N·m in a finger at
rest."""
BACK = 0.5
"""Least share of a finger's push that its motors make: all of it but the finger's weight."""
LET_GO, INWARD = 0.3, 0.004
"""Lost share of the push of one of several fingers; rad."""
ALTOGETHER, ALONE = 0.7, 0.02
"""Lost share of the push while the palm turns, and for one finger alone; rad, for one finger alone."""
SHARED = 0.03
"""Least change of another finger's push, as a share of what one finger lost: what two hold is in balance, and a push on
one finger alone is not what they hold. With objects that slip 0.08 and more, with a push that ends 0.004."""
TURNS = 0.05
"""rad that the palm turns in the meantime."""
TOLD, MOVED, HELD = 0.15, 0.003, 0.0005
"""Share of the push by which motors rise or fall; rad, in and out; rad of a finger that did not move."""
STARTS = 0.15
"""The share for a finger that did not move."""
AFTER = 0.7
"""s after a command in which nothing counts as a slip."""


class Slip(NamedTuple):
    """A slip, as the finger that let go most shows it."""

    joint: int
    """That finger's joint that was pushed most."""
    amount: float
    """Lost share of its push."""


class _Row(NamedTuple):
    d: Vector
    torque: Vector
    position: Vector
    down: Vector


class _Grip(NamedTuple):
    """Grip of a hand at rest."""

    held: NDArray[np.bool_]
    """Fingers, (fingers,)."""
    d: Vector
    torque: Vector
    position: Vector

    def compare(self, now: _Row, of: Array) -> tuple[Vector, Vector, Vector, Vector]:
        """By finger, (fingers,): lost share of the push, way inward, rad, rise of the motors' part, and the motors'
        work, N·m rad. `of`: which joints a finger has, (fingers, n)."""
        square = np.where(self.held, of @ np.square(self.d), np.inf)
        went, more = now.position - self.position, now.torque - self.torque
        gone, inward = 1.0 - of @ (now.d * self.d) / square, -(of @ (went * self.d)) / np.sqrt(square)
        return gone, inward, -(of @ (more * self.d)) / square, of @ (more * went)


class SlipDetector:
    """Detects slips in the rows of a mirror. `row`: s; `above`: contact thresholds of joints at rest, (n,), N·m."""

    def __init__(self, spec: HandSpec, row: float, above: Vector) -> None:
        self._of = np.zeros((len(spec.fingers), spec.n_joints))
        for number, finger in enumerate(spec.fingers):
            self._of[number, list(finger.joints)] = 1.0
        self._above, self._before, self._since = above, max(round(RESTED / row), 2), max(round(SINCE / row), 1)
        self._rows: deque[_Row] = deque(maxlen=self._before + self._since)
        self._calm, self._wait = 0, round(AFTER / row)
        limit = self._of @ spec.actuation.torque_limit / self._of.sum(axis=1)
        self._pressed, self._grip = np.square(PRESSED * limit), np.square(GRIP * limit)
        self._starts = np.zeros(len(spec.fingers), dtype=bool)
        self._last: _Grip | None = None
        self.holds = np.zeros(len(spec.fingers), dtype=bool)
        """Fingers that rest now and press on something, (fingers,)."""

    def add(self, d: Vector, torque: Vector, position: Vector, down: Vector, *, jumped: bool = False) -> Slip | None:
        """Add a row: disturbances and the motors' torques, N·m, positions, rad, (n,) each; gravity in the palm frame,
        (3,). `jumped`: an encoder may have jumped. Returns the slip that this row ends with, or None."""
        now, self._calm = _Row(d, torque, position, down), self._calm - 1
        found = self._find_slip(now) if len(self._rows) == self._rows.maxlen else None
        self._calm = self._wait if jumped else self._calm
        self._rows.append(now)
        self.holds = self._holding(list(self._rows)[-self._since :])
        return found if self._calm <= 0 else None

    def _holding(self, rows: Sequence[_Row]) -> NDArray[np.bool_]:
        d, torque, position, _ = (np.array(each) for each in zip(*rows, strict=True))
        still = np.ptp(position, axis=0) < STILL
        return np.asarray(self._pressing(d.mean(axis=0), torque.mean(axis=0)) & (self._of @ ~still == 0.0))

    def _pressing(self, d: Vector, torque: Vector) -> NDArray[np.bool_]:
        """Fingers that motors press on something."""
        square, of = self._of @ np.square(d), self._of
        held = (square > self._pressed) & (of @ np.square(d / self._above) > 1.0) & (of @ (torque * d) < -BACK * square)
        return np.asarray(held & (held & (square > self._grip)).any())

    def _find_slip(self, now: _Row) -> Slip | None:
        d, torque, position, down = (np.array(each) for each in list(zip(*self._rows, strict=True)))
        first = slice(self._before)
        travel = np.ptp(position[first], axis=0)
        if travel.max() > STILL:
            return self._find_loss(now)
        d0, torque0 = d[first].mean(axis=0), torque[first].mean(axis=0)
        held = self._pressing(d0, torque0)
        if not held.any():
            self._last = None
            return None
        grip, of = _Grip(held, d0, torque0, position[first].mean(axis=0)), self._of
        gone, inward, rise, work = grip.compare(now, of)
        self._last = grip
        if (held & self._commanded(inward, rise, work)).any():
            self._calm, self._last = self._wait, None
        several = np.count_nonzero(held) > 1
        turned = np.linalg.norm(now.down - down[0]) > TURNS * np.linalg.norm(down[0])
        whole = not several or turned
        far = np.maximum(INWARD if several else ALONE, 2.0 * (of * travel).max(axis=1))
        slipped = held & (gone > (ALTOGETHER if whole else LET_GO)) & (inward > far)
        if several and np.count_nonzero(slipped) == 1:
            change = np.abs(np.where(held & ~slipped, gone, 0.0)).max()
            slipped &= change > SHARED * gone
        return self._slip(grip, slipped, gone)

    def _find_loss(self, now: _Row) -> Slip | None:
        """The loss of what several fingers held in their last rest, however they were moved since."""
        grip = self._last
        if grip is None or np.count_nonzero(grip.held) < 2:
            return None
        gone, inward, rise, work = grip.compare(now, self._of)
        if (grip.held & self._commanded(inward, rise, work)).any():
            self._calm, self._last = self._wait, None
            return None
        lost = grip.held & (gone > ALTOGETHER) & (inward > INWARD)
        return self._slip(grip, lost, gone) if (lost == grip.held).all() else None

    def _slip(self, grip: _Grip, slipped: NDArray[np.bool_], gone: Vector) -> Slip | None:
        if not slipped.any():
            return None
        finger = int(np.where(slipped, gone, -np.inf).argmax())
        return Slip(int(np.abs(self._of[finger] * grip.d).argmax()), float(min(gone[finger], 1.0)))

    def _commanded(self, inward: Vector, rise: Vector, work: Vector) -> NDArray[np.bool_]:
        """Whether each finger's motors changed by themselves."""
        driven, before = work > 0.0, self._starts
        out, into = driven & (inward < -MOVED), driven & (inward > MOVED)
        self._starts = (np.abs(inward) < HELD) & (
            rise > STARTS
        )  # In a single row it may be damping of the first motion.
        return np.asarray((out & (rise < -TOLD)) | (into & (rise > TOLD)) | (self._starts & before))
