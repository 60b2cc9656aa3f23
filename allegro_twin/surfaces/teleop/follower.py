"""Leads a hand after a tracked one: what is seen, how far it is believed, and what happens when nothing is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.control.trajectory import number
from allegro_twin.errors import ConfigError, SelfCollision
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.external_setpoints import ExternalSetpoints
from allegro_twin.surfaces.teleop.targets import TIPS, FingertipTargets, in_palm, landmark_array, not_a_hand
from allegro_twin.types import Array, Vector

_FASTEST, _NOISE = 2.0, 0.02
"""m/s and m: fingertips on a palm that move further between two frames are a tracker's mistake, not a person's."""
_PARTS = (1.0, 0.5, 0.25)
"""Shares of the path to its goal on which a finger is tried when it would meet another."""
_ROUNDING = 1e-6  # rad. The solver's posture may be so far beyond a limit that it keeps.
WHAT = "teleop"
Retarget = Callable[[Array], Vector]
StatusCallback = Callable[[str], None]


@dataclass(slots=True)
class FrameCounts:
    """Frames."""

    followed: int = 0
    unseen: int = 0
    jumps: int = 0
    clipped: int = 0
    """Followed, with a joint that was led beyond its limit, where it stopped."""
    late: int = 0
    """Left out, for a newer one was there already."""


class HandFollower:
    """One hand, led by frames. It holds as soon as `patience`, s, have passed without one that it believes."""

    def __init__(
        self,
        hand: Hand,
        targets: FingertipTargets,
        retarget: Retarget,
        on_status: StatusCallback,
        *,
        speed: float = 2.0,
        patience: float = 0.3,
    ) -> None:
        """`speed`: rad/s, of joints at most; `on_status` is called when a hand is lost and seen again, and when the
        frames are of no hand's size. Raises ConfigError."""
        if not 0.0 < (patience := number(patience, "patience, in s,")) < math.inf:
            raise ConfigError(f"patience must be positive and finite, s; it is {patience:g}")
        self._hand, self._targets, self._retarget, self._on_status = hand, targets, retarget, on_status
        self._outside, self._patience = ExternalSetpoints(hand, speed), patience
        self._outside.nominal()
        self._before: tuple[float, Array] | None = None
        self._believed, self._why = hand.state.t, "none was there yet"
        self._holding, self._goal = True, self._inside(hand.state.position)
        self._seen, self._looked = -math.inf, -math.inf
        self._whole, self._told = False, False  # A frame of no hand's size, and whether that was said.
        self.tally = FrameCounts()

    def see(self, t: float, landmarks: ArrayLike) -> None:
        """A frame at a time of the hand's clock, `hand.state.t`, s: landmarks (21, 3), m, NaN where none was seen.
        Raises ConfigError for landmarks of another shape, and for a time that is not finite, goes back, or is ahead of
        that clock by more than `patience`: with another clock the hand would go on when frames stop."""
        landmarks = landmark_array(landmarks)
        t = self._seen = self._checked(t, self._seen)
        if self._believable(t, landmarks):
            if self._holding:
                self._on_status(f"{t:.1f} s: a hand is seen, and followed")
            self._believed, self._holding, self._told = t, False, False
            self.tally.followed += 1
            self._lead(self._retarget(self._targets(landmarks)))
        self._hold_if_due(t)

    def look(self, t: float) -> None:
        """Whether a frame is due, at a time of the hand's clock, s. Raises ConfigError for a time as `see` does."""
        self._looked = self._checked(t, self._looked)
        self._hold_if_due(self._looked)

    def _checked(self, t: float, before: float) -> float:
        t, now = number(t, "a frame's time, in s,"), self._hand.state.t
        wrong = (
            "is not finite" if not math.isfinite(t)
            else f"goes back, from {before:.3f} s" if t < before
            else "is ahead of it" if t > now + self._patience
            else ""
        )  # fmt: skip
        if wrong:
            raise ConfigError(
                f"a frame's time is on the hand's clock (hand.state.t, now {now:.3f} s): {t:.3f} s {wrong}"
            )
        return t

    def _hold_if_due(self, t: float) -> None:
        if self._holding or t - self._believed <= self._patience:
            return
        self._holding, self._before, self._told = True, None, self._whole
        self._on_status(f"{t:.1f} s: no hand is followed since {self._believed:.1f} s ({self._why}); the hand holds")
        self._goal = self._inside(self._outside.rest())

    def _believable(self, t: float, landmarks: Array) -> bool:
        self._why, self._whole = "no frame came", False
        if why := not_a_hand(landmarks):
            self._before, self._why = None, why
            self.tally.unseen += 1
            self._whole = bool(np.isfinite(landmarks).all())
            if self._holding and self._whole and not self._told:
                self._told = True
                self._on_status(f"{t:.1f} s: {why}")
            return False
        tips = in_palm(landmarks, self._targets.side)[list(TIPS.values())]
        before, self._before = self._before, (t, tips)
        if before is None:
            return True
        far = float(np.linalg.norm(tips - before[1], axis=1).max())
        if far > _NOISE + _FASTEST * (t - before[0]):
            self._why = f"its tips jumped by {far * 1000:.0f} mm between two frames"
            self.tally.jumps += 1
            return False
        return True

    def _lead(self, posture: Vector) -> None:
        """Toward a posture, (n,), rad; fingers that would meet go as far as each can."""
        goal = self._inside(posture)
        self.tally.clipped += bool(np.abs(goal - posture).max() > _ROUNDING)
        if self._led(goal):
            return
        for finger in self._hand.spec.fingers:
            joints = list(finger.joints)
            for part in _PARTS:
                nearer = self._inside(self._goal)
                nearer[joints] += part * (goal[joints] - nearer[joints])
                if self._led(nearer):
                    break

    def _led(self, goal: Vector) -> bool:
        try:
            self._outside.track(goal, WHAT)
        except SelfCollision:
            return False
        self._goal = goal
        return True

    def _inside(self, posture: Vector) -> Vector:
        inside: Vector = np.clip(posture, *self._hand.limits)
        return inside
