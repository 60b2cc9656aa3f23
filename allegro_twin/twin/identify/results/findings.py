"""What an identification says in sentences: what the hand has beyond friction, how well it is predicted, what is
left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from allegro_twin.kinematics.orientation import rotate_vector
from allegro_twin.twin.identify.fitting.fit import DriveFit
from allegro_twin.twin.identify.motions.motion import RecordedMotion
from allegro_twin.twin.identify.results.uncertainty import IdentifiedValue
from allegro_twin.twin.identify.results.written_drive import WrittenDrive
from allegro_twin.types import Array, Vector

LEFT = 3.0
"""Times the noise: with more left over the model does not explain a joint."""
_LEAST = {
    "bias_torque": 5e-4,
    "uneven_damping": 1e-3,
    "cogging_cosine": 3e-4,
    "cogging_sine": 3e-4,
    "cold_friction": 0.03,
}
"""N·m and N·m·s/rad at 1 N·m of full PWM, and a share: less is not worth a sentence."""
_SAME = np.radians(0.6)  # Between the leans of recordings that count as one.


def describe_terms(
    found: DriveFit, values: Mapping[str, IdentifiedValue], motions: Sequence[RecordedMotion]
) -> Iterator[str]:
    """What the model has beyond Coulomb's friction, and by which shape of what was left over it was found; not what is
    smaller than its interval, or than anybody notices."""
    drive, labels = found.drive, motions[0].spec.joint_labels
    if found.bristly:
        yield "Friction breaks away: it is larger at rest, and grows with the motor's torque."
    if found.loose:
        yield f"Backlash behind the motors, {_up_to(1e3 * drive.backlash, drive.backlash > 0.0, labels, 'mrad')}."
    if found.elastic:
        bends = _up_to(1e3 * drive.gear_compliance, drive.gear_compliance > 0.0, labels, "mrad a N·m")
        yield f"Teeth that bend, {bends}."
    if found.extras.tilted:
        yield _describe_lean(drive.tilt, motions)
    if (has := _notable(found, values, "bias_torque")).any():
        size = _up_to(1e3 * np.abs(drive.bias_torque), has, labels, "mN·m")
        yield f"Constant torque, {size}: a cable, or dry friction that is larger one way."
    if (has := _notable(found, values, "uneven_damping")).any():
        size = _up_to(1e3 * np.abs(drive.uneven_damping), has, labels, "mN·m·s/rad")
        yield f"Damping that differs by direction, {size}."
    if (has := _notable(found, values, "cogging_cosine") | _notable(found, values, "cogging_sine")).any():
        size = _up_to(1e3 * np.hypot(drive.cogging_cosine, drive.cogging_sine), has, labels, "mN·m")
        counts = ", ".join(f"{count:g}" for count in np.unique(drive.cogging_periods[has]))
        yield f"Cogging, {size}, {counts} times a turn: torque that comes again with the angle."
    if (has := _notable(found, values, "cold_friction")).any():
        size = _up_to(100.0 * drive.cold_friction, has, labels, "%")
        time = float(np.median(drive.warm_up[has]))
        yield f"Friction that is larger at first, by {size}, and falls in {time:.0f} s: warmth."


def _describe_lean(tilt: Array, motions: Sequence[RecordedMotion]) -> str:
    """Of what shows: a turn about gravity itself does not."""
    said = np.array([motion.gravity / np.linalg.norm(motion.gravity) for motion in motions])
    each, common = rotate_vector(said, tilt), rotate_vector(said, np.tile(tilt.mean(axis=0), (len(tilt), 1)))
    lean = np.degrees(np.arccos(np.clip((said * each).sum(axis=1), -1.0, 1.0)))
    apart = np.arccos(np.clip((each * common).sum(axis=1), -1.0, 1.0)).max()
    alike = "the same way in all recordings" if apart < _SAME else "another way in each recording"
    return (
        f"The palm leans by {lean.max():.1f}° from what the recordings say of gravity, {alike}: torque that all joints "
        "lack together."
    )


def _notable(found: DriveFit, values: Mapping[str, IdentifiedValue], name: str) -> NDArray[np.bool_]:
    """Which joints have so much of a term that it is sure and matters, (n,)."""
    if name not in values:
        return np.zeros(len(found.floor), dtype=bool)
    size = np.abs(values[name].value)
    return np.asarray((size > values[name].half) & (size > _LEAST[name]))


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
    if written.nothing:
        return f"{text} Nominal is best: nothing is to be written."
    nominal = written.source.count("nominal")
    return f"{text} Of {nominal} joint{'s' * (nominal > 1)} nominal is best, and stays." if nominal else text


def describe_rest(found: DriveFit, labels: tuple[str, ...]) -> str:
    """Which joints the model does not explain; empty where it explains all."""
    left = found.spread.residual
    bad = np.flatnonzero(left > LEFT)
    if not len(bad):
        return ""
    worst = bad[np.argsort(-left[bad])]
    names = ", ".join(f"{labels[k]} ({left[k]:.0f})" for k in worst[:4])
    more = f" and {len(bad) - 4} more" if len(bad) > 4 else ""
    return (
        f"Not explained: {names}{more}, in times the noise; intervals do not cover what no term of the model is. "
        "A finger that touched something looks like that."
    )


def _up_to(size: Vector, has: NDArray[np.bool_], labels: tuple[str, ...], unit: str) -> str:
    """The median and the largest of some joints' sizes."""
    most = int(np.argmax(np.where(has, size, -np.inf)))
    if has.sum() == 1:
        return f"{size[most]:.1f} {unit} ({labels[most]})"
    return (
        f"{np.median(size[has]):.1f} in the median of {has.sum()} joints and {size[most]:.1f} at most ({labels[most]})"
    )
