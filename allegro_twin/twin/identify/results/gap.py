"""Gap between a hand and its twin: recorded commands played into the model, open loop, against the measured motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.sim.drivetrain.backlash import SMALLEST as LEAST_PLAY
from allegro_twin.sim.open_loop import PARASITIC, WARMTH, DriveParameters, OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.twin.identify.fitting.shooting import MotionSegments, cut_segments
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.types import Array, Vector

HORIZONS = (0.1, 0.3, 1.0, 5.0)
"""Times in open loop after which the error is given, s."""
STARTS = 1.0  # s between two starts, at most.
PHASES = ("creeping", "moving")
SMALLEST = 2e-4
"""rad, of bristles that can be simulated at 1 ms. Joints without bristles get these where others have some."""
SHORTEST = {"bristle": SMALLEST, "backlash": LEAST_PLAY}
"""What a joint has in a model in which others have more."""
EXPLAINED, LEAN_STEPS = 0.7, 3
"""Share of the error that a lean may leave to count; steps to it."""
_NUDGE, _HELD = 2e-3, 1e-4  # rad, of differences; of the trace, for what nothing shows.
_CREEP = 0.1  # rad/s, mean of the fastest joint of a finger.


class GapErrors(NamedTuple):
    """Root mean square errors in rad."""

    joint: Array
    """(horizons, n)."""
    phase: Array
    """Over pieces of 0.3 s in which a finger creeps, and in which it moves, (2, n); NaN where there are none."""

    @property
    def all(self) -> Vector:
        """Over all joints, (horizons,)."""
        return np.asarray(np.sqrt(np.square(self.joint).mean(axis=1)))


@dataclass(frozen=True, slots=True, eq=False)
class Gap:
    """Gap of one recording."""

    name: str
    horizons: tuple[float, ...]
    before: GapErrors
    """With the nominal hand."""
    after: GapErrors
    """With the hand's own file."""
    lean: Vector
    """By how much the palm leans in this recording from what it says of gravity, where that explains most of the error:
    rotation vector of gravity in the palm's frame, (3,), rad; else 0."""
    upright: GapErrors
    """With the hand's own file and that lean."""


def drive_parameters(spec: HandSpec, torque_constant: Vector, offset: Vector) -> DriveParameters:
    """Model parameters from a hand's file. `offset`: shift of reported positions, (n,), rad, by the file."""
    own, n = spec.actuation, spec.n_joints
    drive = spec.drive
    return DriveParameters(
        torque_constant=torque_constant if drive is None else torque_constant * drive.strength,
        armature=own.armature,
        damping=own.damping,
        frictionloss=own.frictionloss,
        offset=offset,
        delay=np.full(n, 0.0 if drive is None else drive.delay),
        mass_scale=np.ones(n) if drive is None else drive.mass_scale,
        stiction=np.ones(n) if drive is None else drive.stiction,
        stribeck_speed=np.ones(n) if drive is None else drive.stribeck_speed,
        bristle=np.full(n, SMALLEST) if drive is None else np.maximum(drive.bristle, SMALLEST),
        load_friction=np.zeros(n) if drive is None else drive.load_friction,
        backlash=np.full(n, LEAST_PLAY) if drive is None else np.maximum(drive.backlash, LEAST_PLAY),
        **({} if drive is None else {name: getattr(drive, name) for name in (*PARASITIC, *WARMTH, "gear_compliance")}),
        tilt=drive.tilt[None] if drive is not None and drive.tilt.any() else np.zeros((0, 3)),
    )


def has_breakaway_friction(drive: Drive | None) -> bool:
    """Whether a model needs bristles: friction breaks away, or grows with the motor's torque."""
    return drive is not None and bool(drive.bristle.any() or drive.load_friction.any())


def make_player(spec: HandSpec, period: float, drive: Drive | None) -> OpenLoopPlayer:
    """The model that plays motions of a hand with this drive."""
    return OpenLoopPlayer(
        spec,
        period,
        bristly=has_breakaway_friction(drive),
        loose=drive is not None and bool(drive.backlash.any()),
        parasitic=drive is not None and drive.parasitic,
        warming=drive is not None and drive.warming,
    )


def measure_gap(
    motion: RecordedMotion,
    before: tuple[OpenLoopPlayer, DriveParameters],
    after: tuple[OpenLoopPlayer, DriveParameters],
) -> Gap:
    """Errors of two models on a motion. Raises ConfigError for a recording shorter than the shortest horizon."""
    horizons = tuple(h for h in HORIZONS if motion.seconds > h + 0.1)
    if not horizons:
        raise ConfigError(f"{motion.name} is {motion.seconds:.2f} s long: the gap needs {HORIZONS[0] + 0.1:g} s")
    one, other = (gap_errors(motion, player, drive, horizons) for player, drive in (before, after))
    lean = find_lean(motion, *after)
    turned = replace(motion, gravity=rotate_vector(motion.gravity, lean))
    upright = gap_errors(turned, *after, horizons)
    if upright.all[-1] > EXPLAINED * other.all[-1]:
        lean, upright = np.zeros(3), other
    return Gap(motion.name, horizons, one, other, lean, upright)


