"""Library entries: postures, grasps and trajectories, each stored for one side and mirrored for the other.

An entry is stored once, for the side that it was made on. The other side is derived from it whenever it is asked for,
by `HandSpec.mirror_posture`: exact, because only signs change. So the two sides cannot differ, whoever edits the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from allegro_twin.control.trajectory import Profile
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.schema import Positive, Settings, Where, parse_settings
from allegro_twin.hands.library.taxonomy import ClaimedType, ObservedType
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array, Vector


class CentroidGrip(Settings):
    """Close softly until every finger has met the object, then press through the centroid of the contacts."""

    kind: Literal["centroid"]
    fingers: Annotated[tuple[str, ...], Field(min_length=2, max_length=4)]
    """The last one opposes the others: the thumb."""
    force: Positive = 3.0
    """On the thumb, N."""
    spread: Annotated[float, Field(ge=0, le=1)] = 0.25
    """How much of a finger's force may point toward the others."""
    stiffness: Positive = 1200.0
    """Against a motion of the object, N/m."""
    closing: Annotated[float, Field(gt=0, le=1)] = 0.25
    """The most that a joint pushes before contact, as a fraction of its torque limit."""


class EnvelopGrip(Settings):
    """Wrap every link around the object with constant torques."""

    kind: Literal["envelop"]
    torque: dict[str, list[float]]
    """For each finger that wraps, torques at scale 1, N·m; a zero leaves the joint where the pre-shape has it."""
    scale: Positive = 1.0
    stiffness: Annotated[float, Field(ge=0)] = 4.0
    """Against a motion of the wrapped object, N·m/rad."""
    closing: Annotated[float, Field(gt=0, le=1)] = 0.3
    """Scale of the torques before the squeeze."""


class LatchGrip(Settings):
    """Close with little torque until the object stops the fingers, then squeeze from where they are: by the difference
    between the stored squeeze and close."""

    kind: Literal["latch"]
    closing: Annotated[float, Field(gt=0, le=1)] = 0.2
    """The most that a joint pushes before it squeezes, as a fraction of its torque limit."""
    beyond: Annotated[float, Field(ge=0, le=0.5)] = 0.12
    """How far joints that close go on beyond the stored close if nothing stops them, rad."""


Grip: TypeAlias = Annotated[CentroidGrip | EnvelopGrip | LatchGrip, Field(discriminator="kind")]


Angles: TypeAlias = dict[str, list[float]]
"""For each finger the positions of its joints from the palm outward, rad; for each joint its position, where one joint
moves several fingers."""
EntryKind: TypeAlias = Literal["posture", "grasp", "trajectory"]
HAND = "allegro"
"""The hand of an entry that does not name one."""


class PostureFile(Settings):
    """A posture as it is stored."""

    joint_fields: ClassVar[tuple[str, ...]] = ("angles",)
    kind: Literal["posture"] = "posture"
    description: str = ""
    hand: str = HAND
    """The model of hand that it is of."""
    side: Side = "right"
    """The side that the angles are for; the other hand uses their mirror image."""
    angles: Angles


class PlanRecord(Settings):
    """Origin of a planned grasp, and its success rate in draws that it was not chosen on."""

    seed: Annotated[int, Field(ge=0)]
    candidates: Annotated[int, Field(ge=0)]
    """How many physics closed in its search: the same seed and as many candidates find it again, unless time cut its
    first round short."""
    held: Annotated[int, Field(ge=0)]
    draws: Annotated[int, Field(ge=0)]
    low: Annotated[float, Field(ge=0, le=1)]
    high: Annotated[float, Field(ge=0, le=1)]
    """95 % Wilson interval of the rate."""
    protocol: str
    """Name and version of what it was judged under."""
    uncertainty: str
    """The perturbations, in half-widths: m, degrees, fractions."""


