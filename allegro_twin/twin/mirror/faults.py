"""What is wrong with a hand, by name, and what of it is seen directly: an encoder that jumps, a joint that stays where
its motor pushes, a hot motor. Pure functions of a second and a half of what its mirror saw."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

Name: TypeAlias = Literal[
    "weak", "stuck", "encoder_step", "payload", "friction", "hot", "wrong_file", "encoder_drift", "loose", "slip"
]  # fmt: skip
NAMES: tuple[Name, ...] = (
    "weak", "stuck", "encoder_step", "payload", "friction", "hot", "wrong_file", "encoder_drift", "loose", "slip",
)  # fmt: skip
ROW = 10
"""Periods whose means make a row of a window."""
MOVING = 0.03  # rad/s
CREEP = 0.02  # rad/s over which friction turns round.
FOLLOWS, TAKES = 0.9, 0.3
"""Of a joint that is stuck: correlation of disturbance and torque, and how much of the torque the disturbance takes
back. Of 80 on hands 40-44 and 200-209: 0.96 and more, 0.4 to 1.1."""
JUMP = 0.01  # rad in a period, 3.3 rad/s out of nothing: no joint moves so.
STILL, PUSHED = 0.003, 0.03  # rad that a stuck joint moves at most; N·m that its motor must push in the mean.
SINGLE = 0.9  # Of a finger's squares that the joint has: what touches a finger pushes the joints before it, too.
HOT = 70.0  # °C. The manufacturer's driver throttles from there on; docs/protocol.md.


class Window(NamedTuple):
    """Rows of a mirror, k of them, in the mean over ROW periods each."""

    disturbance: Array
    """(k, n), N·m."""
    torque: Array
    """Of the motors, as the mirror's file says, (k, n), N·m."""
    velocity: Array
    """(k, n), rad/s."""
    side: Array
    """To which side friction acts, (k, n), tanh(speed / CREEP) of every period, times how much it is over that in fast
    motion: -1 to 1, or more where it breaks away."""
    position: Array
    """(k, n), rad."""
    jump: Array
    """The largest difference of what was reported and expected in a row's periods, (k, n), rad; 0 where it was small or
    the joint did not go faster all at once."""
    pull: Array
    """What a kilogram at each link's centre of mass would weigh on each joint, (k, links, n), N·m."""
    temperature: Array
    """(k, n), °C; NaN where it is not known."""
    holds: NDArray[np.bool_]
    """Fingers that rest and press on something, (k, fingers)."""


class Anomaly(NamedTuple):
    """Something that is wrong."""

    name: Name
    joint: int
    """Which; the first that is found where it is of the whole hand."""
    amount: float
    """Missing share of a motor, N·m of friction, kg, rad, °C, rad/s; of a slip what share of a push is gone; of a file
    how many fingers."""
    lead: float = np.inf
    """By how many squares of what is left over in a row the next likely explanation falls short: of fault and joint."""
    gain: float = np.inf
    """Squares of disturbances that it takes away, N²m²; infinite where it is seen directly."""


def words(found: Anomaly, spec: HandSpec) -> str:
    """For a person."""
    joint = spec.joint_labels[found.joint]
    match found.name:
        case "weak":
            return f"the motor of {joint} gives {100 * (1 - found.amount):.0f} % of its torque"
        case "stuck":
            return f"{joint} is stuck"
        case "encoder_step":
            return f"the encoder of {joint} jumped by {1000 * found.amount:.0f} mrad"
        case "payload":
            return f"{joint} carries {1000 * found.amount:.0f} g too much"
        case "friction":
            return f"{joint} has {1000 * found.amount:.0f} mN·m of friction too much"
        case "hot":
            return f"the motor of {joint} is at {found.amount:.0f} °C"
        case "encoder_drift":
            return f"the encoder of {joint} drifts by {60000 * found.amount:+.0f} mrad a minute"
        case "loose":
            return f"the link of {joint} is loose: it fell, {1000 * found.amount:.0f} mrad off what was expected"
        case "slip":
            return f"what the hand holds slips: {joint} lost {100 * found.amount:.0f} % of what pressed on it"
        case "wrong_file":
            return "the file is of another hand, or of this one long ago: identify it again"


def direct(window: Window, spec: HandSpec) -> Anomaly | None:
    """What is seen without any shape, or None."""
    hot = np.argwhere(np.nan_to_num(window.temperature[-1:]) > HOT)
    if len(hot):
        joint = int(hot[0][1])
        return Anomaly("hot", joint, float(window.temperature[-1, joint]))
    if window.jump.max() > JUMP:
        joint = int(window.jump.max(axis=0).argmax())
        return Anomaly("encoder_step", joint, float(window.jump[:, joint].max()))
    stuck = None if holding(window) else _stuck(window, spec)
    return None if stuck is None else Anomaly("stuck", stuck, float(np.abs(window.disturbance[:, stuck]).max()))


def holding(window: Window) -> bool:
    """Whether several fingers pressed on something: no single joint's fault does that, and of a finger that something
    touches nobody knows what is its own."""
    return int(window.holds.any(axis=0).sum()) > 1


def alone(window: Window, spec: HandSpec) -> Vector:
    """Each joint's share of the squares of its finger's disturbances, (n,)."""
    square, share = np.square(window.disturbance).sum(axis=0), np.zeros(spec.n_joints)
    for finger in spec.fingers:
        own = list(finger.joints)
        share[own] = square[own] / max(float(square[own].sum()), 1e-12)
    return share


def still(window: Window) -> NDArray[np.bool_]:
    """Which joints stay, (n,)."""
    return np.asarray(np.ptp(window.position, axis=0) < STILL)


def _stuck(window: Window, spec: HandSpec) -> int | None:
    """A joint that stays, and whose disturbance takes back what its motor does: of one that friction holds in hand and
    mirror alike it stays as it is."""
    push, torque = np.abs(window.disturbance).mean(axis=0), window.torque - window.torque.mean(axis=0)
    d = window.disturbance - window.disturbance.mean(axis=0)
    along, size = (d * torque).sum(axis=0), np.square(torque).sum(axis=0)
    follows = along < -np.maximum(FOLLOWS * np.sqrt(size * np.square(d).sum(axis=0)), TAKES * size)
    held = still(window) & (push > PUSHED) & (np.ptp(window.torque, axis=0) > PUSHED)
    found = np.flatnonzero(held & follows & (alone(window, spec) > SINGLE))
    return int(found[push[found].argmax()]) if len(found) else None
