"""What a tracked hand asks of a robot's: where its fingertips should be, from the palm and from the thumb."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.spec import HandSpec, Side
from allegro_twin.surfaces.teleop.landmarks import TIPS, finger_length, in_palm
from allegro_twin.types import Array, Vector

_RECENT = 60  # Frames whose median says how long the person's finger is: two seconds of a camera.
THUMB, LONGEST = "thumb", "middle"


class Vectors(NamedTuple):
    """Which fingertip each target is of, and from where."""

    origins: tuple[str | None, ...]
    """The finger whose tip it begins at; None: the palm."""
    tips: tuple[str, ...]


def vectors(spec: HandSpec) -> Vectors:
    """From the palm to every tip, and from the thumb to the others, for a pinch is what lies between two tips. Raises
    ConfigError for a hand with other fingers than a person's, or without a thumb or a middle finger."""
    names = tuple(finger.name for finger in spec.fingers)
    strange = [name for name in names if name not in TIPS]
    missing = [name for name in (THUMB, LONGEST) if name not in names]
    if strange or missing:
        what = f"has a finger {strange[0]!r}, which no person has" if strange else f"has no {missing[0]}"
        raise ConfigError(f"{spec.name} {what}: teleop cannot lead it")
    others = tuple(name for name in names if name != THUMB)
    return Vectors((None,) * len(names) + (THUMB,) * len(others), names + others)


class Targets:
    """Turns frames of a person's hand into targets for one robot hand, its size found from the frames themselves."""

    def __init__(self, spec: HandSpec, side: Side) -> None:
        """`side`: which of the person's hands is tracked. The other side's is mirrored. Raises ConfigError."""
        self.vectors, self.side = vectors(spec), side
        self._mirror = np.array([1.0, 1.0 if side == spec.side else -1.0, 1.0])
        longest = ClosedFormFinger(spec, LONGEST)
        self._base: Vector = longest.base
        self._length = float(np.linalg.norm(longest.tip(np.zeros(4)) - self._base))
        self._lengths: deque[float] = deque(maxlen=_RECENT)

    @property
    def scale(self) -> float:
        """How many times as long the robot's middle finger is as the person's."""
        return self._length / float(np.median(self._lengths))

    def __call__(self, landmarks: Array) -> Array:
        """Landmarks (21, 3), m → targets (k, 3), m, palm frame, in the order of `vectors`."""
        self._lengths.append(finger_length(landmarks))
        points = self.scale * in_palm(landmarks, self.side) * self._mirror
        ends = [self._base + points[TIPS[tip]] for tip in self.vectors.tips]
        begins = [np.zeros(3) if name is None else self._base + points[TIPS[name]] for name in self.vectors.origins]
        found: Array = np.array(ends) - np.array(begins)
        return found
