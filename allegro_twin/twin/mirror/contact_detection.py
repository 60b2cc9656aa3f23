"""Contact detection from disturbance torques: pure functions of what an observer estimated.

A push on a fingertip disturbs several joints at once, each a little. So a finger is touched where the disturbances of
its joints leave an ellipsoid, Σ (d / above)² > 1. Its axes have the proportions of the disturbances in free motion. Its
size is what the largest value of a block of free motion (1 s) reaches once in RARE blocks, by Gumbel's law of extremes.
Joints at rest have axes of their own: friction that breaks away holds a torque there that no mirror can know, in every
joint of a finger at once, so what it may hold in each is taken away first (`beyond_friction`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.sim.observer.observer import REST
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

SETTLED = 1.0  # s until an observer has forgotten where it began.
BLOCK = 1.0  # s
RARE = 10 * 3600.0  # Blocks: one false alarm of a finger in 10 hours, of a hand in two and a half.
FREED = 0.1  # s for which a joint has been faster than REST before it counts as moving.
FEWEST = 4  # Blocks' worth of rows that are needed for joints at rest, or moving.
LEAST = 0.004  # N·m. No axis is shorter: encoder noise alone makes 2 mN·m.
PERIODS = 2  # Successive periods outside the ellipsoid.
MISFIT = 3.0
"""Standard deviations by which friction may be off in a joint at rest, where a free motion shows that it is off."""
PAUSE = 0.06
"""s inside the ellipsoid after which a contact has ended. Ours: twice the time in which a weak push is noticed."""
NOTHING = frozen([0.0])
EULER = 0.5772  # Gumbel's law: its mean is the mode plus this many scales.


class Contact(NamedTuple):
    """A touch of one finger."""

    finger: str
    begin: float
    """Time when it began, s."""
    end: float
    """s; the end of the motion where the touch lasts until then."""
    torque: float
    """The largest disturbance of any of the finger's joints, N·m."""
    joint: int
    """The outermost joint that is pushed beyond its own axis: the contact is on the link that this joint moves, or
    further out. -1 where no single joint is pushed enough to tell."""


class MovingJoints:
    """Tells which joints have been moving for a while. Friction of a joint at rest is different: it holds any
    torque."""

    def __init__(self, n: int, period: float) -> None:
        self._since, self._period = np.zeros(n), period

    def __call__(self, velocity: Vector) -> NDArray[np.bool_]:
        """Which joints move, after another period at these speeds, (n,), rad/s."""
        self._since = np.where(np.abs(velocity) > REST, self._since + self._period, 0.0)
        return np.asarray(self._since > FREED)


class ContactTimer:
    """Tells which fingers are in contact: from PERIODS outside their ellipsoids on, until PAUSE inside."""

    def __init__(self, fingers: int, period: float) -> None:
        self._over, self._left, self._period = np.zeros(fingers, dtype=int), np.zeros(fingers), period

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Fingers in contact, (fingers,)."""
        return np.asarray(self._left > 0.0)

    def add(self, outside: NDArray[np.bool_]) -> None:
        """Add a period in which fingers were outside their ellipsoids, (fingers,)."""
        self._over = np.where(outside, self._over + 1, 0)
        self._left = np.where(self._over >= PERIODS, PAUSE, self._left - self._period)


def joint_thresholds(above: Array, moving: NDArray[np.bool_]) -> Array:
    """Select from thresholds (2, n) those of joints at rest or moving, (n,) or (k, n), N·m."""
    return np.asarray(np.where(moving, above[1], above[0]))


def contact_thresholds(free: Array, moving: NDArray[np.bool_], held: Vector, period: float, spec: HandSpec) -> Array:
    """The axes of every finger's ellipsoid, of joints at rest and moving, (2, n), N·m. `free`, `moving`:
    disturbances (k, n), N·m, of a motion without contact, and which joints moved for a while. `held`: torque that
    breakaway friction may hold in a joint at rest, (n,), N·m; less is no contact there. Raises ConfigError for a
    motion that is too short."""
    first, block = round(SETTLED / period), round(BLOCK / period)
    if len(free) < 4 * first:
        raise ConfigError(f"a free motion of {len(free) * period:.1f} s says too little: at least {4 * SETTLED:g} s")
    rows = slice(first, first + (len(free) - first) // block * block)
    held = held_friction(free, moving, held, period)
    free, moving = beyond_friction(free[rows], np.where(moving[rows], 0.0, held)), moving[rows]
    above = np.full((2, spec.n_joints), np.inf)
    for finger in spec.fingers:
        own = list(finger.joints)
        for which, chosen in enumerate((~moving[:, own], moving[:, own])):
            # With too few rows in this state, all rows count.
            kept = np.where(chosen.sum(axis=0) >= FEWEST * block, chosen, True)
            usual = np.sqrt(np.square(free[:, own]).mean(axis=0, where=kept))
            shares = np.where(kept, free[:, own], 0.0) / np.maximum(usual, 1e-6)
            above[which, own] = np.maximum(usual, 1e-6) * np.sqrt(_rare(np.square(shares).sum(axis=1), block))
        above[:, own] = np.maximum(above[:, own], 1e-6)  # Friction may hold all that disturbs a joint at rest.
        both = push_ratio(free, joint_thresholds(above, moving), spec, own)
        above[:, own] *= np.sqrt(max(_rare(np.square(both), block), 1.0))
    above = np.maximum(above, LEAST)
    above[0] = np.where(held > 0.0, held + np.maximum(above[0], above[1]), above[0])
    return np.asarray(above)


def held_friction(free: Array, moving: NDArray[np.bool_], held: Vector, period: float) -> Vector:
    """Torque that friction may hold in each joint at rest, (n,), N·m: as the file has it (`held`), or MISFIT times what
    a free motion disturbs joints at rest by beyond what it disturbs them by in motion. Arguments as of
    `contact_thresholds`."""
    first = round(SETTLED / period)
    free, moving = free[first:], moving[first:]
    fewest = FEWEST * round(BLOCK / period)
    tells = (moving.sum(axis=0) >= fewest) & ((~moving).sum(axis=0) >= fewest)
    square, none = np.square(free), np.zeros(free.shape[1])
    rest, motion = (
        np.divide(np.where(which, square, 0.0).sum(axis=0), which.sum(axis=0), out=none.copy(), where=tells)
        for which in (~moving, moving)
    )
    return np.asarray(np.maximum(held, MISFIT * np.sqrt(np.maximum(rest - motion, 0.0))))


def beyond_friction(disturbance: Array, held: Array) -> Array:
    """Disturbances, (n,) or (k, n), N·m, without what friction may hold of them."""
    return np.asarray(np.sign(disturbance) * np.maximum(np.abs(disturbance) - held, 0.0))


def _rare(squares: Vector, block: int) -> float:
    """The value that is reached once in RARE blocks, at least the largest one here. Squares of normal noise have an
    exponential tail, which leads to Gumbel's law."""
    largest = squares.reshape(-1, block).max(axis=1)
    largest = largest[largest > 0.0] if largest.any() else largest
    rare = largest.mean() + np.sqrt(6.0) / np.pi * largest.std() * (np.log(RARE) - EULER)
    return max(float(rare), float(largest.max()))


