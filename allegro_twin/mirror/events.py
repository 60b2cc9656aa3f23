"""Touches, from disturbances: pure functions of what an observer estimated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

SETTLED = 1.0  # s until an observer that began somewhere has forgotten it.
MARGIN = 1.3  # Above the largest disturbance of a free motion.
LEAST = 0.005  # N·m. Below it no threshold goes: the noise of encoders alone makes 2 mN·m.
PERIODS = 2  # In a row that are above the threshold.


class Contact(NamedTuple):
    """A touch of one finger."""

    finger: str
    begin: float
    """s"""
    end: float
    """s; that of the motion where it is still touched then."""
    torque: float
    """The largest, of any of its joints, N·m."""


def thresholds(free: Array, period: float) -> Vector:
    """What disturbances (k, n), N·m, of a motion that touches nothing never reach, (n,). Raises ConfigError where it is
    too short to tell."""
    first = round(SETTLED / period)
    if len(free) < 4 * first:
        raise ConfigError(f"a free motion of {len(free) * period:.1f} s says too little: at least {4 * SETTLED:g} s")
    return np.asarray(np.maximum(MARGIN * np.abs(free[first:]).max(axis=0), LEAST))


def touched(disturbance: Array, above: Vector, spec: HandSpec) -> Array:
    """Whether each finger is touched, (k, fingers): a joint of it was above its threshold in PERIODS periods up to
    now."""
    over = np.abs(disturbance) > above
    held = over.copy()
    for back in range(1, PERIODS):
        held[back:] &= over[:-back]
        held[:back] = False
    return np.stack([held[:, list(finger.joints)].any(axis=1) for finger in spec.fingers], axis=1)


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
