"""Linear fit of a drive from positions alone, one regression per joint: the start for the nonlinear fit.

    k u = τ(q, v, a) + A a + B v + F sgn(v)

u: fraction of full PWM, k: torque constant, τ: torque that moves the links (known masses), A: armature, B: damping, F:
dry friction. Divided by k it is linear in 1/k, A/k, B/k and F/k. Positions are filtered forwards and backwards, so that
speeds and accelerations have no delay; both sides of the equation pass the same filter.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.sim.drivetrain.backlash import SMALLEST
from allegro_twin.sim.drivetrain.lugre_friction import followed_deflection
from allegro_twin.sim.open_loop import DriveParameters, OpenLoopPlayer
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.types import Array, Vector

try:
    from scipy.signal import butter, filtfilt  # type: ignore[import-untyped]  # Its types are a package of their own.
except ImportError as error:
    raise ConfigError("a twin needs SciPy: pip install 'allegro-twin[twin]'") from error

SMOOTH, BAND = 18.0, 12.0  # Hz: of positions, and of both sides of the equation.
DELAYS = np.arange(0.0, 0.0125, 0.0005)  # s
STILL = 0.02  # rad/s. Slower than this a joint may stick, and friction has any value.
LOAD = (0.03, 0.03)  # Of friction per torque: loss of spur gears, and its standard deviation.
KIN = 10.0  # Neighbouring rows with the same error, since it is the model's and not noise.
STRIBECK = np.array([0.07, 0.1, 0.14, 0.2])  # rad/s, tried.
GIVES = np.array([0.004, 0.006, 0.009, 0.013, 0.018, 0.025])  # rad, of friction that gives far before it slides.
CLEAR = 0.7  # Share of what Coulomb's friction leaves over that such friction may leave, in the median joint. Ours.
THIN = 5  # Rows: after the filter they say the same.


class SmoothedMotion(NamedTuple):
    """A motion without its noise, (k, n) each: rad, rad/s, rad/s²."""

    position: Array
    velocity: Array
    acceleration: Array


def smooth_motion(motion: RecordedMotion) -> SmoothedMotion:
    position = low_pass(motion.position, motion.period, SMOOTH)
    velocity = np.gradient(position, motion.period, axis=0)
    return SmoothedMotion(position, velocity, np.gradient(velocity, motion.period, axis=0))


def smooth_duty(motion: RecordedMotion) -> Array:
    """Duty around each row, as fractions of full PWM, filtered as `smooth_motion` does, (k, n)."""
    return low_pass(shifted_duty(motion.duty, 0.0), motion.period, SMOOTH)


def regress(motions: list[RecordedMotion], player: OpenLoopPlayer, mass_scale: Vector) -> DriveParameters:
    """The linear fit of every joint, with one delay for all."""
    parts = [_link_torques(motion, player, mass_scale) for motion in motions]
    best: tuple[float, float, Array] | None = None
    for delay in DELAYS:
        solved, left = _solve(motions, parts, float(delay))
        if best is None or left.sum() < best[0]:
            best = (float(left.sum()), float(delay), solved)
    assert best is not None
    _, delay, x = best
    constant = 1.0 / np.clip(x[:, 0], 0.2, 5.0)
    spec = motions[0].spec
    return DriveParameters(
        torque_constant=constant,
        armature=np.clip(x[:, 1] * constant, 3e-4, 3e-2),
        damping=np.clip(x[:, 2] * constant, 3e-3, 1.0),
        frictionloss=np.clip(x[:, 3] * constant, 5e-4, 0.2),
        offset=np.zeros(spec.n_joints),
        delay=np.full(spec.n_joints, delay),
        mass_scale=np.array(mass_scale),
        stiction=np.full(spec.n_joints, 1.3),
        stribeck_speed=np.full(spec.n_joints, 0.12),
        bristle=np.full(spec.n_joints, 1e-3),
        load_friction=np.full(spec.n_joints, LOAD[0]),
        backlash=np.full(spec.n_joints, SMALLEST),
    )


def regress_breakaway(motions: list[RecordedMotion], player: OpenLoopPlayer, start: DriveParameters) -> DriveParameters:
    """The linear fit with friction that is larger at low speed and grows with the motor's torque, (n,) each: F sgn(v)
    (1 + (ratio − 1) exp(−(v / v_s)²)) + share · k |u| sgn(v), linear but for v_s, the best of a few."""
    delay = float(start.delay[0])
    parts = [_link_torques(motion, player, start.mass_scale) for motion in motions]
    tried = [_solve(motions, parts, delay, speed) for speed in STRIBECK]
    best = np.argmin([left for _, left in tried], axis=0)
    x = np.stack([tried[which][0][joint] for joint, which in enumerate(best)])
    constant = 1.0 / np.clip(x[:, 0], 0.2, 5.0)
    dry = np.clip(x[:, 3] * constant, 5e-4, 0.2)
    return replace(
        start,
        torque_constant=constant,
        armature=np.clip(x[:, 1] * constant, 3e-4, 3e-2),
        damping=np.clip(x[:, 2] * constant, 3e-3, 1.0),
        frictionloss=dry,
        stiction=np.clip(1.0 + x[:, 4] * constant / dry, 1.1, 2.0),
        stribeck_speed=STRIBECK[best],
        load_friction=np.clip(x[:, 5], 0.005, 0.1),
    )


def regress_presliding(
    motions: list[RecordedMotion], player: OpenLoopPlayer, start: DriveParameters
) -> DriveParameters | None:
    """The linear fit with friction that gives far before it slides (Dahl 1968): F z / g, z followed through the motion,
    g the best of GIVES for each joint. None where that explains no more than CLEAR."""
    delay = float(start.delay[0])
    parts = [_link_torques(motion, player, start.mass_scale) for motion in motions]
    _, before = _solve(motions, parts, delay)
    tried = [_solve(motions, parts, delay, give=give) for give in GIVES]
    best = np.argmin([left for _, left in tried], axis=0)
    left = np.min([left for _, left in tried], axis=0)
    if np.median(left / np.maximum(before, 1e-12)) > CLEAR:
        return None
    x = np.stack([tried[which][0][joint] for joint, which in enumerate(best)])
    constant = 1.0 / np.clip(x[:, 0], 0.2, 5.0)
    return replace(
        start,
        torque_constant=constant,
        armature=np.clip(x[:, 1] * constant, 3e-4, 3e-2),
        damping=np.clip(x[:, 2] * constant, 3e-3, 1.0),
        frictionloss=np.clip(x[:, 3] * constant, 5e-4, 0.2),
        stiction=np.full(len(constant), 1.02),
        bristle=GIVES[best],
    )


def friction_side(velocity: Array, bristle: Vector, period: float) -> Array:
    """Which way dry friction acts, and what share of it, (k, n), by joint speeds, rad/s; `bristle`, (n,), rad: of
    joints whose friction gives far before it slides, 0 of others."""
    side = np.tanh(velocity / STILL)
    if not bristle.any():
        return np.asarray(side)
    ones, far = np.ones(len(bristle)), np.where(bristle > 0.0, bristle, 1.0)
    share = followed_deflection(ones, ones, far, velocity, period) / far
    return np.where(bristle > 0.0, share, side)


def _link_torques(motion: RecordedMotion, player: OpenLoopPlayer, mass_scale: Vector) -> tuple[SmoothedMotion, Array]:
    """The smoothed motion, and the torque that its links take, (k, n), N·m."""
    smooth = smooth_motion(motion)
    player.links_only(mass_scale, motion.weight)
    torque = [player.link_torque(*row, motion.gravity) for row in zip(*smooth, strict=True)]
    return smooth, np.array(torque)


def _solve(
    motions: list[RecordedMotion],
    parts: list[tuple[SmoothedMotion, Array]],
    delay: float,
    stribeck: float = 0.0,
    give: float = 0.0,
) -> tuple[Array, Vector]:
    """[1/k, A/k, B/k, F/k] of every joint, (n, 4), and the unexplained share, (n,); with a Stribeck speed [1/k, A/k,
    B/k, F/k, (F_s - F)/k, load friction], (n, 6). `give`: how far friction gives before it slides, rad."""
    n = motions[0].spec.n_joints
    solved, left = np.zeros((n, 6 if stribeck else 4)), np.zeros(n)
    late = [low_pass(shifted_duty(m.duty, delay / m.period), m.period, BAND) for m in motions]
    sides = [
        friction_side(part.velocity, np.full(n, give), m.period) for m, (part, _) in zip(motions, parts, strict=True)
    ]
    for joint in range(n):
        rows, right = [], []
        for motion, (smooth, torque), duty, ways in zip(motions, parts, late, sides, strict=True):
            v, side = smooth.velocity[:, joint], ways[:, joint]
            terms = [torque[:, joint], smooth.acceleration[:, joint], v, side]
            if stribeck:
                terms += [side * np.exp(-np.square(v / stribeck)), side * np.abs(duty[:, joint])]
            columns = np.stack(terms, axis=1)
            kept = (np.abs(v) > STILL) & (motion.good[:, joint] > 0)
            rows.append(low_pass(columns, motion.period, BAND)[kept][::THIN])
            right.append(duty[kept, joint][::THIN])
        a, b = np.concatenate(rows), np.concatenate(right)
        if len(a) < 8:
            solved[joint, :4] = (1.0, 0.003, 0.07, 0.02)
            continue
        found = np.linalg.lstsq(a, b)[0]
        if stribeck:
            found = _solve_near_likely(a, b, float(np.sqrt(np.square(a @ found - b).mean())))
        solved[joint] = found
        left[joint] = np.square(a @ found - b).sum() / max(np.square(b).sum(), 1e-12)
    return solved, left


def _solve_near_likely(a: Array, b: Vector, left: float) -> Vector:
    """Least squares with 1/k and load friction held near likely values: in a distal joint weight, load and friction
    look alike. `left`: root mean square of the unexplained rest."""
    likely, spread, about = np.zeros((2, a.shape[1])), np.array([0.15, LOAD[1]]), np.array([1.0, LOAD[0]])
    likely[[0, 1], [0, 5]] = 1.0
    weight = KIN * left / spread
    rows = np.concatenate([a, likely * weight[:, None]])
    return np.asarray(np.linalg.lstsq(rows, np.concatenate([b, about * weight]))[0])


def shifted_duty(duty: Array, periods: float) -> Array:
    """Duty around each row, (k, n): the mean of the periods before and after it, `periods` earlier."""
    k = len(duty)
    ahead = np.concatenate([duty[1:], duty[-1:]])
    middle = (duty + ahead) / 2.0
    at = np.arange(k) - periods
    return np.stack([np.interp(at, np.arange(k), column) for column in middle.T], axis=1)


def low_pass(values: Array, period: float, cut: float) -> Array:
    b, a = butter(2, cut * 2.0 * period)
    return np.asarray(filtfilt(b, a, values, axis=0))
