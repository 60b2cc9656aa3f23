"""Touches, from disturbances: pure functions of what an observer estimated.

A push on a fingertip is felt by several joints at once, each a little. So a finger is touched where the disturbances of
its joints leave an ellipsoid, Σ (d / above)² > 1, whose axes have the proportions of what free motions disturb; its
size is where the largest of a block of free motion (1 s) would be once in RARE blocks, by Gumbel's law of extremes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

SETTLED = 1.0  # s until an observer that began somewhere has forgotten it.
BLOCK = 1.0  # s
RARE = 10 * 3600.0  # Blocks: a false alarm of a finger in 10 hours, of a hand in two and a half.
LEAST = 0.004  # N·m. No axis is shorter: the noise of encoders alone makes 2 mN·m.
PERIODS = 2  # In a row that are outside.
EULER = 0.5772  # Of Gumbel's law: its mean is the mode and as many scales.


class Contact(NamedTuple):
    """A touch of one finger."""

    finger: str
    begin: float
    """s"""
    end: float
    """s; that of the motion where it is still touched then."""
    torque: float
    """The largest, of any of its joints, N·m."""


def thresholds(free: Array, period: float, spec: HandSpec) -> Vector:
    """The axes of every finger's ellipsoid, (n,), N·m, from the disturbances (k, n), N·m, of a motion that touches
    nothing. Raises ConfigError where it is too short to tell."""
    first, block = round(SETTLED / period), round(BLOCK / period)
    if len(free) < 4 * first:
        raise ConfigError(f"a free motion of {len(free) * period:.1f} s says too little: at least {4 * SETTLED:g} s")
    free = free[first : first + (len(free) - first) // block * block]
    usual = np.maximum(np.sqrt(np.square(free).mean(axis=0)), 1e-6)
    above = np.empty(spec.n_joints)
    for finger in spec.fingers:
        own = list(finger.joints)
        # Squares of normal noise have an exponential tail, to which Gumbel's law belongs.
        largest = np.square(pushed(free, usual, spec, own)).reshape(-1, block).max(axis=1)
        scale = np.sqrt(6.0) / np.pi * largest.std()
        rare = largest.mean() + scale * (np.log(RARE) - EULER)
        above[own] = np.sqrt(max(rare, float(largest.max()))) * usual[own]
    return np.maximum(above, LEAST)


def pushed(disturbance: Array, above: Vector, spec: HandSpec, joints: Sequence[int] | None = None) -> Array:
    """How far outside its ellipsoid each finger is, 1 on it, (k, fingers); of some joints together, (k,)."""
    share = np.square(disturbance / above)
    if joints is not None:
        return np.asarray(np.sqrt(share[..., list(joints)].sum(axis=-1)))
    sums = [share[..., list(finger.joints)].sum(axis=-1) for finger in spec.fingers]
    return np.asarray(np.sqrt(np.stack(sums, axis=-1)))


def touched(disturbance: Array, above: Vector, spec: HandSpec) -> Array:
    """Whether each finger is touched, (k, fingers): it was outside its ellipsoid in PERIODS periods up to now."""
    over = pushed(disturbance, above, spec) > 1.0
    held = over.copy()
    for back in range(1, PERIODS):
        held[back:] &= over[:-back]
        held[:back] = False
    return np.asarray(held)


def contacts(t: Vector, disturbance: Array, above: Vector, spec: HandSpec, pause: float = 0.1) -> Sequence[Contact]:
    """All touches, in order; one that comes back within `pause`, s, has not ended."""
    found, flags = [], touched(disturbance, above, spec)
    flags[t < t[0] + SETTLED] = False
    for number, finger in enumerate(spec.fingers):
        rows = np.flatnonzero(flags[:, number])
        if not len(rows):
            continue
        breaks = np.flatnonzero(np.diff(t[rows]) > pause)
        for part in np.split(rows, breaks + 1):
            torque = np.abs(disturbance[part[0] : part[-1] + 1, list(finger.joints)]).max()
            found.append(Contact(finger.name, float(t[part[0]]), float(t[part[-1]]), float(torque)))
    return sorted(found, key=lambda contact: contact.begin)
