"""A grasp for one hand: its type in the taxonomy, its postures, and its grip."""

from __future__ import annotations

from dataclasses import dataclass

from allegro_twin.control.trajectory import Profile, Waypoint
from allegro_twin.errors import ConfigError
from allegro_twin.hands.library.entries import (
    CentroidGrip,
    EnvelopGrip,
    GraspFile,
    Grip,
    grasp_entry,
    joint_values,
    mirror_grip,
)
from allegro_twin.hands.library.taxonomy import ClaimedType, ObservedType
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """A grasp for one hand."""

    name: str
    taxonomy: ClaimedType
    """The type that it claims to be."""
    speed: float
    profile: Profile
    preshape: Vector
    close: Vector
    squeeze: Vector
    grip: Grip | None = None
    observed: ObservedType | None = None
    """The type that its contacts have shown; None: nobody has looked."""

    @property
    def kind(self) -> ClaimedType | ObservedType:
        """The type that it is: the one observed, else the one that it claims."""
        return self.taxonomy if self.observed is None else self.observed

    def waypoint(self, stage: str, seconds: float | None = None) -> Waypoint:
        """One of `preshape`, `close`, `squeeze` as a waypoint: at the grasp's speed, or in a given time."""
        posture: Vector = getattr(self, stage)
        return Waypoint(posture, seconds=seconds, speed=self.speed, profile=self.profile)


def build_grasp(name: str, stored: GraspFile, spec: HandSpec, where: str) -> Grasp:
    """A stored grasp for the spec's side. Raises ConfigError naming the joint and the excess."""
    postures = joint_values(stored, spec, where)
    grip = stored.grip if stored.side == spec.side else mirror_grip(stored.grip, spec)
    _check_grip(grip, spec, where)
    return Grasp(name, stored.taxonomy, stored.speed, stored.profile, **postures, grip=grip, observed=stored.observed)


def entry_from_grasp(grasp: Grasp, spec: HandSpec, description: str = "", evidence: str = "") -> GraspFile:
    """The entry that `build_grasp` makes it from. Raises ConfigError outside the limits."""
    postures = {stage: getattr(grasp, stage) for stage in GraspFile.joint_fields}
    entry = grasp_entry(postures, spec, grasp.taxonomy, description, evidence)
    return entry.model_copy(
        update={"speed": grasp.speed, "profile": grasp.profile, "grip": grasp.grip, "observed": grasp.observed}
    )


def _check_grip(grip: Grip | None, spec: HandSpec, where: str) -> None:
    """Raise ConfigError for fingers that the hand does not have, or torques that do not fit them."""
    names: tuple[str, ...] = ()
    if isinstance(grip, CentroidGrip | EnvelopGrip):
        names = grip.fingers if isinstance(grip, CentroidGrip) else tuple(grip.torque)
    for name in names:
        finger = spec.finger(name)
        row = grip.torque[name] if isinstance(grip, EnvelopGrip) else [0.0] * len(finger.joints)
        if len(row) != len(finger.joints):
            raise ConfigError(f"{where}: grip.torque.{name} has {len(finger.joints)} joints, not {len(row)}")
