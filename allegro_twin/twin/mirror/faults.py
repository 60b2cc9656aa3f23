"""Faults of a hand: names, texts, and direct checks (encoder jump, stuck joint, hot motor) on a window of 1.5 s."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

FaultName: TypeAlias = Literal[
    "weak", "stuck", "encoder_step", "payload", "friction", "hot", "wrong_file", "encoder_drift", "loose", "slip",
    "silent", "supply",
]  # fmt: skip
NAMES: tuple[FaultName, ...] = (
    "weak", "stuck", "encoder_step", "payload", "friction", "hot", "wrong_file", "encoder_drift", "loose", "slip",
    "silent", "supply",
)  # fmt: skip
KNOWN = 0.2
"""Share by which the size of a named fault may be wrong. Ours: sizes of 24 faults were right to 0.11."""
ROW = 10
"""Periods that are averaged to a row of a window."""
MOVING = 0.03  # rad/s
FOLLOWS, TAKES = 0.9, 0.3
"""A stuck joint: correlation of disturbance and torque, and share of the torque that the disturbance cancels. Of 80 on
hands 40-44 and 200-209: 0.96 and more, 0.4 to 1.1."""
JUMP = 0.01  # rad in a period, an acceleration to 3.3 rad/s at once: no joint moves so.
STILL, PUSHED = 0.003, 0.03  # rad that a stuck joint moves at most; N·m that its motor must push in the mean.
CREPT, HARD = 0.02, 0.3
"""rad that a joint whose motor is dead creeps at most in soft friction, and the share of its motor's limit by which its
torque then must change. Ours: 16 mrad with joints of plain MuJoCo."""
CANCELS = (0.95, 0.7)
"""As FOLLOWS and TAKES, for a joint that creeps, or that a finger holds."""
WAYS = 0.25
"""Share of its motor's limit that a still joint resists both ways, though its finger holds something: an object only
pushes. A fingertip between a thumb and an object that is turned over resists 0.3 of it, and moves by 18 mrad."""
YIELDS = 0.9
"""Correlation of a still joint's torque with its displacement against it, from which its own loop makes the torque:
something pushes the joint, and it follows. That of a stuck joint follows targets."""
SINGLE = 0.9  # Share of a finger's squares on one joint: a contact pushes the joints before it, too.
BLOCKED = (0.1, 0.7)
"""A joint that something blocks: the share of its motor's limit with which it is pushed while it rests, and the share
of its torque that the disturbance cancels. Ours: in ten motions of five hands with the files of others one finger at
most looks so."""
HOT = 70.0  # °C. From here on the manufacturer's driver throttles; docs/reference/can_protocol.md.


class MirrorWindow(NamedTuple):
    """k rows of a mirror, each the mean over ROW periods."""

    disturbance: Array
    """(k, n), N·m."""
    torque: Array
    """Torque of the motors by the mirror's file, (k, n), N·m."""
    velocity: Array
    """(k, n), rad/s."""
    side: Array
    """Side to which friction acts, (k, n), as in `Estimate`: -1 to 1, or more where it breaks away."""
    position: Array
    """(k, n), rad."""
    jump: Array
    """The largest difference of reported and expected position in a row's periods, with its sign, (k, n), rad; 0 where
    it was small or the joint did not accelerate suddenly."""
    pull: Array
    """Torque on each joint of a kilogram at each link's centre of mass, (k, links, n), N·m."""
    temperature: Array
    """(k, n), °C; NaN where unknown."""
    holds: NDArray[np.bool_]
    """Fingers that rest and press on something, (k, fingers)."""
    known: Array = frozen([[0.0]])
    """Disturbances that named faults made before a mirror's model had them, (k, n), N·m: KNOWN of these may remain."""
    weight: Vector = frozen([1.0])
    """By which disturbances, and all that explains them, are multiplied before they are compared, (n,): 1 where a
    joint's file fits, less where free motion leaves more than noise."""


class Fault(NamedTuple):
    """A fault of the hand."""

    name: FaultName
    joint: int
    """The joint; the first that was found for a fault of the whole hand."""
    amount: float
    """Missing share of a motor's torque, or of all motors'; friction, N·m; payload, kg; encoder step, rad; temperature,
    °C; drift, rad/s; a slip's lost share of the push; a wrong file's number of fingers; a silent joint's time without a
    report, s."""
    lead: float = np.inf
    """Squares, in those that remain per row, by which the next likely fault or joint falls short."""
    gain: float = np.inf
    """Squares of disturbances that the fault explains, N²m²; infinite for direct checks."""


class FaultReport(NamedTuple):
    """A fault that was named."""

    fault: Fault
    begin: float
    """When it first showed, s: a fault of a joint that does not move shows later than it comes. A joint that is stuck:
    since when it has not moved; a jump: when it came."""
    named: float
    """Time when it was named, s."""
    ended: float = np.inf
    """When the name was withdrawn, or what it says was over, s; infinite while it holds."""


