"""Measures of a followed motion: errors, lag, joints that did not arrive, swing, or lack torque."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from allegro_twin.app.session import REACHED
from allegro_twin.sim.contact.collision_free_paths import CollisionFreePaths
from allegro_twin.spec import HandSpec
from allegro_twin.twin.rehearsal.protocol import AVERAGED
from allegro_twin.types import Array, Vector

SPENT = 0.99
"""Share of its torque limit from which a motor gives all it has."""
STILL = 5e-4
"""rad, standard deviation of a joint that rests: the noise of the worst encoder here is 0.2 mrad."""
SWINGS = 2.0
"""Periods in that time; what has fewer creeps."""
BRIEFLY = 0.01
"""Share of the time for which a motor may give all it has without being named."""


class Following(NamedTuple):
    """A motion and what a hand made of it, a row a period."""

    spec: HandSpec
    t: Vector
    """Times of the rows, s."""
    target: Array
    """(k, n), rad."""
    rate: Array
    """Speed of the target, (k, n), rad/s."""
    position: Array
    """By the encoders, corrected, (k, n), rad."""
    truth: Array | None
    """(k, n), rad."""
    begins: Vector
    """When each of the motion's legs begins, and when the last ends, s."""
    torque: Array
    """What the controller asked of the motors, (k, n), N·m."""

    @property
    def known(self) -> Array:
        """The best that is known of the joints, (k, n), rad."""
        return self.position if self.truth is None else self.truth


def steady_error(found: Following, position: Array) -> Vector:
    """How far the joints are from the last target on average over the last AVERAGED s, (n,), rad."""
    late = found.t > found.t[-1] - AVERAGED
    error: Vector = (position[late] - found.target[late]).mean(axis=0)
    return error


def tracking_error(found: Following, position: Array) -> Vector:
    """Root mean square error of each joint after the approach, (n,), rad."""
    moving = _measured(found)
    error: Vector = np.sqrt(np.square(position[moving] - found.target[moving]).mean(axis=0))
    return error


def tracking_lag(found: Following, position: Array) -> float:
    """How late the joints are, s: τ in q(t) ≈ q*(t) − τ q̇*(t), least squares over all joints after the approach."""
    moving = _measured(found)
    rate, error = found.rate[moving], position[moving] - found.target[moving]
    return float(-(error * rate).sum() / np.square(rate).sum())


def closing_time(found: Following, position: Array) -> float | None:
    """From the beginning of the last leg until all joints are within REACHED of its end for good, s; None: never."""
    close = (np.abs(position - found.target[-1]) <= REACHED).all(axis=1)
    if not close[-1]:
        return None
    outside = np.flatnonzero(~close)
    first = 0 if not len(outside) else int(outside[-1]) + 1
    return float(max(found.t[first] - found.begins[-2], 0.0))


def oscillating_joints(found: Following, position: Array) -> str:
    """Joints that swing in the time over which a steady error is averaged, the widest first, with amplitude √2 σ and
    frequency; empty for none. Play behind a motor and much damping make such limit cycles. What creeps is no swing."""
    late = found.t > found.t[-1] - AVERAGED
    t, error = found.t[late], position[late] - found.target[late]
    error = error - np.stack([np.polyval(line, t) for line in np.polyfit(t, error, 1).T], axis=1)
    spread, power = error.std(axis=0), np.square(np.abs(np.fft.rfft(error, axis=0)))
    frequency = np.fft.rfftfreq(len(t), float(np.diff(t).mean()))[power.argmax(axis=0)]
    swings = (spread > STILL) & (frequency * AVERAGED >= SWINGS)
    return ", ".join(
        f"{found.spec.joint_labels[k]} ±{1e3 * np.sqrt(2.0) * spread[k]:.1f} mrad at {frequency[k]:.0f} Hz"
        for k in np.argsort(-spread)
        if swings[k]
    )


def spent_joints(found: Following) -> dict[str, float]:
    """Joints of which more was asked than their motors have, for more than BRIEFLY after the approach, and the share of
    that time."""
    spec = found.spec
    spent = (np.abs(found.torque[_measured(found)]) >= SPENT * spec.actuation.torque_limit).mean(axis=0)
    return {spec.joint_labels[k]: round(float(spent[k]), 3) for k in np.flatnonzero(spent > BRIEFLY)}


def far_joints(error: Vector, found: Following) -> str:
    """Joints that are further than REACHED from where they were to be, furthest first, with what stops each: another
    part of the hand that is in its finger's way, or a motor that gave all it has; empty for none."""
    spec, late = found.spec, found.t > found.t[-1] - AVERAGED
    far = [joint for joint in np.argsort(-np.abs(error)).tolist() if not abs(error[joint]) <= REACHED]
    if not far:
        return ""
    spent = (np.abs(found.torque[late]) >= SPENT * spec.actuation.torque_limit).all(axis=0)
    towards = np.zeros(spec.n_joints)
    towards[far] = -np.nan_to_num(error[far])
    stops = CollisionFreePaths(spec).blocking_parts(found.known[late].mean(axis=0), towards)
    # The other joints of a finger that is stopped lean on what stops it.
    stopped: dict[int | None, str] = {_finger(spec, joint): why for joint, why in stops.items()}
    why = {joint: stopped.get(_finger(spec, joint), "its motor gives all it has") for joint in far if spent[joint]}
    why |= stops
    return ", ".join(
        f"{spec.joint_labels[joint]} {error[joint]:+.2f}" + (f" ({why[joint]})" if joint in why else "")
        for joint in far
    )


def _finger(spec: HandSpec, joint: int) -> int | None:
    return next((number for number, finger in enumerate(spec.fingers) if joint in finger.joints), None)


def _measured(found: Following) -> Any:
    return (found.t >= found.begins[1]) & (found.t <= found.begins[-1])
