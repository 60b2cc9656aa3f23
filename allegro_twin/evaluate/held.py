"""Held or not: the verdict on a trial, from what was observed and nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from allegro_twin.kinematics.orientation import angle_between, matrix_from_quaternion
from allegro_twin.types import Array, Vector


@dataclass(frozen=True, slots=True)
class Window:
    """One phase of a trial on the clock of the hand."""

    name: str
    begin: float
    end: float
    """s."""
    check: bool
    """The object must be held at its end."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """One row a period, of a whole trial."""

    t: Array
    """(k,), s."""
    palm: Array
    """Position and quaternion in the world, (k, 7), m."""
    thing: Array
    """Of the object, (k, 7), m."""
    contact_force: Array
    """Sum of normal forces on the object by each part of the hand, (k, p), N."""
    on_table: Array
    """1 where the object touches the table, (k,)."""
    torque: Array
    """Applied joint torques, (k, n), N·m."""


@dataclass(frozen=True, slots=True)
class PhaseReport:
    """What happened in one phase."""

    name: str
    drift: float
    """Of the object in the palm's frame at the end, since the reference, m."""
    rotation: float
    """Likewise, degrees."""
    largest_drift: float
    """During the phase, m."""
    contact_force: Mapping[str, float]
    """Mean over the phase by part of the hand, N."""
    check: bool
    held: bool


@dataclass(frozen=True, slots=True)
class Report:
    """The verdict on a trial, with the margins that led to it."""

    held: bool
    reason: str
    """Empty when held; else the first phase that failed, with its numbers."""
    phases: tuple[PhaseReport, ...]
    """From the reference on."""
    peak_torque: float
    """The largest fraction of its limit that any joint used."""
    lift: float
    """How far the object rose between the reference and the first check, m."""


def judge(
    seen: Observations,
    windows: Sequence[Window],
    reference: str,
    *,
    parts: Sequence[str],
    torque_limit: Vector,
    drift: float,
    rotation: float,
    lift: float,
) -> Report:
    """Held means: at the end of every phase that checks, the object has moved no more than `drift` (m) and `rotation`
    (degrees) in the palm's frame since the end of the reference phase, is off the table and touches the hand; and it
    rose by at least half of `lift` (m)."""
    position, angle = relative_motion(seen, _last(seen.t, next(w.end for w in windows if w.name == reference)))
    phases = []
    begun = False
    for window in windows:
        if begun:
            phases.append(_phase(seen, window, parts, position, angle, drift, rotation))
        begun = begun or window.name == reference
    checks = [window for window in windows if window.check]
    start = _last(seen.t, next(w.end for w in windows if w.name == reference))
    rise = float(seen.thing[_last(seen.t, checks[0].end), 2] - seen.thing[start, 2]) if checks else 0.0
    reason = next(
        (_why(p, seen, w) for p in phases for w in windows if w.name == p.name and p.check and not p.held), ""
    )
    if not reason and rise < lift / 2:
        reason = f"rose {rise * 1000:.0f} mm of {lift * 1000:.0f} mm"
    peak = float((np.abs(seen.torque) / torque_limit).max())
    return Report(not reason, reason, tuple(phases), peak, rise)


def relative_motion(seen: Observations, start: int) -> tuple[Array, Array]:
    """Distance (k,) in m and angle (k,) in degrees of the object in the palm's frame, from row `start`."""
    palm = matrix_from_quaternion(seen.palm[:, 3:])
    position = np.einsum("kji,kj->ki", palm, seen.thing[:, :3] - seen.palm[:, :3])
    turn = np.einsum("kji,kjl->kil", palm, matrix_from_quaternion(seen.thing[:, 3:]))
    return np.linalg.norm(position - position[start], axis=1), np.degrees(angle_between(turn, turn[start]))


def _phase(
    seen: Observations,
    window: Window,
    parts: Sequence[str],
    position: Array,
    angle: Array,
    drift: float,
    rotation: float,
) -> PhaseReport:
    rows = slice(_last(seen.t, window.begin) + 1, _last(seen.t, window.end) + 1)
    end = rows.stop - 1
    held = (
        position[end] <= drift and angle[end] <= rotation and not seen.on_table[end] and seen.contact_force[end].any()
    )
    force = seen.contact_force[rows].mean(axis=0)
    return PhaseReport(
        window.name,
        float(position[end]),
        float(angle[end]),
        float(position[rows].max()),
        dict(zip(parts, map(float, force), strict=True)),
        window.check,
        bool(held),
    )


def _why(phase: PhaseReport, seen: Observations, window: Window) -> str:
    end = _last(seen.t, window.end)
    if not seen.contact_force[end].any():
        return f"dropped by the end of {phase.name}"
    if seen.on_table[end]:
        return f"still on the table at the end of {phase.name}"
    return f"moved {phase.drift * 1000:.1f} mm and {phase.rotation:.1f}° in the hand by the end of {phase.name}"


def _last(t: Array, moment: float) -> int:
    """The last row at or before a moment."""
    return int(np.searchsorted(t, moment + 1e-9, side="right")) - 1
