"""Hand-eye calibration of a cell's camera: the solver, patterns, folders of pictures, and a rehearsal in simulation.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import allegro_twin.sim as sim  # noqa: F401  # It chooses how MuJoCo renders, which must come before MuJoCo.
from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.cell.calibration.hand_eye import HandEyeCalibration, PatternView, calibrate_hand_eye
    from allegro_twin.cell.calibration.pattern import PatternSettings, draw_pattern, find_pattern
    from allegro_twin.cell.calibration.pictures import ArmPicture, calibrate_folder, calibrate_pictures
    from allegro_twin.cell.calibration.simulated import CalibrationCell

__all__ = [
    "ArmPicture",
    "CalibrationCell",
    "HandEyeCalibration",
    "PatternSettings",
    "PatternView",
    "calibrate_folder",
    "calibrate_hand_eye",
    "calibrate_pictures",
    "draw_pattern",
    "find_pattern",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "hand_eye": (
            "HandEyeCalibration",
            "PatternView",
            "calibrate_hand_eye",
        ),
        "pattern": (
            "PatternSettings",
            "draw_pattern",
            "find_pattern",
        ),
        "pictures": (
            "ArmPicture",
            "calibrate_folder",
            "calibrate_pictures",
        ),
        "simulated": ("CalibrationCell",),
    },
)
