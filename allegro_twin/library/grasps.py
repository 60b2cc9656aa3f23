"""Named grasps: the taxonomy's type, and the postures that the hand goes through."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from allegro_twin.control.trajectory import Profile, Waypoint
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, find
from allegro_twin.files.schema import Settings, load
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Vector, frozen

Angles = dict[str, list[float]]
"""For each finger the positions of its joints from the palm outward, rad."""


class Taxonomy(Settings):
    """Place in the GRASP taxonomy of Feix et al. (IEEE Trans. Human-Machine Systems 46(1), 2016)."""

    number: Annotated[int, Field(ge=1, le=33)]
    name: str
    type: Literal["power", "intermediate", "precision"]
    opposition: Literal["palm", "pad", "side"]


class GraspFile(Settings):
    """A grasp as it is stored."""

    description: str = ""
    taxonomy: Taxonomy
    side: Side = "right"
    """Which hand the angles are for; the other hand uses their mirror image."""
    speed: Annotated[float, Field(gt=0)] = 1.0
    """Peak speed while closing of the joint that travels furthest, rad/s."""
    profile: Profile = "minimum_jerk"
    preshape: Angles
    close: Angles
    squeeze: Angles
    """Inside the object: the difference to where the fingers are stopped, times the stiffness, is the torque."""


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """A grasp for one hand."""

    name: str
    taxonomy: Taxonomy
    speed: float
    profile: Profile
    preshape: Vector
    close: Vector
    squeeze: Vector

    def waypoint(self, stage: str, seconds: float | None = None) -> Waypoint:
        """One of `preshape`, `close`, `squeeze` as a waypoint: at the grasp's speed, or in a given time."""
        posture: Vector = getattr(self, stage)
        return Waypoint(posture, seconds=seconds, speed=self.speed, profile=self.profile)


def load_grasp(name: str | Path, spec: HandSpec) -> Grasp:
    """A grasp by name or path, for the spec's side. Raises ConfigError naming the joint and the excess."""
    path = find(name, "grasp", "conf/grasps")
    stored = load(GraspFile, path)
    postures = {}
    for stage in ("preshape", "close", "squeeze"):
        values = joint_vector(getattr(stored, stage), spec, f"{path}: {stage}")
        if stored.side != spec.side:
            values = frozen(spec.mirrored(values))
        postures[stage] = spec.posture(values, f"{path}: {stage}")
    return Grasp(path.stem, stored.taxonomy, stored.speed, stored.profile, **postures)


def joint_vector(angles: Angles, spec: HandSpec, what: str) -> Vector:
    """From angles by finger to one vector in the spec's order, shape (n,), rad. Raises ConfigError."""
    values = np.full(spec.n_joints, np.nan)
    for name, row in angles.items():
        finger = spec.finger(name)
        if len(row) != len(finger.joints):
            raise ConfigError(f"{what}: {name} has {len(finger.joints)} joints, not {len(row)}")
        values[list(finger.joints)] = row
    return spec.vector(values, what)


def grasp_names() -> list[str]:
    """Every grasp that ships with the package."""
    return sorted(path.stem for path in (data_root() / "conf" / "grasps").glob("*.yaml"))
