"""Calibration patterns, ChArUco and checkerboard: how they look, and their corners in a picture (OpenCV)."""

from __future__ import annotations

from types import ModuleType
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from allegro_twin.cell.calibration.hand_eye import PatternView
from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import Positive, Settings
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array

Grey = NDArray[np.uint8]
"""Brightness, (rows, columns)."""
FEWEST_CORNERS = 8
"""Fewest corners of a ChArUco pattern that must be visible; of a checkerboard all must be."""
_MARGIN = 0.5  # Of a square, white, around the pattern: what detectors need to find its edge.
_DICTIONARY = "DICT_4X4_50"  # Its markers have the largest cells: found from furthest.


class PatternSettings(Settings):
    """A flat pattern of squares. Its frame: origin at its outer corner, x along columns, y along rows, z into it."""

    kind: Literal["charuco", "checkerboard"] = "charuco"
    columns: Annotated[int, Field(ge=3, le=40)] = 7
    """Squares along x."""
    rows: Annotated[int, Field(ge=3, le=40)] = 5
    """Squares along y."""
    square: Positive = 0.035
    """Edge of a square, m, as measured on the print."""
    marker: Positive = 0.026
    """Edge of a ChArUco marker, m."""
    dictionary: str = _DICTIONARY
    """Dictionary of ChArUco markers, by OpenCV's name."""

    @model_validator(mode="after")
    def _whole(self) -> PatternSettings:
        if self.kind == "charuco" and not self.marker < self.square:
            raise ValueError(f"pattern: marker {self.marker:g} m must be smaller than square {self.square:g} m")
        if self.kind == "checkerboard" and (self.columns + self.rows) % 2 == 0:
            raise ValueError(
                f"pattern: a checkerboard of {self.columns} x {self.rows} squares looks the same upside down; "
                "take an even number along one edge and an odd number along the other"
            )
        return self

    @property
    def size(self) -> tuple[float, float]:
        """Size of the squares together, along x and y, m."""
        return self.columns * self.square, self.rows * self.square

    @property
    def middle(self) -> Array:
        """(3,), m."""
        return np.array([*self.size, 0.0]) / 2.0


def opencv() -> ModuleType:
    """OpenCV. Raises ConfigError without the extra."""
    try:
        import cv2
    except ImportError as error:
        raise ConfigError(f"calibration needs OpenCV: pip install 'allegro-twin[calibration]' ({error})") from error
    module: ModuleType = cv2
    return module


