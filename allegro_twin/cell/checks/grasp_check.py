"""Grasp check: force (weight), torque, fingers and camera against their thresholds, and the verdict. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.checks.camera_check import CameraCheck
from allegro_twin.cell.motion.empty_grasp import EmptyGrasp
from allegro_twin.cell.settings import GraspCheckSettings
from allegro_twin.cell.states import CellOutcome, Observation
from allegro_twin.types import Array, Vector

_GRAVITY = 9.81  # m/s².
_LIGHT = 120.0  # kg/m³ of its box: YCB's fruits of plastic have 120 to 150, an orange of 73 mm 47 g.
_CHANCE = 3.0  # Standard deviations of a weight: one empty hand in 740 weighs more by chance.
_PART = 0.1  # Of the pressure: a finger that gives less does not count as one that presses.
NOTHING = 0.25
"""Share of the torque threshold below which nothing is between the fingers. Up to the threshold the fingers cannot
tell: fingers that touch each other are left out, and the others may hardly press."""


@dataclass(frozen=True, slots=True)
class GraspCheck:
    """Results of the checks by force, torques, joint positions and camera."""

    weight: float
    """Weight on the hand, kg."""
    least: float
    """Less than this the force sensor cannot tell, kg."""
    torque: float
    """That stops the fingers, summed over the joints, N·m."""
    between: float
    """Beyond what stops them around nothing, by where the fingers are, summed over the joints, N·m."""
    by_force: bool | None
    """None: less than the sensor can tell."""
    by_torque: bool
    by_fingers: bool | None
    """None: more than around nothing, and less than says that something is there."""
    by_camera: bool | None
    """None: arm or hand hide the object, or no picture came."""
    held: bool | None
    """By the one of the checks that decides; None where the fingers decide and cannot tell."""
    warning: str = ""
    """Why the force sensor is not to be trusted; nothing where it is."""


def tare_samples(size: Vector, settings: GraspCheckSettings) -> int:
    """Samples before the approach to a solid of a size, (3,), m: more where `samples` may not tell it."""
    light = _LIGHT * float(np.prod(size)) < settings.least
    return max(settings.tare, settings.samples) if light else settings.samples


def detectable_weight(before: int, after: int, settings: GraspCheckSettings) -> float:
    """The weight that so many samples before and after can tell from none, kg: less than `settings.least` only where it
    was weighed for long."""
    if after < settings.long:
        return settings.least
    noise = settings.noise * float(np.sqrt(1.0 / before + 1.0 / after))
    return min(settings.least, _CHANCE * noise / _GRAVITY)


def check_grasp(
    weight: float, least: float, torque: float, between: float, sight: CameraCheck, settings: GraspCheckSettings
) -> GraspCheck:
    """The verdicts of all four; `least`: the weight that can be told, kg."""
    force = True if weight > least else None
    press = torque > settings.torque
    there = None if NOTHING * settings.torque < between <= settings.torque else between > settings.torque
    held = {"force": force is True, "torque": press, "fingers": there}[settings.by]
    return GraspCheck(weight, least, torque, between, force, press, there, sight.held, held)


def weigh(before: Sequence[Vector], after: Sequence[Vector], axes: Array) -> float:
    """Weight, kg, from wrenches of the flange at rest, (6,) each, the tool's own taken away; `axes` are the flange's,
    (3, 3).

    The mean of those before is the tare: only what came on between is weighed.
    """
    return float(-(axes @ added_force(before, after))[2] / _GRAVITY)


def added_force(before: Sequence[Vector], after: Sequence[Vector]) -> Vector:
    """The force that is felt after and was not before, in the flange's axes, (3,), N."""
    return np.asarray((np.mean(after, axis=0) - np.mean(before, axis=0))[:3])


def stopping_torque(torque: Vector, gravity: Vector, friction: Vector) -> float:
    """What the motors give, (n,), beyond the fingers' own weight and twice their dry friction, summed, N·m."""
    return float(np.maximum(np.abs(torque - gravity) - 2.0 * friction, 0.0).sum())


def pressing_torque(position: Vector, torque: Vector, empty: EmptyGrasp, stiffness: Vector, friction: Vector) -> Vector:
    """What keeps each joint from where it would be around nothing, beyond twice its dry friction, (n,), N·m.

    The least of k |q_nothing - q| and of the `torque` that pushes it there, (n,), N·m, gravity taken away: without
    torque nothing is pressed, and never more than the motor gives. A torque that is not reported (NaN) bounds nothing.
    `stiffness`, N·m/rad, is that of the fingers' controller.
    """
    distance = empty.position - position
    given = np.where(np.isnan(torque), np.inf, torque * np.sign(distance))
    return np.asarray(np.maximum(np.minimum(stiffness * np.abs(distance), given) - 2.0 * friction, 0.0))


