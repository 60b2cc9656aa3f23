"""Which hand it is: names, fingers, limits and actuation. Nothing outside a hand's own files assumes sixteen joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.drive import Drive
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.types import Array, Vector, frozen

Side: TypeAlias = Literal["right", "left"]
SIDES: tuple[Side, Side] = ("right", "left")
CommandKind: TypeAlias = Literal["torque", "position", "limited_position", "timed_position"]
"""What a hand can be told: torques; positions; these with an effort that is not to be exceeded, or in a given time."""


@dataclass(frozen=True, slots=True)
class Finger:
    """One finger: the indices of its joints from the palm outward, and the name of its tip's frame."""

    name: str
    joints: tuple[int, ...]
    tip: str
    """A link in the URDF and a site in the MJCF: the centre of the fingertip sphere."""


@dataclass(frozen=True, slots=True, eq=False)
class Actuation:
    """What drives each joint. Arrays of shape (m,), one value per actuator."""

    torque_limit: Vector
    """The largest torque that the driver lets through, N·m."""
    damping: Vector
    """Back-EMF of the motor seen at the joint, N·m·s/rad."""
    armature: Vector
    """Rotor inertia seen at the joint, kg·m²."""
    frictionloss: Vector
    """Dry friction, N·m."""


@dataclass(frozen=True, slots=True)
class ForeignModel:
    """Somebody else's MJCF of the same hand, and where our names are in it."""

    mjcf: str
    """Path of the file."""
    root: str
    """Body that is the palm."""
    joints: tuple[str, ...]
    """Its joint names in our order, length n."""
    tips: Mapping[str, tuple[str, tuple[float, float, float]]]
    """For each finger the body that ends it and the fingertip's centre in that body's frame, m."""


@dataclass(frozen=True, slots=True, eq=False)
class HandSpec:
    """A hand's identity card, shared by every backend."""

    model: str
    side: Side
    joints: tuple[str, ...]
    """Names in the description files, in the order of every array, length n."""
    fingers: tuple[Finger, ...]
    lower: Vector
    """Lowest joint positions, shape (n,), rad."""
    upper: Vector
    """Highest joint positions, shape (n,), rad."""
    actuation: Actuation
    mirror_flips: tuple[int, ...]
    """Joints whose sign changes from one side to the other."""
    serial: str = ""
    """The hand's own file in conf/hands; empty for the nominal hand."""
    aliases: tuple[str, ...] = field(default=())
    """Readable joint names (`index_0` … `thumb_3`), in the same order."""
    foreign: ForeignModel | None = None
    """Simulate this file instead of ours."""
    commands: tuple[CommandKind, ...] = ("torque",)
    """What it takes; a hand that takes torques takes nothing else."""
    drive: Drive | None = None
    """What its drive does beyond `actuation`; None: nothing, where the hand's file says nothing."""

    @property
    def name(self) -> str:
        return f"{self.model}_{self.side}"

    @property
    def n_joints(self) -> int:
        return len(self.joints)

    @property
    def n_actuators(self) -> int:
        return len(self.actuation.torque_limit)

    def joint(self, name: str) -> int:
        """The index of a joint by either of its names. Raises ConfigError with the nearest names."""
        for names in (self.joints, self.aliases):
            if name in names:
                return names.index(name)
        raise ConfigError(unknown("joint", name, self.joints + self.aliases))

    def finger(self, name: str) -> Finger:
        """A finger by its name. Raises ConfigError with the nearest names."""
        for finger in self.fingers:
            if finger.name == name:
                return finger
        raise ConfigError(unknown("finger", name, [f.name for f in self.fingers]))

    def vector(self, values: ArrayLike, what: str) -> Vector:
        """One value per joint, read-only, shape (n,); a single number stands for all. Raises ConfigError."""
        array = np.asarray(values, dtype=np.float64)
        if array.ndim == 0:
            array = np.full(self.n_joints, float(array))
        if array.shape != (self.n_joints,):
            raise ConfigError(f"{what} needs one value or {self.n_joints}, one per joint; it has {array.size}")
        if not np.isfinite(array).all():
            bad = int(np.flatnonzero(~np.isfinite(array))[0])
            raise ConfigError(f"{what} for {self.joints[bad]} is {array[bad]}; every value must be finite")
        return frozen(array)

    def posture(self, values: ArrayLike, what: str = "posture") -> Vector:
        """Joint positions inside the limits, shape (n,), rad. Raises ConfigError naming the joint and the excess."""
        array = self.vector(values, what)
        excess = np.maximum(self.lower - array, array - self.upper)
        worst = int(np.argmax(excess))
        if excess[worst] > 1e-9:
            raise ConfigError(
                f"{what}: {self.aliases[worst] if self.aliases else self.joints[worst]} = {array[worst]:.4f} rad is "
                f"{excess[worst]:.4f} rad outside its limits [{self.lower[worst]:.4f}, {self.upper[worst]:.4f}]"
            )
        return array

    def mirrored(self, position: Array) -> Array:
        """The same posture on the hand of the other side, shape (..., n), rad."""
        other = np.array(position, dtype=np.float64)
        other[..., list(self.mirror_flips)] *= -1.0
        return other


def aliases(fingers: Sequence[Finger], n_joints: int) -> tuple[str, ...]:
    """Readable joint names: the finger, and the joint's place in it counted from the palm."""
    names = [""] * n_joints
    for finger in fingers:
        for place, joint in enumerate(finger.joints):
            names[joint] = f"{finger.name}_{place}"
    return tuple(names)
