"""Findings of an identification as sentences: effects beyond friction, accuracy of prediction, what is not
explained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.fitting.extra_terms import PERIODS, WARM_UPS
from allegro_twin.twin.identify.fitting.fit import DriveFit
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.twin.identify.results.uncertainty import LEFT as LEFT
from allegro_twin.twin.identify.results.uncertainty import IdentifiedValue
from allegro_twin.twin.identify.results.written_drive import BETTER, WrittenDrive
from allegro_twin.types import Array, Vector

_LEAST = {
    "bias_torque": 5e-4,
    "stiffness": 1e-3,
    "uneven_damping": 1e-3,
    "cogging_cosine": 3e-4,
    "cogging_sine": 3e-4,
    "ripple_cosine": 0.01,
    "ripple_sine": 0.01,
    "cold_friction": 0.03,
    "stiction": 0.03,
    "load_friction": 0.005,
}
"""N·m and N·m·s/rad at 1 N·m of full PWM, and shares: less is not worth a sentence."""
SURE = 0.5
"""Half the interval as a share of the value: with more a term is named as no cause."""
TOUCHING = 2
"""Fingers that touch something at once, at most: where more are not explained it is something else."""
FEW = 2
"""Joints with a torque by the angle: one alone may be what something else looks like."""
_SAME = np.radians(0.6)  # Between the leans of recordings that count as one.


def describe(
    found: DriveFit, values: Mapping[str, IdentifiedValue], motions: Sequence[RecordedMotion], written: WrittenDrive
) -> Iterator[str]:
    """All that comes first: joints that did not follow, what the hand has beyond friction, and the outcome."""
    yield from describe_unfollowed(motions)
    yield from describe_terms(found, values, motions, written)
    yield from describe_outcome(found, motions[0].spec, written)


def describe_unfollowed(motions: Sequence[RecordedMotion]) -> Iterator[str]:
    """Joints that did not follow the excitation: nothing of them is written."""
    said = set[int]()
    for motion in motions:
        labels = motion.spec.joint_labels
        for joint, how in motion.unfollowed:
            if joint not in said:
                said.add(joint)
                yield (
                    f"{labels[joint]} did not follow what it was told, and nothing of it is written: {motion.name}, "
                    f"{how}."
                )


def describe_outcome(found: DriveFit, spec: HandSpec, written: WrittenDrive) -> Iterator[str]:
    """How well the hand is predicted, and which joints are not explained."""
    yield describe_prediction(written)
    if worse := describe_worse(written, spec):
        yield worse
    if rest := describe_rest(found, spec):
        yield rest


def describe_terms(
    found: DriveFit, values: Mapping[str, IdentifiedValue], motions: Sequence[RecordedMotion], written: WrittenDrive
) -> Iterator[str]:
    """What the model has beyond Coulomb's friction, and by which shape of what was left over it was found; not what is
    undetermined, what its interval does not tell from half of it, or what nobody notices."""
    drive, labels = found.drive, motions[0].spec.joint_labels
    if found.far:
        size = _up_to(1e3 * drive.bristle, np.ones(len(labels), dtype=bool), labels, "mrad")
        yield f"Friction gives before it slides, by {size}: presliding, as of teeth, belts or seals that bend."
    elif found.bristly:
        yield _describe_breakaway(values, labels)
    if found.loose:
        yield _describe_backlash(values, labels)
    if found.elastic:
        bends = _up_to(1e3 * drive.gear_compliance, drive.gear_compliance > 0.0, labels, "mrad a N·m")
        yield f"Teeth that bend, {bends}."
    if found.extras.tilted:
        yield _describe_lean(drive.tilt, motions, written)
    if (has := _notable(values, "bias_torque", labels)).any():
        size = _up_to(1e3 * np.abs(drive.bias_torque), has, labels, "mN·m")
        yield f"Constant torque, {size}: a cable, or dry friction that is larger one way."
    if (has := _notable(values, "uneven_damping", labels)).any():
        size = _up_to(1e3 * np.abs(drive.uneven_damping), has, labels, "mN·m·s/rad")
        yield f"Damping that differs by direction, {size}."
    yield from _describe_angle(found, values, labels)
    inside = _inside(drive.warm_up, WARM_UPS) & (drive.warm_up <= max(motion.seconds for motion in motions))
    if (has := _notable(values, "cold_friction", labels) & inside).any():
        size = _up_to(100.0 * drive.cold_friction, has, labels, "%")
        time = float(np.median(drive.warm_up[has]))
        yield f"Friction that is larger at first, by {size}, and falls in {time:.0f} s: warmth."


def _describe_backlash(values: Mapping[str, IdentifiedValue], labels: tuple[str, ...]) -> str:
    """Sentence on the backlash that was seen: its size where that is determined."""
    play = values["backlash"]
    if not (sure := play.identifiable & (play.value > 0.0)).any():
        return "Backlash behind the motors; how much is not determined."
    return f"Backlash behind the motors, {_up_to(1e3 * play.value, sure, labels, 'mrad')}."


def _describe_breakaway(values: Mapping[str, IdentifiedValue], labels: tuple[str, ...]) -> str:
    """Sentence on the certain part of what LuGre friction adds: breakaway and load friction."""
    said = []
    if (has := _notable(values, "stiction", labels, none=1.0)).any():
        said.append(f"it is larger at rest, by {_up_to(100.0 * (values['stiction'].value - 1.0), has, labels, '%')}")
    if (has := _notable(values, "load_friction", labels)).any():
        size = _up_to(100.0 * values["load_friction"].value, has, labels, "%")
        said.append(f"it grows with the motor's torque, by {size}")
    if said:
        return f"Friction breaks away: {', and '.join(said)}."
    return (
        "Friction is not Coulomb's: a model in which it breaks away leaves less, but none of what it adds is sure, so "
        "what the cause is stays open."
    )


def _describe_angle(found: DriveFit, values: Mapping[str, IdentifiedValue], labels: tuple[str, ...]) -> Iterator[str]:
    """Torque that comes with the angle: a spring, or cogging of a number of periods that is inside the tried ones."""
    drive, smooth = found.drive, found.extras.smooth
    if (has := _notable(values, "stiffness", labels) & (drive.stiffness > 0.0)).sum() >= FEW:
        size = _up_to(1e3 * drive.stiffness, has, labels, "mN·m/rad")
        yield f"Torque that grows with the angle, {size}: a spring, or a cable that is bent."
    waves = _notable(values, "cogging_cosine", labels) | _notable(values, "cogging_sine", labels)
    bends = np.zeros(len(labels), dtype=bool) if smooth is None else smooth
    if (waves & bends).sum() >= FEW:
        yield (
            f"Torque that bends with the angle, in {(waves & bends).sum()} joints: a cable that slackens, or one over "
            "several joints. No term of the model is that; cogging of few periods stands in for it."
        )
    if (has := waves & ~bends & _inside(drive.cogging_periods, PERIODS)).any():
        size = _up_to(1e3 * np.hypot(drive.cogging_cosine, drive.cogging_sine), has, labels, "mN·m")
        often = _counts(drive.cogging_periods[has])
        yield f"Cogging, {size}, {often} times a turn: torque that comes again with the angle."
    shares = _notable(values, "ripple_cosine", labels) | _notable(values, "ripple_sine", labels)
    if (has := shares & _inside(drive.ripple_periods, PERIODS)).any():
        size = _up_to(100.0 * np.hypot(drive.ripple_cosine, drive.ripple_sine), has, labels, "%")
        often = _counts(drive.ripple_periods[has])
        yield f"Torque ripple, {size}, {often} times a turn: a motor's torque that changes with the angle."


def _counts(periods: Vector) -> str:
    return ", ".join(f"{count:g}" for count in np.unique(periods))


def _describe_lean(tilt: Array, motions: Sequence[RecordedMotion], written: WrittenDrive) -> str:
    """Sentence on the palm's lean; a turn about gravity itself does not show."""
    said = np.array([motion.gravity / np.linalg.norm(motion.gravity) for motion in motions])
    each, common = rotate_vector(said, tilt), rotate_vector(said, np.tile(tilt.mean(axis=0), (len(tilt), 1)))
    lean = np.degrees(np.arccos(np.clip((said * each).sum(axis=1), -1.0, 1.0)))
    apart = np.arccos(np.clip((each * common).sum(axis=1), -1.0, 1.0)).max()
    alike = "the same way in all recordings" if apart < _SAME else "another way in each recording"
    text = (
        f"The palm leans by {lean.max():.1f}° from what the recordings say of gravity, {alike}: torque that all joints "
        "lack together."
    )
    if written.drive.tilt.any():
        return text if apart < _SAME else f"{text} Their mean is written."
    return (
        f"{text} It is not written: one lean for all recordings predicts what was kept back no better than none. In "
        "the file the palm is upright, so its twin lacks that torque."
    )


