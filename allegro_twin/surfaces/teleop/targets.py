"""Targets of a robot's fingertips, from the 21 landmarks of a tracked hand."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.spec import HandSpec, Side
from allegro_twin.spec.hand import check_side
from allegro_twin.types import Array, Vector

COUNT = 21
"""MediaPipe's hand landmarks: the wrist, then four each of thumb, index, middle, ring and little finger, tips last."""
WRIST, MIDDLE = 0, 9
TIPS = {"thumb": 4, "index": 8, "middle": 12, "ring": 16, "little": 20}
_KNUCKLES = {"index": 5, "ring": 13}
_MIDDLE_FINGER = (9, 10, 11, 12)
_FLAT = 1e-3  # m. Knuckles that are no further apart across the palm say nothing about which way it looks.
PALM = (0.04, 0.16)
"""m. From the wrist to the middle finger's knuckle: a toddler's, and the largest hands there are, with room."""


def landmark_array(landmarks: ArrayLike) -> Array:
    """The landmarks of a frame, (21, 3). Raises ConfigError for another shape, and what is no numbers."""
    try:
        points = np.asarray(landmarks, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"landmarks are {COUNT} points of three numbers, m: {error}") from error
    if points.shape != (COUNT, 3):
        raise ConfigError(f"landmarks have shape ({COUNT}, 3), m, and are NaN where no hand is seen; not "
                          f"{'None' if landmarks is None else points.shape}")  # fmt: skip
    return points


def not_a_hand(landmarks: Array) -> str:
    """Why (21, 3), m, is no hand: not all there, not of a hand's size, or folded into a line; empty: it is one."""
    if not np.isfinite(landmarks).all():
        return "no whole hand in the frames"
    folded = float(np.linalg.norm(_across(landmarks))) <= _FLAT
    return wrong_size(palm_length(landmarks)) or ("its knuckles are in one line with the wrist" if folded else "")


def wrong_size(palm: float) -> str:
    """Why a palm of this length, m, is no hand's; empty: it is one's."""
    if PALM[0] <= palm <= PALM[1]:
        return ""
    return (
        f"{palm:.3g} m from the wrist to the middle knuckle is no hand's: landmarks are in m (MediaPipe's world "
        "landmarks)"
    )


def palm_length(landmarks: Array) -> float:
    """From the wrist to the middle finger's knuckle, m."""
    return float(np.linalg.norm(landmarks[MIDDLE] - landmarks[WRIST]))


def finger_length(landmarks: Array) -> float:
    """Length of the middle finger from its knuckle along its bones, m: the same however it is bent."""
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


_RECENT = 60  # Frames whose median says how long the person's finger is: two seconds of a camera.
THUMB, LONGEST = "thumb", "middle"


class TargetVectors(NamedTuple):
    """Targets as vectors: the fingertip of each, and its origin."""

    origins: tuple[str | None, ...]
    """The finger whose tip it begins at; None: the palm."""
    tips: tuple[str, ...]


def target_vectors(spec: HandSpec) -> TargetVectors:
    """From the palm to every tip, and from the thumb to the others, for a pinch is what lies between two tips. Raises
    ConfigError for a hand with other fingers than a person's, or without a thumb or a middle finger."""
    names = tuple(finger.name for finger in spec.fingers)
    strange = [name for name in names if name not in TIPS]
    missing = [name for name in (THUMB, LONGEST) if name not in names]
    if strange or missing:
        what = f"has a finger {strange[0]!r}, which no person has" if strange else f"has no {missing[0]}"
        raise ConfigError(f"{spec.name} {what}: teleop cannot lead it")
    others = tuple(name for name in names if name != THUMB)
    return TargetVectors((None,) * len(names) + (THUMB,) * len(others), names + others)


class FingertipTargets:
    """Turns frames of a person's hand into targets for one robot hand, its size found from the frames themselves."""

    def __init__(self, spec: HandSpec, side: Side) -> None:
        """`side`: which of the person's hands is tracked. The other side's is mirrored. Raises ConfigError."""
        check_side(side)
        self.vectors, self.side = target_vectors(spec), side
        self._mirror = np.array([1.0, 1.0 if side == spec.side else -1.0, 1.0])
        try:
            longest = ClosedFormFinger(spec, LONGEST)
        except ConfigError as error:
            raise ConfigError(
                f"teleop leads the Allegro Hand and hands of its geometry, not {spec.name} ({error})"
            ) from error
        self._base: Vector = longest.base
        self._length = float(np.linalg.norm(longest.tip(np.zeros(4)) - self._base))
        self._lengths: deque[float] = deque(maxlen=_RECENT)

    @property
    def scale(self) -> float:
        """How many times as long the robot's middle finger is as the person's."""
        return self._length / float(np.median(self._lengths))

    def __call__(self, landmarks: Array) -> Array:
        """Landmarks (21, 3), m → targets (k, 3), m, palm frame, in the order of `target_vectors`."""
        self._lengths.append(finger_length(landmarks))
        points = self.scale * in_palm(landmarks, self.side) * self._mirror
        ends = [self._base + points[TIPS[tip]] for tip in self.vectors.tips]
        begins = [np.zeros(3) if name is None else self._base + points[TIPS[name]] for name in self.vectors.origins]
        found: Array = np.array(ends) - np.array(begins)
        return found
