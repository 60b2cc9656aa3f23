"""The linear fit: what a drive is, from positions alone, by one regression a joint. A start for the nonlinear one.

    k u = τ(q, v, a) + A a + B v + F sgn(v)

u: fraction of full PWM, k: torque constant, τ: torque that moves the links (known masses), A: armature, B: damping,
F: dry friction. Divided by k it is linear in 1/k, A/k, B/k and F/k. Positions are filtered forwards and backwards, so
that speeds and accelerations are not late; both sides of the equation pass the same filter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import butter, filtfilt  # type: ignore[import-untyped]  # Its types are a package of their own.

from allegro_twin.identify.motion import Motion
from allegro_twin.sim.windows import Parameters, Player
from allegro_twin.types import Array, Vector

SMOOTH, BAND = 18.0, 12.0  # Hz: of positions, and of both sides of the equation.
DELAYS = np.arange(0.0, 0.0125, 0.0005)  # s
STILL = 0.02  # rad/s. Slower than this a joint may stick, and friction has any value.
THIN = 5  # Rows: after the filter they tell the same.


class Smoothed(NamedTuple):
    """A motion without its noise, (k, n) each: rad, rad/s, rad/s²."""

    position: Array
    velocity: Array
    acceleration: Array


def smoothed(motion: Motion) -> Smoothed:
    position = _filtered(motion.position, motion.period, SMOOTH)
    velocity = np.gradient(position, motion.period, axis=0)
    return Smoothed(position, velocity, np.gradient(velocity, motion.period, axis=0))


def regress(motions: list[Motion], player: Player, mass_scale: Vector) -> Parameters:
    """The best straight line for every joint, with one delay for all."""
    parts = [_sides(motion, player, mass_scale) for motion in motions]
    best: tuple[float, float, Array] | None = None
    for delay in DELAYS:
        solved, left = _solved(motions, parts, float(delay))
        if best is None or left < best[0]:
            best = (left, float(delay), solved)
    assert best is not None
    _, delay, x = best
    constant = 1.0 / np.clip(x[:, 0], 0.2, 5.0)
    spec = motions[0].spec
    return Parameters(
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
    )


def _sides(motion: Motion, player: Player, mass_scale: Vector) -> tuple[Smoothed, Array]:
    """The motion, and the torque that its links take, (k, n), N·m."""
    smooth = smoothed(motion)
    player.links_only(mass_scale, motion.weight)
    torque = [player.link_torque(*row, motion.gravity) for row in zip(*smooth, strict=True)]
    return smooth, np.array(torque)


def _solved(motions: list[Motion], parts: list[tuple[Smoothed, Array]], delay: float) -> tuple[Array, float]:
    """[1/k, A/k, B/k, F/k] of every joint, (n, 4), and what is left unexplained."""
    n = motions[0].spec.n_joints
    solved, left = np.zeros((n, 4)), 0.0
    late = [_filtered(_shifted(m.duty, delay / m.period), m.period, BAND) for m in motions]
    for joint in range(n):
        rows, right = [], []
        for motion, (smooth, torque), duty in zip(motions, parts, late, strict=True):
            v = smooth.velocity[:, joint]
            columns = np.stack([torque[:, joint], smooth.acceleration[:, joint], v, np.tanh(v / STILL)], axis=1)
            kept = (np.abs(v) > STILL) & (motion.good[:, joint] > 0)
            rows.append(_filtered(columns, motion.period, BAND)[kept][::THIN])
            right.append(duty[kept, joint][::THIN])
        a, b = np.concatenate(rows), np.concatenate(right)
        if len(a) < 8:
            solved[joint] = (1.0, 0.003, 0.07, 0.02)
            continue
        found = np.linalg.lstsq(a, b)[0]
        solved[joint] = found
        left += float(np.square(a @ found - b).sum() / max(np.square(b).sum(), 1e-12))
    return solved, left


def _shifted(duty: Array, periods: float) -> Array:
    """What acted around each row, (k, n): the mean of the periods before and after it, `periods` earlier."""
    k = len(duty)
    ahead = np.concatenate([duty[1:], duty[-1:]])
    middle = (duty + ahead) / 2.0
    at = np.arange(k) - periods
    return np.stack([np.interp(at, np.arange(k), column) for column in middle.T], axis=1)


def _filtered(values: Array, period: float, cut: float) -> Array:
    b, a = butter(2, cut * 2.0 * period)
    return np.asarray(filtfilt(b, a, values, axis=0))