def _notable(
    values: Mapping[str, IdentifiedValue], name: str, labels: tuple[str, ...], none: float = 0.0
) -> NDArray[np.bool_]:
    """Which joints have so much of a term that it is sure and matters, (n,). `none`: its value where there is none."""
    if name not in values:
        return np.zeros(len(labels), dtype=bool)
    size = np.abs(values[name].value - none)
    sure = values[name].identifiable & (values[name].half < SURE * size)
    return np.asarray(sure & (size > _LEAST[name]))


def _inside(value: Vector, tried: Sequence[float] | Vector) -> NDArray[np.bool_]:
    """Which are inside what was tried: at its edge there is a better one beyond, or something else."""
    return np.asarray((value > tried[0]) & (value < tried[-1]))


def describe_prediction(written: WrittenDrive) -> str:
    """How well what is written predicts what the fit has not seen."""
    if not written.errors:
        return "The recordings are too short to keep a part back: what is determined is written, and nothing proves it."
    rms = {name: 1e3 * float(np.sqrt(np.square(row).mean())) for name, row in written.errors.items()}
    text = (
        f"Kept back, the last fifth of every motion, {written.seconds:.1f} s of open loop: nominal "
        f"{rms['nominal']:.1f} mrad, written {rms['written']:.1f}, determined values alone {rms['determined']:.1f}, "
        f"all values {rms['all']:.1f}."
    )
    if written.is_nominal:
        return f"{text} Nominal is best: nothing is to be written."
    nominal = written.source.count("nominal")
    return f"{text} Of {nominal} joint{'s' * (nominal > 1)} nominal is best, and stays." if nominal else text


