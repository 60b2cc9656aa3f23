"""Views of a pattern by a camera whose place is known, without a picture."""

from __future__ import annotations

import numpy as np

from allegro_twin.cell.calibration.hand_eye import PatternView
from allegro_twin.cell.camera.intrinsics import D435I_DEPTH
from allegro_twin.cell.camera.mount import looking
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.pose import Pose, compose, relative_to

LENS = D435I_DEPTH["640x480"]
UNIT = Pose(np.zeros(3), np.eye(3))
CAMERA = Pose(np.array([0.05, -0.02, 0.04]), rotate(np.eye(3), np.array([0.3, -0.2, 2.1])))
"""In the flange's frame, or the base's."""
PATTERN = Pose(np.array([0.5, 0.1, 0.02]), rotate(np.eye(3), np.array([3.0, 0.1, 0.2])))
_GRID = np.stack([*np.mgrid[1:7, 1:5], np.zeros((6, 4))], axis=-1).reshape(-1, 3) * 0.035


def pattern_views(
    seed: int, count: int = 15, *, wrist: bool = True, noise: float = 0.05, arm: tuple[float, float] = (0.0, 0.0),
    tilt: float = 40.0,
) -> list[PatternView]:  # fmt: skip
    """`noise`: of the corners, pixels; `arm`: of its pose, m and rad; `tilt`: degrees at most."""
    draws, found = np.random.default_rng(seed), []
    for k in range(count):
        around, lean = 2.0 * np.pi * k / count, np.radians(tilt) * np.sqrt(draws.uniform(0.05, 1.0))
        way = np.array([np.sin(lean) * np.cos(around), np.sin(lean) * np.sin(around), -np.cos(lean)])
        middle, roll = np.array([0.12, 0.09, 0.0]), draws.uniform(-1.0, 1.0)
        eye = looking(middle + draws.uniform(0.36, 0.5) * way, middle, (np.cos(roll), np.sin(roll), 0.0))
        seen = relative_to(Pose(*eye), UNIT)
        moved = compose(compose(CAMERA, seen), relative_to(PATTERN, UNIT))
        flange = relative_to(moved, UNIT) if wrist else moved
        shift, turn = arm[0] * draws.standard_normal(3), arm[1] * draws.standard_normal(3)
        reported = Pose(flange.position + shift, rotate(flange.rotation, turn))
        pixels = LENS.pixel(_GRID @ seen.rotation.T + seen.position) + noise * draws.standard_normal((len(_GRID), 2))
        rough = Pose(
            seen.position + 2e-3 * draws.standard_normal(3), rotate(seen.rotation, 0.01 * draws.normal(size=3))
        )
        found.append(PatternView(f"{k:02d}.png", reported, seen if noise == 0.0 else rough, _GRID, pixels))
    return found
