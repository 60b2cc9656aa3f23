"""Joint limits of a real hand: a sweep that finds them, and the encoder offsets that follow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.validation import check_radians
from allegro_twin.spec import HandSpec
from allegro_twin.types import Sample, TorqueCommand, Vector, frozen

_EXACT = 0.006  # rad. A range so near the model's is that between both stops, give of the stops and coarse encoders
# included: what holds a joint up elsewhere has no reason to do it at just this place.
_ALIKE = 0.03  # rad. By so much the shifts of both ends may differ: an offset is wrong by half of it at most.
_NEAR = 0.01  # rad. So near its furthest a joint stands there.
_APPROACH = 0.05  # rad before that, over which the torque that moves a joint is looked at.
_STOOD = 0.05  # s.
# s, rad/s, rad. A joint that in so long, at most, before it is called back goes on faster, and by more than the noise
# of an encoder, is not at rest. Of the time since it came `_NEAR`, the first half is its arrival.
_REST, _CREPT, _RESTS = 0.2, 0.02, 0.003
_EASED = 0.8  # Of the most torque in that time. With less, what friction holds slows down before it is called back.
_SPARE = 0.8  # Of the torque against which a joint stood; it must have come there with less.
_MET = 0.03  # rad. Closer to the sweep's end than this, a joint did not stop at its stop, but where it was sent.
_RUN, _RAN, _MUCH = 0.1, 0.15, 0.5  # s, rad, of the most torque. The sweep asks for 0.8 rad/s; a finger without motors
# falls at 1.4 rad/s at most, and the sweep's torque the wrong way drives it at 1.7 to 3.
_SHORT = 0.25  # Of the model's range. The shortest, 0.94 rad, may not lose 0.35 rad.
_KEYS = " (`wire.encoder_direction` of its file)", " (`wire.motor_direction` of its file)"
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
    at_stop: NDArray[np.bool_] | None = None
    """Whether the joint's torque tells that it stood against a stop, at the lowest and at the highest, (2, n), true or
    false; None where nothing pressed the joints but a person."""
    start: Vector | None = None
    """Where the joints were at first, (n,), rad; None where nobody knows."""
    ran: NDArray[np.bool_] | None = None
    """Whether the joint once ran against its torque, (n,); None where nothing pressed the joints but a person."""
    creep: NDArray[np.float64] | None = None
    """Speed at which the joint still went on when it was called back from its lowest and its highest, (2, n), rad/s; 0
    where it was at rest; None where nothing pressed the joints but a person."""


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


def limits_in_samples(samples: Iterable[Sample], most: Vector | None = None) -> FoundLimits:
    """The ends that a sweep, or a person, has brought the joints to. Raises ConfigError without samples.

    `most`: the torque to which commands are held during a sweep, (n,), N·m; None: a person moves the joints.
    """
    times, positions, torques = [], [], []
    for sample in samples:
        times.append(sample.state.t)
        positions.append(sample.state.position)
        if most is not None and isinstance(sample.command, TorqueCommand):
            torques.append(np.clip(sample.command.torque, -most, most))
    if not positions:
        raise ConfigError("no limits were found: there was no state to look at")
    seen = np.array(positions)
    stops = creep = ran = None
    if len(torques) == len(positions):
        pressed, t = np.array(torques), np.array(times)
        joints = range(seen.shape[1])
        stops = np.array(
            [[_stood_at_stop(t, way * seen[:, k], way * pressed[:, k]) for k in joints] for way in (-1, 1)]
        )
        creep = np.array(
            [[_creep(t, way * seen[:, k], way * pressed[:, k]) for k in joints] for way in (-1, 1)], dtype=np.float64
        )
        stops &= creep == 0.0
        ran = np.array([_ran_against(t, seen[:, k], pressed[:, k]) for k in joints])
    return FoundLimits(frozen(seen.min(axis=0)), frozen(seen.max(axis=0)), stops, frozen(seen[0]), ran, creep)


def _ran_against(t: Vector, position: Vector, torque: Vector) -> bool:
    """Whether a joint once went against much torque, faster than the sweep asks or its weight makes it go.

    All (k,): s, rad, N·m. No joint does that whose torque and position have the signs that they should.
    """
    rows = max(round(_RUN / float(np.median(np.diff(t)))), 1) if len(t) > 1 else len(t)
    if len(t) <= rows or not torque.any():
        return False
    for way in (-1, 1):
        pressed = np.cumsum(way * torque >= _MUCH * np.abs(torque).max())
        throughout = pressed[rows:] - pressed[:-rows] == rows
        if (throughout & (way * (position[:-rows] - position[rows:]) >= _RAN)).any():
            return True
    return False


def _creep(t: Vector, position: Vector, torque: Vector) -> float:
    """Speed at which a joint still went to its highest position when the torque let go, rad/s; 0 where it was at rest.

    All (k,): s, rad, N·m. A joint that was not driven there was at rest.
    """
    furthest = int(np.argmax(position))  # Where it met a stop, or a moment after the torque let go.
    eased = np.flatnonzero((torque[furthest:] <= 0.0) | (position[furthest:] < position[furthest] - _NEAR))
    pressed = np.flatnonzero(torque[: furthest + int(eased[0])] > 0.0) if len(eased) else np.arange(len(t))
    last = int(pressed[-1]) if len(pressed) else 0
    if last == 0 or t[furthest] - t[last] > _REST:
        return 0.0
    start = int(np.searchsorted(t, t[last] - _REST))
    driven = torque[start : last + 1]
    last = max(start + int(np.flatnonzero(driven >= _EASED * driven.max())[-1]), 1)
    away = np.flatnonzero(position[:last] < position[last] - _NEAR)
    came = t[away[-1] + 1] if len(away) else t[0]
    first = min(int(np.searchsorted(t, max(t[last] - _REST, (came + t[last]) / 2.0))), last - 1)
    way = float(position[last] - position[first])
    speed = way / float(t[last] - t[first])
    return speed if way > _RESTS and speed > _CREPT else 0.0


def _stood_at_stop(t: Vector, position: Vector, torque: Vector) -> bool:
    """Whether a joint once came to its highest position, and stood there against clearly more torque than had moved it.

    All (k,): s, rad, N·m. Friction, or a motor that is weak, gives way to any more torque than it needs; a stop does
    not. A joint that never moved did not come; one that took all the torque on its way may stand anywhere.
    """
    furthest = position.max()
    near = position >= furthest - _NEAR
    for first in np.flatnonzero(np.diff(near.astype(int)) == 1) + 1:
        away = np.flatnonzero(~near[first:])
        end = first + (away[0] if len(away) else len(t) - first)
        far = np.flatnonzero(position[:first] < furthest - _NEAR - _APPROACH)
        before = torque[far[-1] + 1 : first] if len(far) else torque[:0]
        if t[end - 1] - t[first] < _STOOD or not len(before):
            continue
        against = torque[first:end].max()
        if against > 0.0 and np.median(before) <= _SPARE * against:
            return True
    return False


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
    was not brought to both its ends, and for one whose ends are shifted by different amounts.
    """
    check_both_ends(found, model)
    _check_shifted_alike(found, model)
    old = codec.calibration.encoder_offset
    more = replace(codec.calibration, encoder_offset=tuple(count + 1 for count in old))
    # Change of a position by one count of offset, rad; each version has its own.
    step = make_codec(codec.version, more).positions.values(_NOTHING) - codec.positions.values(_NOTHING)
    counts = np.rint(-centring_offsets(found, model) / step)
    shift = counts * step
    limits = FoundLimits(frozen(found.lower + shift), frozen(found.upper + shift))
    return EncoderOffsets(tuple(count + int(more) for count, more in zip(old, counts, strict=True)), limits)


