"""Spec of a hand: names, fingers, limits and actuation. Nothing outside a hand's own files assumes sixteen joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.spec.coupled_joints import CoupledJoint, CoupledTable, coupled_tables
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.spec.thermal import ThermalData
from allegro_twin.types import Array, Vector, frozen

Side: TypeAlias = Literal["right", "left"]
SIDES: tuple[Side, Side] = ("right", "left")


def check_side(side: object, what: str = "side") -> None:
    """Raises ConfigError for what is no side of a hand; `what` it is stands in the message."""
    if side not in SIDES:
        raise ConfigError(f"{what} is {' or '.join(SIDES)}, not {side!r}")


CommandKind: TypeAlias = Literal["torque", "position", "limited_position", "timed_position"]
"""What a hand takes: torques; positions; positions with a limited effort, or in a given time."""


@dataclass(frozen=True, slots=True)
class Finger:
    """One finger: the indices of its joints from the palm outward, and the name of its tip's frame."""

    name: str
    joints: tuple[int, ...]
    tip: str
    """A link in the URDF and a site in the MJCF: the centre of the fingertip sphere."""


@dataclass(frozen=True, slots=True, eq=False)
class Actuation:
    """Motors and friction of the joints. Arrays of shape (m,), one value per actuator."""

    torque_limit: Vector
    """The largest torque that the driver lets through, N·m."""
    damping: Vector
    """Back-EMF of the motor at the joint, N·m·s/rad."""
    armature: Vector
    """Rotor inertia at the joint, kg·m²."""
    frictionloss: Vector
    """Dry friction, N·m."""
    stiffness: Vector | None = None
    """Stiffness of the loop that the hand's firmware closes, N·m/rad; None for a hand that takes torques."""
    velocity_limit: Vector | None = None
    """The maker's limit of joint speed, rad/s; None: unknown."""
    torque_rate: Vector | None = None
    """The fastest that a commanded torque may change, N·m/s; None: at once."""


@dataclass(frozen=True, slots=True)
class ForeignModel:
    """Somebody else's MJCF of a hand, and where our names are in it."""

    mjcf: str
    """Path of the file."""
    root: str
    """Body that is the palm."""
    joints: tuple[str, ...]
    """Its joint names in our order, length n; of its actuators, where these are kept."""
    tips: Mapping[str, tuple[str, tuple[float, float, float]]]
    """For each finger the body that ends it and the fingertip's centre in that body's frame, m."""
    palm: tuple[float, float, float, float] | None = None
    """How the palm's frame is turned in the root's, quaternion w x y z; None: as it is."""
    keeps: bool = False
    """Its actuators, ranges and frictions are the hand's; else they give way to torque motors with the spec's."""
    touching: tuple[tuple[str, str], ...] = ()
    """Pairs of its bodies that are let through each other."""