def find_lean(motion: RecordedMotion, player: OpenLoopPlayer, drive: DriveParameters) -> Vector:
    """The lean of the palm with which a drive explains a motion best in pieces of 0.3 s: Gauss and Newton's steps, with
    differences; about gravity itself, which shows nothing, 0. (3,), rad."""
    lean = np.zeros(3)
    cuts = cut_segments([motion], player.spec, round(HORIZONS[1] / motion.period))
    if not len(cuts.position):
        return lean
    weights = piece_weights(cuts, player.spec)[:, None, :]

    def wrong(angle: Vector) -> Vector:
        gravity = rotate_vector(leaning(cuts.segments.gravity, drive), np.tile(angle, (len(cuts.position), 1)))
        played = player.play(drive, cuts.position, cuts.velocity, cuts.segments._replace(gravity=gravity))
        return np.asarray((weights * (played - cuts.measured)).ravel())

    for _ in range(LEAN_STEPS):
        left = wrong(lean)
        J = np.stack([(wrong(lean + _NUDGE * axis) - left) / _NUDGE for axis in np.eye(3)], axis=1)
        # A piece in which a joint slips where it should stick says nothing of gravity.
        used = np.abs(left[np.broadcast_to(weights, cuts.measured.shape).ravel() > 0.0])
        robust = 1.0 / (1.0 + np.square(left / (3.0 * float(np.median(used)) + 1e-9)))
        normal = J.T @ (robust[:, None] * J)
        held = _HELD * float(np.trace(normal)) * np.eye(3)
        lean = lean - np.linalg.solve(normal + held, J.T @ (robust * left))
    return lean


def gap_errors(
    motion: RecordedMotion, player: OpenLoopPlayer, drive: DriveParameters, horizons: tuple[float, ...] = HORIZONS
) -> GapErrors:
    """Errors of a model on a motion that is longer than the longest of some horizons, s."""
    rows, phase = [], np.full((2, player.spec.n_joints), np.nan)
    for horizon in horizons:
        length = round(horizon / motion.period)
        cuts = cut_segments([motion], player.spec, length, max(round(min(horizon, STARTS) / motion.period), 1))
        pieces = cuts.segments._replace(gravity=leaning(cuts.segments.gravity, drive))
        error = player.play(drive, cuts.position, cuts.velocity, pieces) - cuts.measured
        rows.append(_rms(error, piece_weights(cuts, player.spec)))
        if horizon == HORIZONS[1]:
            phase = _phases(error, cuts, player.spec, motion.period)
    return GapErrors(np.array(rows), phase)


def leaning(gravity: Array, drive: DriveParameters) -> Array:
    """Gravity (w, 3) in a palm that leans as a drive has it, the same in all recordings."""
    return rotate_vector(gravity, np.tile(drive.tilt[0], (len(gravity), 1))) if len(drive.tilt) else gravity


def _phases(error: Array, cuts: MotionSegments, spec: HandSpec, period: float) -> Array:
    speed, trust = np.abs(np.diff(cuts.measured, axis=1)).mean(axis=1) / period, piece_weights(cuts, spec)  # (w, n)
    found = np.full((2, spec.n_joints), np.nan)
    for finger in spec.fingers:
        own = list(finger.joints)
        moving = speed[:, own].max(axis=1) > _CREEP
        for row, chosen in enumerate((~moving, moving)):
            chosen = chosen & (trust[:, own[0]] > 0.0)
            if chosen.any():
                found[row, own] = _rms(error[chosen][:, :, own], trust[chosen][:, own])
    return found


def piece_weights(cuts: MotionSegments, spec: HandSpec) -> Array:
    """1 for joints of fingers that can be weights during a piece, as for the fit, (w, n); of a finger that has no such
    piece all count."""
    trust = np.zeros((len(cuts.position), spec.n_joints))
    for number, finger in enumerate(spec.fingers):
        trust[:, list(finger.joints)] = cuts.trust[:, [number]]
    return np.where(trust.any(axis=0), trust, 1.0)


def _rms(error: Array, weight: Array) -> Vector:
    """Root mean square of each joint over pieces (w, k, n) with weights (w, n), (n,)."""
    return np.asarray(np.sqrt(np.average(np.square(error).mean(axis=1), axis=0, weights=weight)))