def check_both_ends(found: FoundLimits, model: HandSpec) -> None:
    """Raise ConfigError naming every joint that was not brought to both its ends, that ran against its torque, or whose
    ends are another joint's. Raises RecordingError for positions that are not in rad.

    `model` has the joint limits of the description, not those that were measured. A range that is the model's is that
    between the stops. Another one may be as much smaller than the model's as those of published hands are, `BEYOND`,
    but not by more than a quarter of it, and the torque must tell that the joint stood against a stop at each end.
    Where a person moved the joints nothing tells, and the range must be the model's but for `_ALIKE`. A range that ends
    where the sweep ends has no stop.
    """
    check_radians("the hand", np.array([found.lower, found.upper]), model)
    low, high, wanted = found.lower, found.upper, model.upper - model.lower
    short = wanted - (high - low)
    exact = np.abs(short) <= _EXACT
    stood = np.asarray(np.abs(short) <= _ALIKE if found.at_stop is None else found.at_stop.all(axis=0))
    whole = exact | stood & (short <= np.minimum(BEYOND, _SHORT * wanted))
    stopped = np.minimum(low - model.lower, model.upper - high) >= _MET - BEYOND
    reached = whole & stopped & ~_ran(found)
    missed = np.flatnonzero(~reached)  # NaN is neither.
    if not len(missed):
        _check_swapped(found, model)
        return
    told = missed[:_TOLD].tolist()
    causes = [_likely(found, model, k) for k in told]
    seen = [_seen(found, model, k) + (cause or _held(found, exact, k)) for k, cause in zip(told, causes, strict=True)]
    if len(missed) > _TOLD:
        seen.append(f"nor were {', '.join(model.joint_labels[k] for k in missed[_TOLD:])}")
    way_out = "bring it there yourself: --by-hand SECONDS"
    if found.at_stop is None:
        way_out = "press it against both its stops; without --by-hand the motors tell a stop that is not the model's"
    repeat = "Correct that and repeat" if all(causes) else f"Free it, or {way_out}"
    raise ConfigError(f"not at both ends: {'; '.join(seen)}. {repeat}")


