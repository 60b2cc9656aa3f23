"""Joint limits of a real hand: a sweep that finds them, and the encoder offsets that follow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import HandSpec
from allegro_twin.types import Sample, Vector, frozen

_MET = 0.03  # rad. Closer to the sweep's end than this, a joint did not stop at its stop, but where it was sent.
_SHORT = 0.25  # Of the model's range. The shortest, 0.94 rad, may not lose 0.35 rad.
_TOLD = 3  # Joints with their ranges in a message; the others by name.
_NOTHING = bytes(32)  # A report of sixteen positions; any one will do.

BEYOND = (
    0.35  # rad past the model's limits: published hands differ by this much, and the joint must press against its stop.
)
TORQUE = (
    0.25  # N·m at most while sweeping: more than any joint's weight and friction, less than any torque limit but one.
)


@dataclass(frozen=True, slots=True, eq=False)
class FoundLimits:
    """Lowest and highest joint positions, (n,) each, rad."""

    lower: Vector
    upper: Vector


def limit_sweep(spec: HandSpec, rest: Vector, speed: float = 0.8) -> Moves:
    """Moves from `rest` (n,), rad, of every joint to both ends and back, the same joint of all alike fingers at once.

    In between, the others stay at rest, where no finger is in the way of another.
    """
    waypoints = [Waypoint(rest, speed=speed)]
    for group in alike_joints(spec):
        for end in (spec.lower - BEYOND, spec.upper + BEYOND, rest):
            goal = rest.copy()
            goal[group] = end[group]
            waypoints.append(Waypoint(goal, speed=speed, profile="linear"))
    return Moves(waypoints)


def limits_in_samples(samples: Iterable[Sample]) -> FoundLimits:
    """The ends that a sweep, or a person, has brought the joints to. Raises ConfigError without samples."""
    lower, upper = None, None
    for sample in samples:
        position = sample.state.position
        lower = position if lower is None else np.minimum(lower, position)
        upper = position if upper is None else np.maximum(upper, position)
    if lower is None or upper is None:
        raise ConfigError("no limits were found: there was no state to look at")
    return FoundLimits(frozen(lower), frozen(upper))


def centring_offsets(found: FoundLimits, spec: HandSpec) -> Vector:
    """Shift of every joint position, (n,), rad, to subtract so that the found range has the model's middle. It gives
    the encoder offsets of hands of versions 1 to 3."""
    return frozen((found.lower + found.upper - spec.lower - spec.upper) / 2.0)


def alike_joints(spec: HandSpec) -> list[list[int]]:
    """Joints that can move together: the same place in fingers with the same limits, as the model has them: those that
    were measured on a hand are all different."""
    model = load_spec(spec.model, spec.side) if spec.serial else spec
    groups: dict[tuple[int, float, float], list[int]] = {}
    for finger in spec.fingers:
        for place, joint in enumerate(finger.joints):
            groups.setdefault((place, float(model.lower[joint]), float(model.upper[joint])), []).append(joint)
    return list(groups.values())


class EncoderOffsets(NamedTuple):
    """Encoder offsets from the ends of the joints."""

    offset: tuple[int, ...]
    """Encoder offsets, counts, n values."""
    limits: FoundLimits
    """The found limits, as the hand reads them with these offsets."""


def encoder_offsets(found: FoundLimits, model: HandSpec, codec: Codec) -> EncoderOffsets:
    """The offsets that put the middle of each found range where the model has it, on a hand of any version, starting
    from the codec's own.

    `model` has the joint limits of the description, not those that were measured. Raises ConfigError for a joint that
    was not brought to both its ends.
    """
    check_both_ends(found, model)
    old = codec.calibration.encoder_offset
    more = replace(codec.calibration, encoder_offset=tuple(count + 1 for count in old))
    # Change of a position by one count of offset, rad; each version has its own.
    step = make_codec(codec.version, more).positions.values(_NOTHING) - codec.positions.values(_NOTHING)
    counts = np.rint(-centring_offsets(found, model) / step)
    shift = counts * step
    limits = FoundLimits(frozen(found.lower + shift), frozen(found.upper + shift))
    return EncoderOffsets(tuple(count + int(more) for count, more in zip(old, counts, strict=True)), limits)


def check_both_ends(found: FoundLimits, model: HandSpec) -> None:
    """Raise ConfigError naming every joint that was not brought to both its ends.

    `model` has the joint limits of the description, not those that were measured. A range may be as much smaller than
    the model's as those of published hands are, `BEYOND`, but not by more than a quarter of it: a joint that is stuck,
    or stopped by something on its way, is not at its ends. A range that ends where the sweep ends has no stop.
    """
    low, high, wanted = found.lower, found.upper, model.upper - model.lower
    whole = wanted - (high - low) <= np.minimum(BEYOND, _SHORT * wanted)
    stopped = np.minimum(low - model.lower, model.upper - high) >= _MET - BEYOND
    missed = np.flatnonzero(~(whole & stopped))  # NaN is neither.
    if not len(missed):
        return
    seen = [
        f"{model.joint_labels[k]} was seen from {low[k]:+.3f} to {high[k]:+.3f} rad, the model's ends are "
        f"{model.lower[k]:+.3f} and {model.upper[k]:+.3f}"
        for k in missed[:_TOLD]
    ]
    if len(missed) > _TOLD:
        seen.append(f"nor were {', '.join(model.joint_labels[k] for k in missed[_TOLD:])}")
    raise ConfigError(f"not at both ends: {'; '.join(seen)}. Free it, or bring it there yourself: --by-hand SECONDS")
