"""Held or not: the verdict on a trial, from what was observed and nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from allegro_twin.hands.library.taxonomy import ObservedType
from allegro_twin.kinematics.orientation import angle_between, matrix_from_quaternion
from allegro_twin.types import Array, Vector

FULL = 0.99
"""Share of its torque limit from which a joint has no more to give."""
FELL = 0.3
"""m by which an object is lower than where it lay: it has left the table. One that tips over on it sinks by less."""


@dataclass(frozen=True, slots=True)
class PhaseWindow:
    """One phase of a trial on the clock of the hand."""

    name: str
    begin: float
    end: float
    """s."""
    check: bool
    """The object must be held at its end."""


@dataclass(frozen=True, slots=True)
class Rule:
    """Conditions under which an object counts as held."""

    reference: str
    """Motion of the object is counted from the end of this phase."""
    drift: float
    """How far it may have moved in the palm's frame, m."""
    rotation: float
    """Largest rotation in the palm's frame, degrees."""
    lift: float = 0.0
    """How high the wrist is told to lift it, m: it must rise so far, but for `drift`."""
    throughout: bool = False
    """The limits hold during the whole of a phase that checks, not only at its end."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """One row a period, of a whole trial."""

    t: Array
    """(k,), s."""
    palm: Array
    """Position and quaternion in the world, (k, 7), m."""
    object_pose: Array
    """Pose of the object in the world, (k, 7), m."""
    contact_force: Array
    """Sum of normal forces on the object by each part of the hand, (k, p), N."""
    on_table: Array
    """1 where the object touches the table, (k,)."""
    contacts: Array
    """How many points of the hand touch the object, (k,)."""
    penetration: Array
    """How deep object and hand are in each other, (k,), m."""
    torque: Array
    """Applied joint torques, (k, n), N·m."""


@dataclass(frozen=True, slots=True)
class PhaseReport:
    """Report of one phase."""

    name: str
    drift: float
    """Drift of the object in the palm's frame at the end, since the reference, m."""
    rotation: float
    """Rotation of the object in the palm's frame at the end, since the reference, degrees."""
    largest_drift: float
    """During the phase, m."""
    contact_force: Mapping[str, float]
    """Mean over the phase by part of the hand, N."""
    contacts: float
    """Points of the hand that touch the object, mean over the phase."""
    penetration: float
    """The deepest during the phase, m."""
    margin: float
    """What is left of the limits on drift and rotation, as a fraction of them; negative: so much too far."""
    check: bool
    held: bool


@dataclass(frozen=True, slots=True)
class TrialReport:
    """The verdict on a trial, with the margins that led to it."""

    held: bool
    reason: str
    """Empty when held; else the first phase that failed, with its numbers."""
    phases: tuple[PhaseReport, ...]
    """From the reference on."""
    peak_torque: float
    """The largest fraction of its limit that any joint used, of those whose limit is known; NaN: of none it is."""
    lift: float
    """How far the object rose between the reference and the first check, m."""
    penetration: float
    """The deepest that object and hand are in each other from the reference on, m."""
    at_limit: Mapping[str, float]
    """For every joint the share of the time from the reference on in which it pushes at 99 % of its limit or more; NaN
    where the limit is unknown."""
    sustained: Mapping[str, float] = field(default_factory=dict)
    """For every joint the share of its limit that it gives from the reference on, as the root of the mean square: what
    warms a motor. NaN where the limit is unknown."""
    observed: ObservedType | None = field(default=None, compare=False)
    """The type of grasp that its contacts show while it holds; None: nobody looked at every contact."""

    @property
    def hottest(self) -> tuple[str, float]:
        """The joint that sustains most, and the share of its limit, of those whose limit is known; `""` and NaN: of
        none it is."""
        known = [each for each in self.sustained.items() if not np.isnan(each[1])]
        return max(known, key=lambda each: each[1], default=("", float("nan")))

    @property
    def fell(self) -> bool:
        """Whether the object fell off the table."""
        return self.lift < -FELL

    @property
    def stall(self) -> float:
        """The largest of `at_limit`, of the joints whose limit is known; NaN: of none it is."""
        return _largest(np.array([*self.at_limit.values()]))

    @property
    def margin(self) -> float:
        """The smallest of the phases that check; NaN where none does."""
        return min((phase.margin for phase in self.phases if phase.check), default=float("nan"))


def faulted(reason: str) -> TrialReport:
    """The verdict on a trial that a fault ended before its own end: not held, and nothing measured."""
    unknown = float("nan")
    return TrialReport(
        held=False, reason=reason, phases=(), peak_torque=unknown, lift=unknown, penetration=unknown, at_limit={}
    )