def torque_between_fingers(press: Vector, empty: EmptyGrasp, meeting: NDArray[np.bool_]) -> float:
    """What the telling fingers press with, summed over the joints, N·m. Fingers that are `meeting` each other, (n,), do
    not tell; where no other is left, all that would."""
    alone = empty.telling & ~meeting
    return float(press[alone if alone.any() else empty.telling].sum())


def presses_surely(
    press: Array, empty: EmptyGrasp, meeting: NDArray[np.bool_], fingers: Sequence[Sequence[int]], least: float
) -> bool:
    """Whether the fingers press on something, whichever joint is stuck or misread, in each of k ways in which the
    hand may be misread: two of them press, and more than `least`, N·m, is left without those that may touch each other.
    `press`, N·m, and `meeting`, (k, n), are those of each way: a joint at its own stop, read a little short of it,
    presses on nothing. `fingers`: the joints of each."""
    telling = np.where(empty.telling, press, 0.0)
    parts = np.stack([telling[:, list(joints)].sum(axis=1) for joints in fingers])
    two = (parts > _PART * telling.sum(axis=1)).sum(axis=0) >= 2
    return bool((two & (np.where(meeting, 0.0, telling).sum(axis=1) > least)).all())


def may_weigh_more(found: GraspCheck, sight: CameraCheck) -> bool:
    """Whether a finer weight would make it held: the fingers cannot tell, are stopped, and the camera sees it."""
    return found.by_fingers is None and found.by_torque and sight.there and not sight.left and not found.by_force


def grasp_verdict(
    t: float, found: GraspCheck, sight: CameraCheck, sure: Callable[[], bool], settings: GraspCheckSettings, *,
    again: bool = False,
) -> Observation:  # fmt: skip
    """What the state machine hears. `again`: it was held by the check before this one.

    Held is what the deciding check says and no other denies, and what something beside the hand's own joints confirms:
    weight, or the camera that sees it in the hand. What is too light to be weighed and hidden by the hand is confirmed
    by fingers that press for `sure`, once a new picture does not show it on the table. Where the fingers cannot tell,
    it takes weight and camera both, the first time, and torque. What left a part of itself behind is confirmed by a
    weight that is not doubted or by the camera. A fault where the force sensor decides and is doubted, and where checks
    disagree or nothing confirms.

    What the camera sees on the table is a miss, and seems to be in the hand besides where torques stop the fingers, and
    they do not say that it is empty, and weight says that it is not, or they do and some of its place is seen empty.
    """
    if found.warning and settings.by == "force":
        return Observation(t, fault=CellOutcome("fault", "force sensor", found.warning))
    weighed = found.by_force is True and not found.warning
    confirmed = (weighed or sight.there) if again else (weighed and sight.there)
    unsure = found.by_fingers is None and found.by_torque and found.held is not False and not sight.left
    held = Observation(t, held=True, warning="; ".join(filter(None, (sight.behind, found.warning))))
    if unsure and confirmed:
        return held
    if sight.left or not (found.held or (unsure and again)):
        loaded = found.by_force is True or sight.there or sight.gone
        if sight.left:
            pressed = found.by_torque and found.by_fingers is not False
            loaded = pressed and (found.by_force is True or (found.by_fingers is True and sight.incomplete))
        little = ""
        if found.held is None:
            little = (
                f"the fingers cannot tell whether it was: {found.between:.2f} N·m are between them, and more than "
                f"{settings.torque:.2f} say yes"
            )
        return Observation(
            t, held=False, loaded=loaded, warning="; ".join(filter(None, (sight.left, little, found.warning)))
        )
    denied = [
        f"{name} {'cannot tell' if word is None else 'say no'}"
        for name, word in (("torques", found.by_torque), ("fingers", found.by_fingers))
        if not word and not (unsure and again)
    ]
    if denied:
        said = (
            f"by {settings.by} it is held, {' and '.join(denied)}: {found.torque:.2f} N·m stop the fingers, of which "
        )
        said += f"{found.between:.2f} N·m press on something; see what the fingers do before the hand is opened"
        return Observation(t, fault=CellOutcome("fault", "checks disagree", said))
    alone = not sight.behind and (found.by_force is True or (sight.fresh and sure()))
    if unsure or not (weighed or found.by_camera or alone):
        said = (
            f"the fingers press with {found.between:.2f} N·m, and nothing confirms that on an object: it weighs "
            f"{1e3 * found.weight:.0f} g of the {1e3 * found.least:.0f} g that can be told, and {sight.hidden}; see "
            "what is in the hand before it is opened"
        )
        return Observation(t, fault=CellOutcome("fault", "not confirmed", said))
    return held
