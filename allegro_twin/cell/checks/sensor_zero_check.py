"""Checks the force sensor itself: zero where nothing touches, and weight downwards. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from allegro_twin.cell.checks.grasp_check import GraspCheck, added_force
from allegro_twin.cell.settings import GraspCheckSettings
from allegro_twin.types import Array, Vector

_SURE = 4.0  # Standard deviations: one in 16,000 is farther off by chance.


def check_drift(idle: Sequence[Vector], before: Sequence[Vector], settings: GraspCheckSettings, others: int = 0) -> str:
    """What the sensor felt more before the approach than where it waited, (6,) each and touched by nothing; or "".
    `others`: so many other objects are on the table, one of which the hand may have touched."""
    if not idle or not before:
        return ""
    off = float(np.abs(added_force(idle, before)).max())
    if off <= _allowed(len(idle), len(before), settings):
        return ""
    said = f"its zero moved by {off:.1f} N between waiting and the approach, where nothing "
    return said + (f"but one of {others} other objects can have touched the hand" if others else "touched the hand")


def check_plausibility(
    found: GraspCheck, before: Sequence[Vector], after: Sequence[Vector], axes: Array, settings: GraspCheckSettings
) -> str:
    """Why the weight cannot be right, or ""; `axes` are the flange's in the world, (3, 3)."""
    force, most = axes @ added_force(before, after), _allowed(len(before), len(after), settings)
    aside = float(np.abs(force[:2]).max())
    if aside > most:
        return f"it feels {aside:.1f} N sideways, and a weight only pulls down"
    if force[2] > most:
        return f"it feels {force[2]:.1f} N upwards, and nothing lifts the hand"
    if found.weight > settings.most:
        return f"it feels {found.weight:.2f} kg, more than the arm carries"
    if found.by_force and found.by_fingers is False and not found.by_camera:
        return f"it feels {1e3 * found.weight:.0f} g, and the fingers are where they would be around nothing"
    if settings.by == "force" and found.by_fingers and not found.by_force:
        return (
            f"it feels {1e3 * found.weight:.0f} g, and something is between the fingers: either that weighs less than "
            f"{1e3 * settings.least:.0f} g"
        )
    return ""


def with_uncertainty(found: GraspCheck, why: str, settings: GraspCheckSettings) -> GraspCheck:
    """The check with its doubt as a sentence that says what to do."""
    if not why:
        return found
    way = "decide by fingers" if settings.by == "force" else "the fingers decide, so the verdict stands"
    return replace(found, warning=f"the force sensor is suspect: {why}; {way}, and tare it anew or see to it")


def _allowed(first: int, second: int, settings: GraspCheckSettings) -> float:
    """By how much two means may differ, N."""
    return settings.drift + _SURE * settings.noise * float(np.sqrt(1.0 / first + 1.0 / second))