def judge(
    observations: Observations,
    windows: Sequence[PhaseWindow],
    rule: Rule,
    *,
    parts: Sequence[str],
    joints: Sequence[str],
    torque_limit: Vector,
) -> TrialReport:
    """Held means: at the end of every phase that checks, the object has moved no more than the rule's `drift` and
    `rotation` in the palm's frame since the end of the reference phase, is off the table and touches the hand; and by
    the first of them it rose as far as the rule's `lift`, but for `drift`. `torque_limit`: (n,), N·m; inf
    where it is unknown."""
    start = _last(observations.t, next(w.end for w in windows if w.name == rule.reference))
    position, angle = relative_motion(observations.palm, observations.object_pose, start)
    phases = []
    begun = False
    for window in windows:
        if begun:
            phases.append(_phase(observations, window, parts, position, angle, rule))
        begun = begun or window.name == rule.reference
    checks = [window for window in windows if window.check]
    rise = (
        float(observations.object_pose[_last(observations.t, checks[0].end), 2] - observations.object_pose[start, 2])
        if checks
        else 0.0
    )
    reason = next(
        (_why(p, observations, w) for p in phases for w in windows if w.name == p.name and p.check and not p.held), ""
    )
    if not reason and rise < rule.lift - rule.drift:
        reason = f"rose {rise * 1000:.0f} mm of {rule.lift * 1000:.0f} mm"
        palm = float(observations.palm[_last(observations.t, checks[0].end), 2] - observations.palm[start, 2])
        if palm < rule.lift - rule.drift:
            reason += f", as the palm did ({palm * 1000:.0f} mm): it was pushed up before the lift, or held down in it"
    known = np.where(np.isfinite(torque_limit), 1.0, np.nan)
    used = np.abs(observations.torque) / torque_limit * known
    after = used[start + 1 :] if start + 1 < len(used) else np.zeros((1, len(joints))) * known
    share, warming = (after >= FULL).mean(axis=0) * known, np.sqrt(np.square(after).mean(axis=0))
    return TrialReport(
        not reason, reason, tuple(phases), _largest(used), rise, _deepest(observations.penetration[start:]),
        dict(zip(joints, map(float, share), strict=True)), dict(zip(joints, map(float, warming), strict=True)),
    )  # fmt: skip


def relative_motion(palm: Array, object_pose: Array, start: int) -> tuple[Array, Array]:
    """Distance (k,) in m and angle (k,) in degrees of an object in the palm's frame, from row `start`. Both are poses
    in the world, (k, 7)."""
    return relative_displacement(palm[start], object_pose[start], palm, object_pose)


def relative_displacement(
    palm: Array, object_pose: Array, palm_then: Array, object_pose_then: Array
) -> tuple[Array, Array]:
    """How far, m, and by what angle, degrees, an object moves in the palm's frame between two moments, (...). Poses in
    the world, (..., 7)."""
    (first, turn), (then, turned) = pose_in_palm(palm, object_pose), pose_in_palm(palm_then, object_pose_then)
    return np.linalg.norm(then - first, axis=-1), np.degrees(angle_between(turned, turn))


def pose_in_palm(palm: Array, object_pose: Array) -> tuple[Array, Array]:
    """Position (..., 3), m, and rotation (..., 3, 3) of an object in the palm's frame. Poses in the world, (..., 7)."""
    turned = matrix_from_quaternion(palm[..., 3:])
    position = np.einsum("...ji,...j->...i", turned, object_pose[..., :3] - palm[..., :3])
    return position, np.einsum("...ji,...jl->...il", turned, matrix_from_quaternion(object_pose[..., 3:]))


def _phase(
    observations: Observations, window: PhaseWindow, parts: Sequence[str], position: Array, angle: Array, rule: Rule
) -> PhaseReport:
    rows = slice(_last(observations.t, window.begin) + 1, _last(observations.t, window.end) + 1)
    end = rows.stop - 1
    judged = rows if rule.throughout else slice(end, end + 1)
    distance, turn = float(position[judged].max()), float(angle[judged].max())
    margin = 1.0 - max(distance / rule.drift, turn / rule.rotation)
    force = observations.contact_force[rows].mean(axis=0)
    return PhaseReport(
        window.name,
        float(position[end]),
        float(angle[end]),
        float(position[rows].max()),
        dict(zip(parts, map(float, force), strict=True)),
        float(observations.contacts[rows].mean()),
        _deepest(observations.penetration[rows]),
        margin,
        window.check,
        bool(margin >= 0.0 and not observations.on_table[end] and observations.contact_force[end].any()),
    )


def _largest(values: Array) -> float:
    """Largest value that is not NaN; NaN where all are, or there is none."""
    known = values[~np.isnan(values)]
    return float(known.max()) if len(known) else float("nan")


def _deepest(penetration: Array) -> float:
    """NaN where nobody looked, as in recordings of older versions."""
    return float(penetration.max()) if len(penetration) else 0.0


def _why(phase: PhaseReport, observations: Observations, window: PhaseWindow) -> str:
    end = _last(observations.t, window.end)
    if not observations.contact_force[end].any():
        return f"dropped by the end of {phase.name}"
    if observations.on_table[end]:
        return f"still on the table at the end of {phase.name}"
    return f"moved {phase.drift * 1000:.1f} mm and {phase.rotation:.1f}° in the hand by the end of {phase.name}"


def _last(t: Array, moment: float) -> int:
    """The last row at or before a moment."""
    return int(np.searchsorted(t, moment + 1e-9, side="right")) - 1