def _check_swapped(found: FoundLimits, model: HandSpec) -> None:
    """Raise ConfigError for joints that came to both ends, where those are each other's. An encoder's shift is not
    taken for it: the ranges must differ in size."""
    size, wanted = found.upper - found.lower, model.upper - model.lower
    for k in np.flatnonzero(np.abs(size - wanted) > _ALIKE).tolist():
        if likely := _likely(found, model, k, reversal=False):
            raise ConfigError(
                f"{_seen(found, model, k)}{likely}. Exchange them, or, where each moves under its own name, write "
                "these limits into the hand's file yourself"
            )


def _check_shifted_alike(found: FoundLimits, model: HandSpec) -> None:
    """Raise ConfigError naming joints whose ends are not the model's, shifted: which shift is the encoder's, nothing
    tells then."""
    unlike = np.abs(found.lower - model.lower - (found.upper - model.upper)) > _ALIKE
    names = [_seen(found, model, k) for k in np.flatnonzero(unlike)[:_TOLD]]
    if names:
        raise ConfigError(
            f"no encoder offset can be told: {'; '.join(names)}; an encoder shifts both ends alike, within {_ALIKE:g} "
            "rad. Clear its way and repeat, or write its limits alone, without --offsets"
        )


def _seen(found: FoundLimits, model: HandSpec, k: int) -> str:
    low, high = found.lower[k], found.upper[k]
    return (
        f"{model.joint_labels[k]} was seen from {low:+.3f} to {high:+.3f} rad, the model's ends are "
        f"{model.lower[k]:+.3f} and {model.upper[k]:+.3f}"
    )


def _likely(found: FoundLimits, model: HandSpec, k: int, *, reversal: bool = True) -> str:
    """The cause where the joint ran against its torque, or where the ends are those of the joint turned round, or of
    another joint that has this one's; empty where none of it is seen."""
    ends = np.array([model.lower, model.upper])
    if _fits(found, model, k, ends[:, k], swept=False):
        return f": it ran against its torque, so the sign of its motor is reversed{_KEYS[1]}" if _ran(found)[k] else ""
    if _ran(found)[k]:
        turned = (np.abs(found.lower[k] + model.upper[k]), np.abs(found.upper[k] + model.lower[k]))
        part = f"encoder is reversed{_KEYS[0]}" if min(turned) <= _ALIKE else "motor or its encoder is reversed"
        return f": it ran against its torque, so the sign of its {part}"
    if reversal and _fits(found, model, k, -ends[::-1, k]):
        both = _KEYS[0] if found.at_stop is None else ", and its motor's"
        return f": the sign of its encoder is reversed{both}"
    for other in range(ends.shape[1]):
        if _fits(found, model, k, ends[:, other]) and _fits(found, model, other, ends[:, k]):
            return f": it and {model.joint_labels[other]} are swapped"
    return ""


def _fits(found: FoundLimits, model: HandSpec, k: int, ends: Vector, *, swept: bool = True) -> bool:
    """Whether these ends (2,), rad, are a joint's. `swept`: a sweep brings it no further than `BEYOND` past its own
    ends, from where it began."""
    if swept and found.at_stop is not None and found.start is not None:
        within = np.clip(ends, model.lower[k] - BEYOND, model.upper[k] + BEYOND)
        ends = np.array([min(within[0], found.start[k]), max(within[1], found.start[k])])
    return bool((np.abs(np.array([found.lower[k], found.upper[k]]) - ends) <= _ALIKE).all())


def _ran(found: FoundLimits) -> NDArray[np.bool_]:
    return np.zeros(len(found.lower), dtype=bool) if found.ran is None else found.ran


def _held(found: FoundLimits, exact: NDArray[np.bool_], k: int) -> str:
    """What was wrong at the ends of a joint, as far as its torque tells."""
    if found.at_stop is None or exact[k] or found.at_stop[:, k].all():
        return ""
    if found.creep is not None and (speeds := found.creep[:, k][~found.at_stop[:, k]]).any():
        at = " and ".join(np.array(["lower", "upper"])[~found.at_stop[:, k] & (found.creep[:, k] > 0.0)])
        return (
            f", and still moved at the {at} end, at {speeds.max():.2g} rad/s, when it was called back: it had not come "
            "to rest at a stop"
        )
    ends = " and ".join(each for each, stop in zip(("lower", "upper"), found.at_stop[:, k], strict=True) if not stop)
    return f", with no sign of a stop at the {ends} end: friction held it, its motor is weak, or it never moved there"
