"""A part of an object by which it is to be held: a mug's handle, a hammer's."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.batch.batched_trials import Verdict
from allegro_twin.grasping.trial import Trial
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.contact.contacts import find_contacts
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.types import Array

SHARE = 0.5
"""More of the contact force than this has to be in the region."""
_TERM = re.compile(r"\s*([xyz])\s*([<>])\s*(-?\d+(?:\.\d*)?|-?\.\d+)\s*")


@dataclass(frozen=True, slots=True)
class GraspRegion:
    """Box between two corners in the object's own frame, m."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def __str__(self) -> str:
        """As it is asked for."""
        low = [f"{axis} > {bound:g}" for axis, bound in zip("xyz", self.low, strict=True) if np.isfinite(bound)]
        high = [f"{axis} < {bound:g}" for axis, bound in zip("xyz", self.high, strict=True) if np.isfinite(bound)]
        return ", ".join([*low, *high])

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Which of some points (k, 3), m, in the object's frame, are inside, (k,)."""
        inside: NDArray[np.bool_] = np.all((points >= self.low) & (points <= self.high), axis=1)
        return inside

    def share(self, trial: Trial, data: Any) -> Mapping[str, float]:
        """The share of the normal forces of the hand on the object that acts in here, as `region`: what a batch of
        trials measures."""
        name = trial.scenario.objects[0].name
        touch = find_contacts(trial.backend.model, data, trial.backend.spec, name)
        body = data.body(name)
        force = np.sum(touch.force * touch.normals, axis=1)
        inside = self.contains((touch.points - body.xpos) @ body.xmat.reshape(3, 3))
        return {"region": float(force[inside].sum() / force.sum()) if force.sum() > 0.0 else 0.0}


def holds_in_region(verdict: Verdict) -> bool:
    """Whether enough of the force was in the region, where one was asked for."""
    return verdict.measured.get("region", 1.0) > SHARE


def parse_region(text: str) -> GraspRegion:
    """From words like `x>0.045, z<0.03`. Raises ConfigError."""
    low, high = dict.fromkeys("xyz", -np.inf), dict.fromkeys("xyz", np.inf)
    for part in text.split(","):
        match = _TERM.fullmatch(part)
        if match is None:
            raise ConfigError(f"region {text!r}: write bounds in m in the object's frame, as x>0.045,z<0.03")
        axis, side, bound = match.groups()
        (low if side == ">" else high)[axis] = float(bound)
    empty = [axis for axis in "xyz" if low[axis] >= high[axis]]
    if empty:
        raise ConfigError(f"region {text!r}: nothing is between the bounds of {empty[0]}")
    return GraspRegion((low["x"], low["y"], low["z"]), (high["x"], high["y"], high["z"]))


def to_object_frame(placed: PlacedObject, points: Array) -> Array:
    """Points of the world in the frame of an object where it stands, (k, 3), m."""
    own: Array = (points - placed.position) @ matrix_from_quaternion(np.array(placed.quaternion))
    return own