def describe_worse(written: WrittenDrive, spec: HandSpec) -> str:
    """Which joints what is written predicts worse than the nominal hand; empty where it does none."""
    if not written.errors or written.is_nominal:
        return ""
    now, nominal = written.errors["written"], written.errors["nominal"]
    worse = np.flatnonzero(now > nominal / BETTER)
    if not len(worse):
        return ""
    order = worse[np.argsort(-(now - nominal)[worse], kind="stable")]
    names = [f"{spec.joint_labels[k]} ({1e3 * now[k]:.1f} mrad, nominal {1e3 * nominal[k]:.1f})" for k in order]
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return (
        f"Written and worse than nominal there: {', '.join(names[:4])}{more}. Their finger is better for it "
        "as a whole; record more motion of these joints and identify again."
    )


def describe_rest(found: DriveFit, spec: HandSpec) -> str:
    """Which joints the model does not explain; empty where it explains all."""
    left, labels = found.spread.residual, spec.joint_labels
    bad = np.flatnonzero(left > LEFT)
    if not len(bad):
        return ""
    worst = bad[np.argsort(-left[bad])]
    names = ", ".join(f"{labels[k]} ({left[k]:.0f})" for k in worst[:4])
    more = f" and {len(bad) - 4} more" if len(bad) > 4 else ""
    text = (
        f"Not explained, {len(bad)} of {len(labels)} joints: {names}{more}, in times the noise; intervals do not cover "
        "what no term of the model is."
    )
    touched = sum(bool(np.isin(finger.joints, bad).any()) for finger in spec.fingers)
    return f"{text} A finger that touched something looks like that." if touched <= TOUCHING else text


def _up_to(size: Vector, has: NDArray[np.bool_], labels: tuple[str, ...], unit: str) -> str:
    """The median and the largest of some joints' sizes."""
    most = int(np.argmax(np.where(has, size, -np.inf)))
    if has.sum() == 1:
        return f"{size[most]:.1f} {unit} ({labels[most]})"
    return (
        f"{np.median(size[has]):.1f} {unit} in the median of {has.sum()} joints and {size[most]:.1f} at most "
        f"({labels[most]})"
    )