@dataclass(frozen=True, slots=True, eq=False)
class HandSpec:
    """Everything that identifies a hand, shared by every backend."""

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
    """Commands that it takes; a hand that takes torques takes nothing else."""
    followers: tuple[CoupledJoint, ...] = ()
    """Coupled joints, which no sensor measures: tendons, linkages and springs move them with the driven ones."""
    apart: tuple[tuple[str, str], ...] = ()
    """Pairs of fingers that could hook into each other: no command may lead them there."""
    drive: Drive | None = None
    """Effects of its drive beyond `actuation`; None: none."""
    thermal: ThermalData | None = None
    """How its motors warm; None: unknown."""
    card: str = ""
    """The path of the card that describes it, where no name does."""
    postures: Mapping[str, Vector] = field(default_factory=dict)
    """Postures that the card names, such as `home`, (n,), rad."""
    coarsest_step: float = float("inf")
    """The longest physics step that simulates it truly, s; inf: any that is usual here (up to 3 ms)."""

    @property
    def name(self) -> str:
        return f"{self.model}_{self.side}"

    @property
    def root(self) -> str:
        """The root body, in whose frame a state reports gravity."""
        return "palm_link"

    @property
    def rest(self) -> Vector:
        """Where a simulation begins by default, (n,), rad: the nearest to zero inside the limits."""
        return np.minimum(np.maximum(self.lower, 0.0), self.upper)

    @property
    def model_reference(self) -> str:
        """The reference to this model of hand in files: its name, or its card's path."""
        return self.card or self.model

    @property
    def joint_labels(self) -> tuple[str, ...]:
        """A name for each joint, for people: `index_0`, or that of the description where a joint moves several
        fingers."""
        return self.aliases or self.joints

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

    def finger_of(self, joint: int) -> int:
        """Index of the finger that a joint moves, the first one where it moves several. Raises ConfigError for a joint
        of none."""
        for number, finger in enumerate(self.fingers):
            if joint in finger.joints:
                return number
        raise ConfigError(f"joint {joint} of {self.name} moves no finger")

    def coupled_positions(self, position: Array) -> Array:
        """Positions of coupled joints with nothing in their way, (..., n) → (..., followers), rad or m: an estimate."""
        found = np.empty((*position.shape[:-1], len(self.followers)))
        for way in _ways(self):
            found[..., way.places] = way.at(position)
        return found

    def coupled_each(self, motors: Array) -> Array:
        """Positions of coupled joints if each had a motor of its own, with the motors at `motors`, (..., followers) →
        (..., followers)."""
        found = np.empty(motors.shape)
        for way in _ways(self):
            found[..., way.places] = way.each(motors[..., way.places])
        return found

    def coupled_rates(self, position: Array) -> Array:
        """Speed of each coupled joint per speed of its motor, (..., n) → (..., followers)."""
        rates = np.zeros((*position.shape[:-1], len(self.followers)))
        for k, each in enumerate(self.followers):
            lower, steps = self.lower[each.driven], len(each.positions) - 1
            width = (self.upper[each.driven] - lower) / steps
            stretch = np.clip(((position[..., each.driven] - lower) / width).astype(np.int64), 0, steps - 1)
            rates[..., k] = (np.diff(each.positions) / width)[stretch]
        return rates

    @property
    def all_joints(self) -> tuple[str, ...]:
        """Names of all joints: driven ones, then coupled ones."""
        return self.joints + tuple(each.name for each in self.followers)

    def all_positions(self, position: Array) -> Array:
        """Positions of `all_joints`, (..., n) → (..., n + followers): estimates for the coupled ones."""
        return np.concatenate([position, self.coupled_positions(position)], axis=-1) if self.followers else position

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
        if said := self.limit_violation(array, self.lower, self.upper, 1e-9):
            raise ConfigError(f"{what}: {said}")
        return array

    def measured_posture(self, values: ArrayLike, what: str = "posture") -> Vector:
        """As `posture`, for joint positions read from a hand: an excess of GIVE at most, by which a stop yields, is
        clipped."""
        array = self.vector(values, what)
        if said := self.limit_violation(array, self.lower, self.upper, GIVE):
            raise ConfigError(f"{what}: {said}")
        return frozen(np.clip(array, self.lower, self.upper))

    def limit_violation(
        self, posture: Vector, lower: Vector, upper: Vector, give: float, of: str = "outside its limits"
    ) -> str:
        """Which joint of a posture, (n,), rad, is furthest beyond two bounds, (n,) each, rad, and by how much, with
        the digits that show it; empty where none is by more than `give`, rad."""
        excess = np.maximum(lower - posture, posture - upper)
        worst = int(np.argmax(excess))
        value, least, most, over = (float(each[worst]) for each in (posture, lower, upper, excess))
        if over <= give:
            return ""
        digits = 4 if round(over, 6) >= 0.001 else 2 - math.floor(math.log10(over))
        said = (
            f"{self.joint_labels[worst]} = {value:.{digits}f} rad is {over:.{digits}f} rad {of} "
            f"[{least:.{digits}f}, {most:.{digits}f}]"
        )
        if least <= math.radians(value) <= most and abs(value) > math.pi:
            said += f"; positions are in radians: {value:g}° is {math.radians(value):.4f} rad"
        return said

    def check_step(self, step: float, key: str) -> None:
        """Raises ConfigError for a physics step, s, that a key asks for and that is too long for this hand."""
        if step > self.coarsest_step:
            raise ConfigError(f"{key} {step:g} s: {self.name} is simulated truly in steps of at most "
                              f"{self.coarsest_step:g} s: leave it out, or take 0.001")  # fmt: skip

    def longest_step(self, period: float) -> float:
        """Longest physics step, s, in which this hand is simulated truly and of which a whole number is `period`, s."""
        return period / max(math.ceil(period / self.coarsest_step - 1e-9), 1)

    def mirror_posture(self, position: Array) -> Array:
        """Mirror image of a posture, for the hand of the other side, (..., n), rad."""
        other = np.array(position, dtype=np.float64)
        other[..., list(self.mirror_flips)] *= -1.0
        return other


GIVE = 0.02
"""rad that a joint position read from a hand may lie beyond the joint's limit: a joint that leans on its stop gives. By
the models of the five hands 0.0007 rad under gravity, and 0.011 rad where a joint meets its stop under all its torque
(tests/surfaces/hand/test_set_points.py); about twice that, for a real stop is softer or harder than a model's."""


def aliases(fingers: Sequence[Finger], n_joints: int) -> tuple[str, ...]:
    """Readable joint names: the finger, and the joint's place in it counted from the palm."""
    names = [""] * n_joints
    for finger in fingers:
        for place, joint in enumerate(finger.joints):
            names[joint] = f"{finger.name}_{place}"
    return tuple(names)


@lru_cache(maxsize=64)
def _ways(spec: HandSpec) -> list[CoupledTable]:
    return coupled_tables(spec.followers, spec.lower, spec.upper)
