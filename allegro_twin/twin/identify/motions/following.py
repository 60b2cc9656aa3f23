"""Joints that did not follow an excitation: a dead or reversed motor, an encoder that repeats itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.control.controllers import GravityFeedforward
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.excitation import Excitation
from allegro_twin.twin.identify.motions.motion import EDGE
from allegro_twin.types import Array, Vector

WINDOW = 1.0  # s
OFF = 0.75
"""Share of a joint's motion, rms about its mean: a joint that is further off in a window does not follow. Healthy hands
stay below 0.35, with half of a motor's torque too; dead, reversed and frozen joints are above 1.5 (ours)."""


class UnfollowedJoint(NamedTuple):
    """A joint that did not do what the excitation told it."""

    joint: int
    off: float
    """Its error in the worst window, rms, rad."""
    how: str
    """What it did instead, as far as its positions tell."""

    def sentence(self, spec: HandSpec) -> str:
        """What is said of it."""
        return f"{spec.joint_labels[self.joint]} did not follow what it was told: {self.reason}"

    @property
    def reason(self) -> str:
        """By how much, and what it did."""
        return f"for {WINDOW:g} s it was {self.off:.2f} rad off, rms; {self.how}"


def unfollowed_joints(
    spec: HandSpec, excitation: Mapping[str, Any], t: Vector, position: Array
) -> list[UnfollowedJoint]:
    """The joints that did not follow an excitation. `excitation`: as in a recording's metadata; `t`: s, (k,);
    `position`: rad, (k, n)."""
    gravity = GravityFeedforward(hand_kinematics(spec).gravity_torque)
    played = Excitation(spec, int(excitation["seed"]), gravity, float(excitation["scale"]))
    path = played.path_from(position[0])
    told = np.array([path(each).position for each in (t - t[0]).tolist()])
    rows = max(round(WINDOW * (len(t) - 1) / max(float(t[-1] - t[0]), 1e-9)), 1)
    if len(t) <= rows:
        return []
    summed = np.vstack([np.zeros(position.shape[1]), np.square(position - told).cumsum(axis=0)])
    off = np.sqrt((summed[rows:] - summed[:-rows]) / rows)  # (windows, n)
    found = []
    for joint in np.flatnonzero((off > OFF * told.std(axis=0)).any(axis=0)).tolist():
        worst = slice(int(off[:, joint].argmax()), int(off[:, joint].argmax()) + rows)
        how = _describe(t, position[:, joint], told[:, joint], worst, (spec.lower[joint], spec.upper[joint]))
        found.append(UnfollowedJoint(joint, float(off[:, joint].max()), how))
    return found


def _describe(t: Vector, position: Vector, told: Vector, worst: slice, ends: tuple[float, float]) -> str:
    """What a joint did, all (k,)."""
    changes = np.flatnonzero(np.diff(position)) + 1
    first = np.concatenate([[0], changes])
    last = np.concatenate([changes, [len(t)]]) - 1
    still = (t[last] - t[first]).max()
    if still >= WINDOW / 2.0:
        return f"it reported the same position for {still:.1f} s: its encoder hangs, or it stands still"
    there = float(np.median(position[worst]))
    for name, beyond in (("lower", there < ends[0] + EDGE), ("upper", there > ends[1] - EDGE)):
        if beyond:
            return f"it stood at its {name} end: its motor or its encoder is reversed, or something pulled it there"
    moved, wanted = np.ptp(position[worst]), np.ptp(told[worst])
    return f"it moved by {moved:.2f} rad then, and was to move by {wanted:.2f}"
