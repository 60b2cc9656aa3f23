"""The 21 points of a tracked hand, and what they are as seen from its palm."""

from __future__ import annotations

import numpy as np

from allegro_twin.spec import Side
from allegro_twin.types import Array

COUNT = 21
"""MediaPipe's hand landmarks: the wrist, then four each of thumb, index, middle, ring and little finger, tips last."""
WRIST, MIDDLE = 0, 9
TIPS = {"thumb": 4, "index": 8, "middle": 12, "ring": 16, "little": 20}
_KNUCKLES = {"index": 5, "ring": 13}
_MIDDLE_FINGER = (9, 10, 11, 12)
_FLAT = 1e-3  # m. Knuckles that are no further apart across the palm say nothing about which way it looks.
PALM = (0.04, 0.16)
"""m. From the wrist to the middle finger's knuckle: a toddler's, and the largest hands there are, with room."""


def seen(landmarks: Array) -> bool:
    """Whether (21, 3), m, is a hand: all there, of a hand's size, and not folded into a line."""
    if not np.isfinite(landmarks).all():
        return False
    return PALM[0] <= palm_length(landmarks) <= PALM[1] and float(np.linalg.norm(_across(landmarks))) > _FLAT


def palm_length(landmarks: Array) -> float:
    """From the wrist to the middle finger's knuckle, m."""
    return float(np.linalg.norm(landmarks[MIDDLE] - landmarks[WRIST]))


def finger_length(landmarks: Array) -> float:
    """Of the middle finger from its knuckle along its bones, m: the same however it is bent."""
    return float(np.linalg.norm(np.diff(landmarks[list(_MIDDLE_FINGER)], axis=0), axis=1).sum())


def in_palm(landmarks: Array, side: Side) -> Array:
    """The points (21, 3), m, as seen from the palm: from the middle finger's knuckle, x out of the palm, z to the
    fingers, y toward the index finger of a right hand and away from it on a left one."""
    up = landmarks[MIDDLE] - landmarks[WRIST]
    z = up / np.linalg.norm(up)
    across = _across(landmarks) * (1.0 if side == "right" else -1.0)
    y = across / np.linalg.norm(across)
    seen_from: Array = (landmarks - landmarks[MIDDLE]) @ np.column_stack([np.cross(y, z), y, z])
    return seen_from


def _across(landmarks: Array) -> Array:
    """From the ring finger's knuckle to the index finger's, (3,), m, without what is along the palm."""
    up = landmarks[MIDDLE] - landmarks[WRIST]
    width = landmarks[_KNUCKLES["index"]] - landmarks[_KNUCKLES["ring"]]
    across: Array = width - up * (width @ up) / max(float(up @ up), 1e-12)
    return across
