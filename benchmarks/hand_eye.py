"""How exact hand-eye calibration is, and whether it knows it: `python -m benchmarks.hand_eye [--seeds 24]`.

For each seed the simulated arm takes 15 pictures of the pattern with the cell's own camera, at the wrist and standing
still. The arm's reported poses are then exact, or wrong by normal errors about and along all axes; or the focal length
is wrong. Where OpenCV has `calibrateHandEye` (4.x) its methods are compared on the same pictures.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from allegro_twin.cell.calibration import CalibrationCell, PatternSettings, PatternView, calibrate_hand_eye
from allegro_twin.cell.calibration.pattern import find_pattern
from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.cell.settings import LabSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.orientation import angle_between
from allegro_twin.kinematics.pose import Pose, relative_to

CONFIGS = {"at the wrist": "lab_allegro_wrist", "standing still": "lab_allegro"}
ARM = {"exact": (0.0, 0.0), "0.1 mm, 0.02°": (1e-4, 0.02), "0.3 mm, 0.05°": (3e-4, 0.05)}
"""Standard deviations of the arm's pose along and about each axis, m and degrees."""
LENSES = (1.002, 1.005)
"""Times the true focal length."""
COUNTS = (15, 8)
METHODS = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=24)
    seeds = parser.parse_args().seeds
    print(f"OpenCV {cv2.__version__}, {seeds} seeds")
    print(
        "camera | arm | pictures | error mm median, largest | error ° median, largest | stated mm, ° median | covered"
    )
    for place, config in CONFIGS.items():
        rows: dict[str, list[tuple[float, ...]]] = {}
        for seed in range(seeds):
            for name, row in _seed(config, seed):
                rows.setdefault(name, []).append(row)
        for name, found in rows.items():
            _print(place, name, np.array(found))


def _seed(config: str, seed: int) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Rows of errors (mm, °) and stated errors (mm, °)."""
    settings = load_settings(LabSettings, data_root() / f"conf/{config}.yaml")
    cell = CalibrationCell(settings, PatternSettings(), seed)
    try:
        pictures = [cell.teleport(at, f"{k}.png") for k, at in enumerate(cell.postures(max(COUNTS)))]
        lens, truth, wrist = cell.lens, cell.truth, cell.at_the_wrist
        views = _views(pictures, lens)
        for name, (shift, turn) in ARM.items():
            draws = np.random.default_rng((seed, 7))
            moved = [view._replace(arm=_off(view.arm, shift, np.radians(turn), draws)) for view in views]
            for count in COUNTS:
                yield f"{name} | {count}", _row(moved[:count], lens, truth, wrist)
            if hasattr(cv2, "calibrateHandEye"):
                for method in METHODS:
                    yield f"{name} | {method}", (*_apart(_opencv(moved, method, wrist), truth), np.nan, np.nan)
        for factor in LENSES:
            wrong = lens._replace(fx=lens.fx * factor, fy=lens.fy * factor)
            yield f"focal length {100 * factor - 100:+.1f} % | 15", _row(_views(pictures, wrong), wrong, truth, wrist)
    finally:
        cell.close()


def _views(pictures: list[Any], lens: Intrinsics) -> list[PatternView]:
    found = (find_pattern(p.grey, PatternSettings(), lens, np.zeros(0), name=p.name, arm=p.flange) for p in pictures)
    return [view for view in found if view is not None]


def _off(pose: Pose, shift: float, turn: float, draws: np.random.Generator) -> Pose:
    moved, turned = shift * draws.standard_normal(3), turn * draws.standard_normal(3)
    return Pose(pose.position + moved, rotate(pose.rotation, turned))


def _row(views: list[PatternView], lens: Intrinsics, truth: Pose, wrist: bool) -> tuple[float, ...]:
    try:
        found = calibrate_hand_eye(views, lens, at_the_wrist=wrist)
    except ConfigError as error:
        print(f"refused: {error}")
        return (np.nan,) * 4
    return (*_apart(found.camera, truth), 1e3 * found.position_error, float(np.degrees(found.rotation_error)))


def _apart(camera: Pose, truth: Pose) -> tuple[float, float]:
    far = float(np.linalg.norm(camera.position - truth.position))
    return 1e3 * far, float(np.degrees(angle_between(camera.rotation, truth.rotation)))


def _opencv(views: list[PatternView], method: str, wrist: bool) -> Pose:
    """The camera by one of OpenCV's methods, from the poses of the pattern in each picture."""
    unit = Pose(np.zeros(3), np.eye(3))
    arms = [view.arm if wrist else relative_to(view.arm, unit) for view in views]
    solve: Any = vars(cv2)["calibrateHandEye"]
    rotation, position = solve(
        [arm.rotation for arm in arms], [arm.position for arm in arms],
        [view.pattern.rotation for view in views], [view.pattern.position for view in views],
        method=getattr(cv2, f"CALIB_HAND_EYE_{method}"),
    )  # fmt: skip
    return Pose(np.asarray(position).ravel(), np.asarray(rotation))


def _print(place: str, name: str, rows: np.ndarray) -> None:
    far, turned, stated, bound = rows.T
    covered = "" if np.isnan(stated).all() else f"{(far <= stated).sum()}, {(turned <= bound).sum()} of {len(rows)}"
    said = "" if np.isnan(stated).all() else f"{np.nanmedian(stated):.2f}, {np.nanmedian(bound):.3f}"
    print(
        f"{place} | {name} | {np.nanmedian(far):.2f}, {np.nanmax(far):.2f} | {np.nanmedian(turned):.3f}, "
        f"{np.nanmax(turned):.3f} | {said} | {covered}", flush=True,
    )  # fmt: skip


if __name__ == "__main__":
    main()