def report_text(report: FaultReport, spec: HandSpec) -> str:
    """The fault with its times as a sentence."""
    text = f"{fault_text(report.fault, spec)} (since {report.begin:.2f} s, named at {report.named:.2f} s)"
    if report.ended == np.inf:
        return text
    over = {
        "silent": "reports again", "stuck": "moves again", "encoder_step": "jumped back", "slip": "over",
        "supply": "whole again",
    }  # fmt: skip
    return f"{text}; {over.get(report.fault.name, 'withdrawn')} at {report.ended:.2f} s"


def fault_text(found: Fault, spec: HandSpec) -> str:
    """The fault as a sentence."""
    joint = spec.joint_labels[found.joint]
    match found.name:
        case "weak":
            return f"the motor of {joint} gives {100 * (1 - found.amount):.0f} % of its torque"
        case "stuck":
            return f"{joint} does not follow its motor: it is stuck, its motor is dead, or its encoder repeats a value"
        case "encoder_step":
            return f"the encoder of {joint} jumped by {1000 * found.amount:+.0f} mrad"
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
        case "supply":
            return f"all motors give {100 * (1 - found.amount):.0f} % of their torque: is the supply low?"
        case "silent":
            return f"{joint} reports nothing"
        case "wrong_file":
            return "the file is of another hand, or of this one long ago: identify it again"


def direct_faults(window: MirrorWindow, spec: HandSpec) -> list[Fault]:
    """Faults that are visible without shapes."""
    found = [
        Fault("hot", int(joint), float(window.temperature[-1, joint]))
        for joint in np.flatnonzero(np.nan_to_num(window.temperature[-1]) > HOT)
    ]
    largest = window.jump[np.abs(window.jump).argmax(axis=0), np.arange(spec.n_joints)]
    found += [
        Fault("encoder_step", int(joint), float(largest[joint])) for joint in np.flatnonzero(np.abs(largest) > JUMP)
    ]
    push = np.abs(window.disturbance).max(axis=0)
    found += [Fault("stuck", joint, float(push[joint])) for joint in _stuck(window, spec)]
    return found


def holds_object(window: MirrorWindow) -> bool:
    """Whether several fingers press on something: no single joint's fault does that, and a touched finger's own
    disturbances are unknown."""
    return int(window.holds.any(axis=0).sum()) > 1


def blocked_fingers(window: MirrorWindow, spec: HandSpec) -> NDArray[np.bool_]:
    """Fingers of which a motor pushes a joint that rests, against something, in most rows, (fingers,): others of its
    joints may move, as in a hand that closes on an object."""
    torque, pushes = np.abs(window.torque), BLOCKED[0] * spec.actuation.torque_limit
    against = -window.disturbance * np.sign(window.torque) > BLOCKED[1] * torque
    blocked = (np.abs(window.velocity) < MOVING) & (torque > pushes) & against
    most = blocked.mean(axis=0) > 0.5
    return np.array([most[list(finger.joints)].any() for finger in spec.fingers])


def finger_share(window: MirrorWindow, spec: HandSpec) -> Vector:
    """Each joint's share of the squares of its finger's disturbances, (n,)."""
    square, share = np.square(window.weight * window.disturbance).sum(axis=0), np.zeros(spec.n_joints)
    for finger in spec.fingers:
        own = list(finger.joints)
        share[own] = square[own] / max(float(square[own].sum()), 1e-12)
    return share


def still_joints(window: MirrorWindow) -> NDArray[np.bool_]:
    """Joints that do not move, (n,)."""
    return np.asarray(np.ptp(window.position, axis=0) < STILL)


def _stuck(window: MirrorWindow, spec: HandSpec) -> list[int]:
    """Joints that do not move, or creep, and whose disturbance cancels their motor's torque. A joint that friction
    holds in both hand and mirror has no such disturbance; what fingers hold may make one, but only one way. What pushes
    a joint makes one too, with a torque that follows the joint's displacement."""
    push, torque = np.abs(window.disturbance).mean(axis=0), window.torque - window.torque.mean(axis=0)
    d, changes = window.disturbance - window.disturbance.mean(axis=0), np.ptp(window.torque, axis=0)
    along, size, limit = (d * torque).sum(axis=0), np.square(torque).sum(axis=0), spec.actuation.torque_limit

    def cancels(follows: float, takes: float) -> NDArray[np.bool_]:
        return np.asarray(along < -np.maximum(follows * np.sqrt(size * np.square(d).sum(axis=0)), takes * size))

    displaced = window.position - window.position.mean(axis=0)
    yields = (displaced * torque).sum(axis=0) < -YIELDS * np.sqrt(size * np.square(displaced).sum(axis=0))
    motionless = still_joints(window)
    still = motionless & cancels(FOLLOWS, TAKES) & (changes > PUSHED)
    slow = (np.ptp(window.position, axis=0) < CREPT) & cancels(*CANCELS)
    alone = (finger_share(window, spec) > SINGLE) & (not holds_object(window))
    least = np.minimum(window.disturbance.max(axis=0), -window.disturbance.min(axis=0))
    found = (alone & (still | (slow & (changes > HARD * limit)))) | (slow & motionless & (least > WAYS * limit))
    return [int(joint) for joint in np.flatnonzero(found & ~yields & (push > PUSHED))]
