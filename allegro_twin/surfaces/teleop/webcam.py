"""A camera of this computer, and MediaPipe that finds a hand in its pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.spec import Side
from allegro_twin.surfaces.teleop.targets import COUNT
from allegro_twin.types import Array


@dataclass(frozen=True, slots=True)
class Webcam:
    """Settings of a tracking process on a webcam."""

    model: Path
    """MediaPipe's hand landmarker, a `.task` file."""
    side: Side
    """Which of the person's hands; another one in the picture is not taken for it."""
    number: int = 0

    def open(self) -> Callable[[None], Array]:
        """What waits for the next picture and gives its landmarks (21, 3), m; NaN without a hand. Raises ConfigError
        where MediaPipe or its model is not there, LinkError without the camera."""
        landmarker, image = _landmarker(self.model)
        import cv2

        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # What it warns of is raised below.
        pictures = cv2.VideoCapture(self.number)
        if not pictures.isOpened():
            raise LinkError(f"camera {self.number} cannot be opened: is it plugged in, and not in use? --camera N")
        pictures.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # The newest picture counts, not the four before it.
        count = 0

        def look(_: None) -> Array:
            nonlocal count
            good, picture = pictures.read()
            if not good:
                raise LinkError(f"camera {self.number} gives no more pictures")
            count += 1  # The tracker wants times that ascend, in ms, and only their order matters here.
            found = landmarker.detect_for_video(image(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)), 33 * count)
            return points_of(found, self.side)

        return look


def points_of(found: Any, side: Side) -> Array:
    """The landmarks (21, 3), m, of one of the hands that MediaPipe has found; NaN where that one is not there."""
    for handedness, points in zip(found.handedness, found.hand_world_landmarks, strict=True):
        if handedness[0].category_name.lower() == side and len(points) == COUNT:
            return np.array([[point.x, point.y, point.z] for point in points])
    return np.full((COUNT, 3), np.nan)


def _landmarker(model: Path) -> tuple[Any, Callable[[Any], Any]]:
    try:
        import mediapipe as mp
    except ImportError as error:
        raise ConfigError(f"a webcam needs MediaPipe: pip install 'allegro-twin[teleop,webcam]' ({error})") from error
    vision = mp.tasks.vision
    options = vision.HandLandmarkerOptions(
        base_options=mp.tasks.BaseOptions(model_asset_path=str(model)),
        running_mode=vision.RunningMode.VIDEO,
        num_hands=2,
    )
    try:
        landmarker = vision.HandLandmarker.create_from_options(options)
    except (OSError, RuntimeError, ValueError) as error:
        first = str(error).splitlines()[0]
        raise ConfigError(f"{model}: MediaPipe does not take it for its hand landmarker: {first}") from error
    return landmarker, lambda pixels: mp.Image(image_format=mp.ImageFormat.SRGB, data=pixels)