def draw_pattern(pattern: PatternSettings, square: int) -> Grey:
    """The pattern as it is printed, `square` pixels a square, with a white margin of half a square around."""
    row, column = np.mgrid[: pattern.rows, : pattern.columns]
    white = (row + column) % 2 == 1  # The square at the outer corner is black.
    inner = np.kron(np.where(white, 255, 0).astype(np.uint8), np.ones((square, square), np.uint8))
    if pattern.kind == "charuco":
        cv2, markers = opencv(), _dictionary(pattern)
        edge = round(square * pattern.marker / pattern.square)
        for number, (r, c) in enumerate(np.argwhere(white) * square + (square - edge) // 2):
            inner[r : r + edge, c : c + edge] = cv2.aruco.generateImageMarker(markers, number, edge)
    return np.pad(inner, round(_MARGIN * square), constant_values=255)


def printed_size(pattern: PatternSettings) -> tuple[float, float]:
    """Size of the picture that `draw_pattern` makes, margins included, along x and y, m."""
    return tuple(edge + 2 * _MARGIN * pattern.square for edge in pattern.size)  # type: ignore[return-value]  # Two.


def find_pattern(
    picture: Grey, pattern: PatternSettings, lens: Intrinsics, distortion: Array, *, name: str, arm: Pose
) -> PatternView | None:
    """The pattern in a picture, with the arm's pose of that moment; None where too little of it is seen.

    `distortion`: OpenCV's k1, k2, p1, p2, k3, ...; none: (0,). Raises ConfigError for a picture of another size.
    """
    if picture.shape != (lens.height, lens.width):
        seen = f"{picture.shape[1]} x {picture.shape[0]}"
        raise ConfigError(f"{name} has {seen} pixels; its intrinsics are of {lens.width} x {lens.height}")
    found = _charuco_corners(picture, pattern) if pattern.kind == "charuco" else _checkerboard(picture, pattern)
    if found is None:
        return None
    cv2, (points, pixels) = opencv(), found
    matrix = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    if np.any(distortion):
        pixels = cv2.undistortPoints(pixels[:, None], matrix, distortion, P=matrix)[:, 0]
    there, turn, place = cv2.solvePnP(points, pixels, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    if not there:
        return None
    turn, place = cv2.solvePnPRefineLM(points, pixels, matrix, None, turn, place)
    rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    return PatternView(name, arm, Pose(np.asarray(place, np.float64).ravel(), rotation), points, pixels)


def _charuco_corners(picture: Grey, pattern: PatternSettings) -> tuple[Array, Array] | None:
    """Corners in the pattern (k, 3), m, and in the picture (k, 2), pixels."""
    cv2, charuco = opencv(), _charuco(pattern)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(charuco).detectBoard(picture)
    if numbers is None or len(numbers) < FEWEST_CORNERS:
        return None
    points = np.asarray(charuco.getChessboardCorners(), np.float64)[np.ravel(numbers)]
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6) < 2:
        return None  # All in one row: no orientation.
    return points, np.asarray(corners, np.float64).reshape(-1, 2)


def _checkerboard(picture: Grey, pattern: PatternSettings) -> tuple[Array, Array] | None:
    """Corners of a checkerboard in the pattern, (k, 3), m, and in the picture, (k, 2), pixels; it begins at the corner
    whose outer square is black."""
    cv2, columns, rows = opencv(), pattern.columns - 1, pattern.rows - 1
    there, corners = cv2.findChessboardCornersSB(picture, (columns, rows), flags=cv2.CALIB_CB_ACCURACY)
    if not there:
        return None
    grid = np.asarray(corners, np.float64).reshape(rows, columns, 2)
    # OpenCV may begin at either end; and where the print is seen as in a mirror it is no pattern of ours.
    a, b = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if a[0] * b[1] - a[1] * b[0] < 0.0:
        grid = grid[:, ::-1]
    # The square inside the first four corners is black, as that at the outer corner.
    if _brightness(picture, grid[0, 0], grid[1, 1]) > _brightness(picture, grid[0, 1], grid[1, 2]):
        grid = grid[::-1, ::-1]
    row, column = np.mgrid[1 : rows + 1, 1 : columns + 1]
    points = np.stack([column, row, np.zeros_like(row)], axis=-1) * pattern.square
    return points.reshape(-1, 3).astype(np.float64), grid.reshape(-1, 2)


def _brightness(picture: Grey, one: Array, other: Array) -> float:
    """In the middle between two corners."""
    column, row = np.rint((one + other) / 2.0).astype(int)
    near = picture[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    return float(near.mean())


def _charuco(pattern: PatternSettings) -> Any:
    size, markers = (pattern.columns, pattern.rows), _dictionary(pattern)
    return opencv().aruco.CharucoBoard(size, pattern.square, pattern.marker, markers)


def _dictionary(pattern: PatternSettings) -> Any:
    """Raises ConfigError for a dictionary that is not OpenCV's, or has too few markers."""
    aruco, needed = opencv().aruco, pattern.columns * pattern.rows // 2
    number = getattr(aruco, pattern.dictionary, None) if pattern.dictionary.startswith("DICT_") else None
    if number is None:
        raise ConfigError(f"pattern: OpenCV has no dictionary {pattern.dictionary!r}; the usual one is {_DICTIONARY}")
    markers = aruco.getPredefinedDictionary(number)
    if len(markers.bytesList) < needed:
        raise ConfigError(
            f"pattern: {pattern.dictionary} has {len(markers.bytesList)} markers; {pattern.columns} x {pattern.rows} "
            f"squares need {needed}"
        )
    return markers
