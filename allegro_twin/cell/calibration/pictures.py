"""Pictures of a calibration pattern in a folder, with the arm's pose for each: what a real camera and arm give."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from allegro_twin.cell.calibration.hand_eye import HandEyeCalibration, PatternView, calibrate_hand_eye
from allegro_twin.cell.calibration.pattern import Grey, PatternSettings, find_pattern, opencv
from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.csv_table import parse_csv
from allegro_twin.files.schema import Positive, Settings, Vector3, load_settings
from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_matrix
from allegro_twin.kinematics.pose import Pose, compose
from allegro_twin.types import Array

FILE = "calibration.yaml"
"""In the folder of the pictures."""
POSES = ("picture", "x", "y", "z", "qw", "qx", "qy", "qz")
"""Columns of a table of poses."""
_LENGTH = 1e-2  # Tolerance of a quaternion's length.


class ArmPicture(NamedTuple):
    """A picture, and where the arm was."""

    name: str
    flange: Pose
    """In the arm's base."""
    grey: Grey


class LensSettings(Settings):
    """Intrinsics of the camera that took the pictures, pixels; the middle of the first pixel is (0, 0)."""

    width: Annotated[int, Field(ge=16)]
    height: Annotated[int, Field(ge=16)]
    fx: Positive
    fy: Positive
    cx: float
    cy: float
    distortion: Annotated[tuple[float, ...], Field(max_length=14)] = ()
    """OpenCV's k1, k2, p1, p2, k3, ...; none: an ideal lens."""

    @model_validator(mode="after")
    def _counted(self) -> LensSettings:
        if len(self.distortion) not in (0, 4, 5, 8, 12, 14):
            raise ValueError(f"distortion has {len(self.distortion)} numbers; OpenCV takes 4, 5, 8, 12 or 14")
        return self

    @property
    def lens(self) -> Intrinsics:
        """Without the distortion."""
        return Intrinsics(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


class PlaceSettings(Settings):
    """A frame in another."""

    position: Vector3
    """m."""
    quaternion: tuple[float, float, float, float]
    """w, x, y, z."""

    @model_validator(mode="after")
    def _unit(self) -> PlaceSettings:
        if abs(float(np.linalg.norm(self.quaternion)) - 1.0) > _LENGTH:
            raise ValueError(f"quaternion {list(self.quaternion)} has length {np.linalg.norm(self.quaternion):.3g}")
        return self

    @property
    def pose(self) -> Pose:
        """As arrays."""
        return Pose(np.array(self.position), matrix_from_quaternion(self.quaternion))


class PictureSettings(PlaceSettings):
    """A picture and the flange's pose in the arm's base at that moment."""

    picture: str
    """File, from the folder."""


class CalibrationFolder(Settings):
    """Contents of calibration.yaml, which describes the pictures beside it."""

    pattern: PatternSettings = PatternSettings()
    intrinsics: LensSettings
    depth_camera: PlaceSettings | None = None
    """The depth camera (its left imager) in the frame of the camera that took the pictures. None: it is the same."""
    poses: str | None = None
    """A CSV with picture, x, y, z, qw, qx, qy, qz, m, instead of `views`."""
    views: tuple[PictureSettings, ...] = ()

    @model_validator(mode="after")
    def _one_list(self) -> CalibrationFolder:
        if (self.poses is None) == (not self.views):
            raise ValueError("give the arm's poses either as `views` or as a table of `poses`")
        return self


class FolderCalibration(NamedTuple):
    """Calibration from the pictures of a folder."""

    found: HandEyeCalibration
    """Calibration of the camera that took the pictures."""
    camera: Pose
    """The depth camera, in the same frame."""
    unseen: tuple[str, ...]
    """Pictures that do not show enough of the pattern."""
    warning: str = ""
    """Which number of calibration.yaml the pictures contradict, and what they fit; empty: none."""


def calibrate_folder(folder: Path, *, at_the_wrist: bool) -> FolderCalibration:
    """Calibrate by the pictures of a folder with a calibration.yaml. Raises ConfigError, one line for the first thing
    that is wrong."""
    settings = load_settings(CalibrationFolder, folder / FILE)
    pictures = _read(folder, settings.views or _table(folder, str(settings.poses)))
    found, unseen = calibrate_pictures(
        pictures, settings.pattern, settings.intrinsics.lens, np.array(settings.intrinsics.distortion),
        at_the_wrist=at_the_wrist,
    )  # fmt: skip
    beside = settings.depth_camera
    camera = found.camera if beside is None else compose(found.camera, beside.pose)
    return FolderCalibration(found, camera, unseen, _contradiction(found, settings))


def _contradiction(found: HandEyeCalibration, settings: CalibrationFolder) -> str:
    """One line, or none."""
    told, square, lens = [], 1e3 * settings.pattern.square, settings.intrinsics
    for wrong in found.contradicted:
        if wrong.stated == "principal":
            cx, cy = np.add((lens.cx, lens.cy), wrong.change)
            told.append(f"a principal point at {cx:.1f}, {cy:.1f}, and `cx`, `cy` say {lens.cx:g}, {lens.cy:g}")
        elif wrong.stated == "square":
            told.append(f"squares of {wrong.change[0] * square:.2f} mm, and `square` says {square:g}")
        else:
            told.append(f"a focal length of {wrong.change[0] * lens.fx:.1f} pixels, and `fx` says {lens.fx:g}")
    if not told:
        return ""
    return f"{FILE}: the pictures fit {', or '.join(told)}: measure it; the error below has what it moves the camera by"


def calibrate_pictures(
    pictures: Iterable[ArmPicture], pattern: PatternSettings, lens: Intrinsics, distortion: Array, *, at_the_wrist: bool
) -> tuple[HandEyeCalibration, tuple[str, ...]]:
    """Find the pattern in every picture and calibrate; also the names of those that do not show it. Raises ConfigError
    as `calibrate_hand_eye` does."""
    views, unseen = list[PatternView](), list[str]()
    for name, flange, grey in pictures:
        view = find_pattern(grey, pattern, lens, distortion, name=name, arm=flange)
        if view is None:
            unseen.append(name)
        else:
            views.append(view)
    return calibrate_hand_eye(views, lens, at_the_wrist=at_the_wrist), tuple(unseen)


def write_folder(folder: Path, pictures: Iterable[ArmPicture], pattern: PatternSettings, lens: Intrinsics) -> None:
    """Write pictures and calibration.yaml as `calibrate_folder` reads them. Raises ConfigError, RecordingError."""
    views = []
    for name, flange, grey in pictures:
        write_picture(folder / name, grey)
        position = [round(float(value), 8) for value in flange.position]
        quaternion = [round(float(value), 10) for value in quaternion_from_matrix(flange.rotation)]
        views.append({"picture": name, "position": position, "quaternion": quaternion})
    content = {"pattern": pattern.model_dump(), "intrinsics": lens._asdict(), "views": views}
    write_settings(folder / FILE, content, "Pictures of a calibration pattern: allegro-twin lab-calibrate --pictures")


def write_picture(path: Path, grey: Grey) -> None:
    """A PNG, whole or not at all. Raises RecordingError."""
    done, data = opencv().imencode(".png", grey)
    assert done
    with atomic_file(path) as temporary:
        temporary.write_bytes(data.tobytes())


def _read(folder: Path, views: Iterable[PictureSettings]) -> Iterable[ArmPicture]:
    cv2 = opencv()
    for view in views:
        path = folder / view.picture
        if not path.is_file():
            raise ConfigError(f"{folder / FILE}: no picture {path}")
        try:
            grey = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
        except cv2.error:
            grey = None  # An empty file, or one that says it is too large.
        if grey is None:
            raise ConfigError(f"{path} is no picture that OpenCV reads: PNG, JPEG, TIFF or BMP")
        yield ArmPicture(view.picture, view.pose, np.asarray(grey))


def _table(folder: Path, name: str) -> list[PictureSettings]:
    """The poses of a CSV."""
    path = folder / name
    try:
        names, rows = parse_csv(path.read_bytes(), path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read as a table: {error.strerror}") from error
    if missing := [column for column in POSES if column not in names]:
        raise ConfigError(f"{path}: no column {missing[0]!r}; it needs {', '.join(POSES)}, and has {', '.join(names)}")
    found = []
    for line, values in rows:
        row = dict(zip(names, values, strict=True))
        try:
            x, y, z, *quaternion = (float(row[key]) for key in POSES[1:])
            found.append(PictureSettings.model_validate(
                {"picture": row["picture"], "position": (x, y, z), "quaternion": quaternion}))  # fmt: skip
        except ValueError as error:
            said = str(error).splitlines()[0] if not hasattr(error, "errors") else error.errors()[0]["msg"]
            raise ConfigError(f"{path}:{line}: {said}") from error
    return found
