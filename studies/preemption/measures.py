"""What is kept of one trial while it runs, and the row that it becomes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from allegro_twin.grasping import relative_displacement
from allegro_twin.types import Array
from studies.preemption.draws import Case
from studies.preemption.protocol import Check

Row = Mapping[str, Any]
"""A trial as plain data: what it was drawn as, and what came of it."""
_G = 9.81


@dataclass(slots=True, eq=False)
class Measures:
    """Of one trial."""

    begun: float = float("nan")
    """When the hand began to close, s."""
    lifted: float = float("nan")
    """When the thing was to be up, s."""
    why: str = ""
    """Empty where the thing was held to the end."""
    premature: float = 0.0
    """How long the hand touched the thing before the arm arrived, s."""
    impulse: float = 0.0
    """Meanwhile, N·s."""
    pushed: float = 0.0
    """How far the thing was moved along the table before the hand began to close, m."""
    carried: float = 0.0
    """And before the arm arrived, m."""
    peak: float = 0.0
    """The most that the hand pressed on it, all contacts together, N."""
    felt: float = 0.0
    """With how much the arm's spring is drawn out, mean of the last samples of the hold, N."""
    slip: float = float("nan")
    """In the palm, by the shake, m."""
    tilt: float = float("nan")
    """In the palm, from the lift to the end of the hold, degrees."""
    marks: dict[str, tuple[Array, Array]] = field(default_factory=dict)
    """Palm and object, (7,) each, at the beginning of the lift and at the end of the hold."""

    def at_hold(self, palm: Array, thing: Array) -> None:
        """The end of the hold."""
        self.marks["hold"] = palm, thing
        self.tilt = float(relative_displacement(palm, thing, *self.marks["lift"])[1])

    def at_end(self, palm: Array, thing: Array) -> None:
        """The end of the shake."""
        self.slip = float(relative_displacement(palm, thing, *self.marks["hold"])[0])

    def row(self, case: Case, check: Check, closing: float) -> dict[str, Any]:
        """Plain data, in units that are read."""
        noise = check.noise * np.sqrt(2.0 / check.samples) * case.felt
        weight = (self.felt + noise) / _G if "hold" in self.marks else noise / _G
        return {
            "object": case.object, "sigma_mm": 1e3 * case.sigma, "sigma_deg": case.sigma_yaw,
            "friction": case.friction, "approach_s": case.approach,
            "off_mm": 1e3 * float(np.hypot(case.x, case.y)), "off_deg": float(np.degrees(case.yaw)),
            "held": self.why == "", "why": self.why, "begun_s": self.begun, "cycle_s": self.lifted,
            "overlap": (case.approach - self.begun) / closing,
            "premature_s": self.premature, "premature_ns": self.impulse, "pushed_mm": 1e3 * self.pushed,
            "carried_mm": 1e3 * self.carried, "peak_n": self.peak, "slip_mm": 1e3 * self.slip, "tilt_deg": self.tilt,
            "felt_g": 1e3 * float(weight), "said_held": bool(weight > check.least),
        }  # fmt: skip