class GraspFile(Settings):
    """A grasp as it is stored."""

    joint_fields: ClassVar[tuple[str, ...]] = ("preshape", "close", "squeeze")
    kind: Literal["grasp"] = "grasp"
    description: str = ""
    hand: str = HAND
    """The model of hand that it is of."""
    taxonomy: ClaimedType
    """The type that it claims to be."""
    observed: ObservedType | None = None
    """The type that the contacts of its trial (`evidence`) show; None: nobody has looked."""
    object_size: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] | None = None
    """Smallest and largest width between the fingers of the objects that it is for, m; None: unknown."""
    side: Side = "right"
    """The side that the angles are for; the other hand uses their mirror image."""
    speed: Annotated[float, Field(gt=0)] = 1.0
    """Peak speed while closing of the joint that travels furthest, rad/s."""
    profile: Profile = "minimum_jerk"
    preshape: Angles
    close: Angles
    squeeze: Angles
    """Inside the object: the difference to where the fingers are stopped, times the stiffness, is the torque."""
    grip: Grip | None = None
    """How the force is controlled; None: by position alone, at the squeeze."""
    evidence: str = ""
    """The scenario in which it holds an object, or `posture: ` and why it is only a posture."""
    planned: PlanRecord | None = None
    """Record of the search, of a grasp that `plan` found."""

    @model_validator(mode="after")
    def _ordered(self) -> GraspFile:
        if self.object_size is not None and self.object_size[0] > self.object_size[1]:
            raise ValueError(f"object_size: the smallest width comes first, not {list(self.object_size)}")
        return self

    @property
    def kind_of_grasp(self) -> ClaimedType | ObservedType:
        """The type that it is: the one observed, else the one that it claims."""
        return self.taxonomy if self.observed is None else self.observed

    @property
    def fingers(self) -> tuple[str, ...]:
        """The fingers that press: those that move by more than 1 mrad from the pre-shape to the squeeze."""
        from_, to = self.preshape, self.squeeze
        return tuple(f for f in from_ if np.abs(np.subtract(to.get(f, from_[f]), from_[f])).max() > 1e-3)


class TrajectoryFile(Settings):
    """A motion as it is stored: joint positions at times, as somebody has shown it to the hand."""

    joint_fields: ClassVar[tuple[str, ...]] = ("positions",)
    kind: Literal["trajectory"] = "trajectory"
    description: str = ""
    hand: str = HAND
    """The model of hand that it is of."""
    side: Side = "right"
    """The side that the positions are for; the other hand uses their mirror image."""
    times: Annotated[tuple[float, ...], Field(min_length=2)]
    """Ascending, s; the motion begins at the first."""
    positions: tuple[tuple[float, ...], ...]
    """For each time one value a joint, in the order of the hand's joints, rad."""

    @model_validator(mode="after")
    def _timed(self) -> TrajectoryFile:
        if len(self.times) != len(self.positions):
            raise ValueError(f"{len(self.times)} times and {len(self.positions)} positions: each needs the other")
        for before, after in pairwise(self.times):
            if not after > before:
                raise ValueError(f"times must ascend; {after:g} s comes after {before:g} s")
        return self


Entry: TypeAlias = PostureFile | GraspFile | TrajectoryFile
_MODELS: dict[str, type[PostureFile] | type[GraspFile] | type[TrajectoryFile]] = {
    "posture": PostureFile,
    "grasp": GraspFile,
    "trajectory": TrajectoryFile,
}
# What an entry without `kind` is recognised by.
_MARKS = {"angles": "posture", "taxonomy": "grasp", "preshape": "grasp", "close": "grasp", "times": "trajectory"}


def parse_entry(content: Any, source: Where) -> Entry:
    """An entry from a mapping; `source` is named in the error. Raises ConfigError."""
    where = source if isinstance(source, str) else source(("kind",))
    if not isinstance(content, dict):
        raise ConfigError(f"{where}: must hold a mapping of keys to values, not {type(content).__name__}")
    marked = next((kind for mark, kind in _MARKS.items() if mark in content), None)
    kind = content.get("kind", marked)
    if kind is None:
        raise ConfigError(f"{where}: kind: missing; it is one of {', '.join(_MODELS)}")
    if kind not in _MODELS:
        raise ConfigError(f"{where}: kind: {unknown('kind', str(kind), _MODELS)}")
    return parse_settings(_MODELS[kind], content, source)


def posture_entry(position: ArrayLike, spec: HandSpec, description: str = "") -> PostureFile:
    """An entry from joint positions of the spec's hand, shape (n,), rad, which may be as it reports them: clipped by
    `spec.measured_posture`. Raises ConfigError outside the limits."""
    values = spec.measured_posture(position)
    return PostureFile(description=description, side=spec.side, angles=angles_by_finger(values, spec), **_whose(spec))


def grasp_entry(
    postures: Mapping[str, Vector], spec: HandSpec, taxonomy: ClaimedType, description: str = "", evidence: str = "",
    object_size: tuple[float, float] | None = None,
) -> GraspFile:  # fmt: skip
    """An entry from `preshape`, `close` and `squeeze`, (n,) each, rad, of the spec's hand. Raises ConfigError outside
    the limits."""
    preshape, close, squeeze = (
        angles_by_finger(spec.posture(postures[name], name), spec) for name in GraspFile.joint_fields
    )
    return GraspFile(
        description=description, taxonomy=taxonomy, side=spec.side, evidence=evidence, object_size=object_size,
        preshape=preshape, close=close, squeeze=squeeze, **_whose(spec),
    )  # fmt: skip