def push_ratio(
    disturbance: Array, above: Array, spec: HandSpec, joints: Sequence[int] | None = None, held: Array = NOTHING
) -> Array:
    """Distance of each finger in units of its ellipsoid, 1 on it, (k, fingers); with `joints` of these together, (k,).
    `above`: (n,), or (k, n); `held`: what of it friction may hold in joints at rest, and 0 in moving ones, likewise."""
    share = np.square(beyond_friction(disturbance, held) / (above - held))
    if joints is not None:
        return np.asarray(np.sqrt(share[..., list(joints)].sum(axis=-1)))
    order, starts = _joints_by_finger(spec)
    return np.asarray(np.sqrt(np.add.reduceat(share[..., order], starts, axis=-1)))


@lru_cache(maxsize=16)
def _joints_by_finger(spec: HandSpec) -> tuple[list[int], list[int]]:
    """All fingers' joints, one finger after the other, and where each finger begins among them."""
    counts = [len(finger.joints) for finger in spec.fingers]
    return [joint for finger in spec.fingers for joint in finger.joints], [sum(counts[:k]) for k in range(len(counts))]


def outermost_joint(share: Vector, joints: Sequence[int]) -> int:
    """The last of a finger's joints, counted from the palm, that is pushed beyond its own axis; -1: none. `share`:
    squared disturbances over squared axes, (n,). A push loads only the joints before it, so the contact is on the link
    that this joint moves, or, with a short lever, further out."""
    return max((joint for joint in joints if share[joint] > 1.0), key=list(joints).index, default=-1)


def find_contacts(
    t: Vector, touched: NDArray[np.bool_], disturbance: Array, above: Array, spec: HandSpec
) -> Sequence[Contact]:
    """All contacts, in order, of fingers that were `touched`, (k, fingers). `t`: s, (k,); `disturbance`: N·m, (k, n);
    `above`: contact thresholds, (n,) or (k, n), N·m."""
    found = []
    for number, finger in enumerate(spec.fingers):
        rows, own = np.flatnonzero(touched[:, number]), list(finger.joints)
        for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if not len(part):
                continue
            share = np.broadcast_to(np.square(disturbance / above), disturbance.shape)[part]
            out = np.flatnonzero(share[:, own].sum(axis=1) > 1.0)
            during = slice(None, out[-1] + 1 if len(out) else None)  # The last PAUSE is inside the ellipsoid again.
            torque = float(np.abs(disturbance[part][during][:, own]).max())
            begin, end = float(t[part[0]]), float(t[part[during][-1]])
            joint = outermost_joint(share[during].mean(axis=0), own)
            found.append(Contact(finger.name, begin, end, torque, joint))
    return sorted(found, key=lambda contact: contact.begin)