def trajectory_entry(times: ArrayLike, positions: ArrayLike, spec: HandSpec, description: str = "") -> TrajectoryFile:
    """An entry from times, shape (k,), s, and joint positions of the spec's hand, shape (k, n), rad, which may be as it
    reports them: clipped by `spec.measured_posture`. Raises ConfigError outside the limits."""
    rows = [
        spec.measured_posture(row, f"positions[{number}]").tolist() for number, row in enumerate(np.asarray(positions))
    ]
    content = {
        "description": description,
        "side": spec.side,
        "times": np.asarray(times, dtype=np.float64).tolist(),
        "positions": rows,
        **_whose(spec),
    }
    entry = parse_settings(TrajectoryFile, content, "trajectory")
    joint_values(entry, spec, "trajectory")
    return entry


def joint_values(entry: Entry, spec: HandSpec, where: str) -> dict[str, Array]:
    """Each of the entry's joint fields for the spec's side, shape (n,) or (k, n), rad.

    Raises ConfigError for a wrong number of joints, and for one outside its limits: which, and by how much.
    """
    if entry.hand != spec.model:
        raise ConfigError(f"{where}: a {entry.kind} of the hand {entry.hand}; this one is {spec.model}")
    found: dict[str, Array] = {}
    for field in entry.joint_fields:
        values: Any = getattr(entry, field)
        many = not isinstance(values, dict)
        rows = []
        for number, row in enumerate(values if many else [values]):
            what = f"{where}: {field}[{number}]" if many else f"{where}: {field}"
            vector = spec.vector(row, what) if many else joint_vector(row, spec, what)
            rows.append(spec.posture(vector if entry.side == spec.side else spec.mirror_posture(vector), what))
        found[field] = np.array(rows) if many else rows[0]
    return found


def convert_side(entry: Entry, spec: HandSpec, side: Side, where: str) -> Entry:
    """Convert an entry to a side: its mirror image, exact to the bit, when it is written for the other."""
    if entry.side == side:
        return entry
    changed: dict[str, Any] = {"side": side}
    for field in entry.joint_fields:
        values: Any = getattr(entry, field)
        if isinstance(values, dict):
            changed[field] = angles_by_finger(spec.mirror_posture(joint_vector(values, spec, where)), spec)
        else:
            changed[field] = tuple(tuple(row) for row in spec.mirror_posture(np.array(values)).tolist())
    if isinstance(entry, GraspFile):
        changed["grip"] = mirror_grip(entry.grip, spec)
    return entry.model_copy(update=changed)


def mirror_grip(grip: Grip | None, spec: HandSpec) -> Grip | None:
    """Mirror a grip for the other hand: torques change sign where joints do."""
    if not isinstance(grip, EnvelopGrip):
        return grip
    flips = set(spec.mirror_flips)
    torque = {
        name: [-value if joint in flips else value for joint, value in zip(spec.finger(name).joints, row, strict=True)]
        for name, row in grip.torque.items()
    }
    return grip.model_copy(update={"torque": torque})


def joint_vector(angles: Mapping[str, list[float]], spec: HandSpec, what: str) -> Vector:
    """One vector in the spec's order, shape (n,), rad, from angles by finger. Raises ConfigError."""
    values = np.full(spec.n_joints, np.nan)
    for name, row in angles.items():
        joints = spec.finger(name).joints if spec.aliases else (spec.joint(name),)
        if len(row) != len(joints):
            raise ConfigError(f"{what}: {name} has {len(joints)} joints, not {len(row)}")
        values[list(joints)] = row
    names = [finger.name for finger in spec.fingers] if spec.aliases else spec.joints
    if missing := [name for name in names if name not in angles]:
        raise ConfigError(f"{what}: {', '.join(missing)} missing: give the angles of every finger, rad")
    return spec.vector(values, what)


def _whose(spec: HandSpec) -> dict[str, Any]:
    return {} if spec.model == HAND else {"hand": spec.model}


def angles_by_finger(values: Vector, spec: HandSpec) -> Angles:
    """Angles by finger; by joint, where one joint moves several fingers."""
    if not spec.aliases:
        return {name: [value] for name, value in zip(spec.joints, values.tolist(), strict=True)}
    return {finger.name: values[list(finger.joints)].tolist() for finger in spec.fingers}
