"""A scenario: what lies on the table, how the wrist moves, which grasp, and what counts as success."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import find_file, is_file, read_yaml
from allegro_twin.files.schema import Gravity, Positive, Settings, Vector3, load_settings, parse_settings
from allegro_twin.grasping.interchange.grasps import FARTHEST
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.hands.settings import with_card_side
from allegro_twin.kinematics.orientation import matrix_facing
from allegro_twin.sim.model.physics import Cone, Integrator, Physics, Solver
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Vector


def _in_metres(length: float) -> float:
    return _all_in_metres((length,))[0]


def _all_in_metres(lengths: _Lengths) -> _Lengths:
    if max(map(abs, lengths), default=0.0) > FARTHEST:
        raise ValueError(f"lengths are in m, here at most {FARTHEST:g} (if these are mm, divide them by 1000)")
    return lengths


_Lengths = TypeVar("_Lengths", bound=tuple[float, ...])
Length = Annotated[Positive, AfterValidator(_in_metres)]
"""m, at most what is around a hand."""
Offset = Annotated[Vector3, AfterValidator(_all_in_metres)]
"""m, at most so far along each axis."""


class Shake(Settings):
    """A sine along the world's x, then y, then z."""

    acceleration: Positive
    """Peak, m/s²."""
    frequency: Positive = 2.0
    """Hz."""


class Phase(Settings):
    """A stretch of the timeline. The wrist and the hand both act, or either, or none."""

    name: str
    seconds: Positive | None = None
    """Only a phase that closes the hand may leave it out: it then lasts as long as the grasp's speed says."""
    hand: Literal["preshape", "close", "squeeze"] | None = None
    posture: tuple[float, ...] | None = None
    """In place of `hand`: where the joints of the right hand go, rad."""
    wrist: Literal["approach"] | None = None
    """`approach`: from the retreat to the grasp pose."""
    move: Offset = (0.0, 0.0, 0.0)
    """m, world axes."""
    turn: Vector3 = (0.0, 0.0, 0.0)
    """Degrees about the palm's own x, y, z."""
    shake: Shake | None = None
    push: Vector3 = (0.0, 0.0, 0.0)
    """Throughout the phase on the object's centre of mass, as the acceleration that it would give it, m/s², world."""
    check: bool = False
    """The object must be held at the end of this phase."""

    @model_validator(mode="after")
    def _lasts(self) -> Phase:
        if self.seconds is None and self.hand is None:
            raise ValueError("a phase without a hand motion needs `seconds`")
        if self.posture is not None and self.hand is not None:
            raise ValueError("a phase has `hand` or `posture`, not both")
        return self


class Success(Settings):
    """Limits of the object's motion in the palm's frame."""

    drift: Positive = 0.010
    """m."""
    rotation: Positive = 15.0
    """Degrees."""
    throughout: bool = False
    """During the whole of every phase that checks, not only at its end."""


class PhysicsSettings(Settings):
    """Changes to the physics of every scene (sim.physics)."""

    timestep: Positive | None = None
    """s."""
    softness: Positive | None = None
    """Time constant of contacts, s."""
    impratio: Positive | None = None
    noslip: Annotated[int, Field(ge=0)] | None = None
    torsional: Positive | None = None
    """m."""
    rolling: Positive | None = None
    """m."""
    cone: Cone | None = None
    integrator: Integrator | None = None
    solver: Solver | None = None
    gravity: Gravity | None = None
    """World, m/s²."""
    friction: Positive = 1.0
    """Factor on the scenario's sliding friction."""

    def physics(self) -> Physics:
        """Those of a scene."""
        return Physics(**self.model_dump(exclude_none=True, exclude={"friction"}))


class TrialProtocol(Settings):
    """The timeline and the verdict, shared by scenarios so that their results compare."""

    version: int
    physics: PhysicsSettings = PhysicsSettings()
    floating: bool = False
    """There is no table: the object hangs where the grasp meets it."""
    mass: Positive | None = None
    """Mass of the object, kg; None: its own."""
    friction: Annotated[float, Field(gt=0, le=2.0)] | None = None
    """Sliding friction of every contact; None: the scenario's."""
    gains: str | None = None
    """Gains of the hand's position controller; None: those of whoever runs it."""
    period: Positive | None = None
    """Control period, s; None: the hand's."""
    directions: Literal[1, 6] = 1
    """6: a trial for each of ±x, ±y, ±z, to which the pushes along x are turned."""
    phases: Annotated[tuple[Phase, ...], Field(min_length=1)]
    reference: str
    success: Success = Success()

    @model_validator(mode="after")
    def _names(self) -> TrialProtocol:
        names = [phase.name for phase in self.phases]
        if len(set(names)) < len(names):
            raise ValueError(f"phases must have different names: {', '.join(names)}")
        if self.reference not in names:
            raise ValueError(f"reference {self.reference!r} names no phase; there are: {', '.join(names)}")
        return self

    @property
    def after_reference(self) -> tuple[Phase, ...]:
        """The phases in which motion in the hand counts."""
        names = [phase.name for phase in self.phases]
        return self.phases[names.index(self.reference) + 1 :]


_KEYS_OF_PRIMITIVE = ("size", "mass")
_KEYS_OF_SHAPE = {"": ("mass",), "mesh": ("file", "scale", "collision", "mass"), "mjcf": ("file",)}
"""What counts of an object, besides where it stands; "": of the catalogue."""


class ScenarioObject(Settings):
    """One object: from the catalogue by name, or given here."""

    name: str
    shape: Literal["sphere", "cylinder", "box", "ellipsoid", "mesh", "mjcf"] | None = None
    """None: look the name up in the catalogue."""
    size: Annotated[tuple[Positive, ...], AfterValidator(_all_in_metres)] | None = None
    """m. Sphere: diameter. Cylinder: diameter, height. Box: edges. Ellipsoid: short, long diameter."""
    mass: Positive | None = None
    """kg; by default that of the catalogue, of a mesh 500 kg/m³ times its volume. An MJCF brings its own."""
    file: Path | None = None
    """File of a mesh (.obj, .stl) or an MJCF; a relative path is the scenario's own."""
    scale: Positive | None = None
    """Unit of a mesh's file, m; None: as the file or its size says."""
    collision: Literal["pieces", "hull"] = "pieces"
    """How a mesh collides: as what it is, in convex pieces, or as its hull."""
    up: Literal["x", "y", "z"] = "z"
    """Which of the object's own axes points at the sky."""
    yaw: float = 0.0
    """Turn about the vertical, degrees."""
    at: Annotated[tuple[float, float] | Vector3, AfterValidator(_all_in_metres)] = (0.0, 0.0)
    """Middle of the object on the table, m; with a third value its height, else it stands on the table."""

    @model_validator(mode="after")
    def _heard(self) -> ScenarioObject:
        fields = ScenarioObject.model_fields
        used = _KEYS_OF_SHAPE.get(self.shape or "", _KEYS_OF_PRIMITIVE)
        for key in ("size", "mass", "file", "scale", "collision"):
            if key in used or getattr(self, key) == fields[key].default:
                continue
            if self.shape is None:
                raise ValueError(
                    f"{self.name}: `{key}` without `shape`: an object of the catalogue takes `mass`, `up`, "
                    f"`yaw` and `at`; for another {key} give a shape of your own (sphere, cylinder, box, ellipsoid, "
                    "mesh, mjcf)"
                )
            raise ValueError(f"{self.name}: a {self.shape} has no `{key}`; its keys are {', '.join(used)}, up, yaw, at")
        return self

    @model_validator(mode="after")
    def _known(self) -> ScenarioObject:
        from allegro_twin.sim.objects.catalogue import SIZES_OF_KIND, object_catalogue

        if self.shape is None:
            if self.name not in (known := object_catalogue()):
                raise ValueError(unknown("object", self.name, known))
            return self
        numbers, needs = SIZES_OF_KIND.get(self.shape), f"object {self.name}: a {self.shape} needs"
        if numbers is None and self.file is None:
            raise ValueError(f"{needs} `file`")
        if numbers is not None and len(self.size or ()) != numbers:
            raise ValueError(f"{needs} `size` with {numbers} values, m")
        if numbers is not None and self.mass is None:
            raise ValueError(f"{needs} `mass`, kg")
        if self.shape == "mjcf" and len(self.at) != 3:
            raise ValueError(f"{needs} a third value in `at`: the height of its origin, m")
        return self


def check_object_names(objects: Sequence[ScenarioObject]) -> None:
    """Raises ConfigError where two objects have one name."""
    names = [each.name for each in objects]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(
            f"two objects are named {twice}: objects have different names; give the second one a name, shape, size and "
            f"mass of its own: {{name: {twice}_2, shape: box, …}}"
        )


class StandSettings(Settings):
    """A fixed block on the table, on which the first object lies: room for fingers below and around it."""

    height: Length
    """m."""
    size: tuple[Length, Length] = (0.04, 0.04)
    """Edges along the world's x and y, m."""


class PalmHeight(Settings):
    """Height of the palm, for objects that are taken from above, whatever their size."""

    table: Length
    """At least so far above what the object stands on, m."""
    top: Length
    """And at least so far above the object's top, m."""


class Wrist(Settings):
    """Pose of the palm when the fingers close, from the middle of the first object, world axes."""

    position: Offset
    """m, of the palm's origin."""
    over: PalmHeight | None = None
    """Replaces the third number of `position`."""
    facing: Vector3
    """Where the palm looks: the direction of its x axis."""
    fingers: Vector3
    """Where stretched fingers point: the direction of its z axis, made square to `facing`."""
    retreat: Offset
    """From the grasp pose to where the approach begins, m."""


_SQUARE = 1.0
"""Degrees by which `fingers` may be off square to `facing` without a word: rounded numbers are."""


def skew_warning(wrist: Wrist) -> str | None:
    """A line for fingers that are not square to where the palm looks; None where they are."""
    size = math.hypot(*wrist.facing) * math.hypot(*wrist.fingers)
    cosine = sum(a * b for a, b in zip(wrist.facing, wrist.fingers, strict=True)) / size
    off = math.degrees(math.asin(max(-1.0, min(1.0, cosine))))
    if abs(off) <= _SQUARE:
        return None
    return f"wrist: fingers are {abs(off):.1f}° off square to facing, and are turned by so much to be square"


class EdgePush(Settings):
    """Push before the grasp: the hand pushes the first object along the table, over its edge, and lets go of it."""

    distance: Length
    """m, along x, that the palm goes with its fingers behind the object."""
    wrist: Wrist
    """Where the palm is when it begins; `retreat` is from where it comes down, and to where it goes up again."""
    posture: tuple[float, ...]
    """Where the joints of the right hand are meanwhile, rad."""
    speed: Positive = 0.08
    """m/s, on average."""


class Scenario(Settings):
    """One trial, written for the right hand; the left hand performs its mirror image. Shapes are not mirrored."""

    description: str = ""
    objects: Annotated[tuple[ScenarioObject, ...], Field(min_length=1)]
    """The first is the one to grasp."""
    friction: Annotated[float, Field(gt=0, le=1.0)] = 0.8
    """Sliding friction of every contact."""
    stand: StandSettings | None = None
    """None: the objects lie on the table."""
    edge: Length | None = None
    """The table ends so far from the middle of the first object, along x, m; None: far away."""
    push: EdgePush | None = None
    """None: the object is grasped where it is."""
    grasp: str
    """Name in the grasp library, or a file; a relative path is the scenario's own."""
    hand: str = HAND
    """The model of hand whose grasp and palm these are, or its card; a relative path is the scenario's own."""
    side: Side = "right"
    """Default: that of the hand's card; of a hand without one, right. Everything else is written for the right hand, of
    which the left performs the mirror image."""
    wrist: Wrist
    protocol: str = "table_pick"
    """Name of a protocol in conf/protocols, or a file; one beside the scenario is the scenario's own."""

    @model_validator(mode="before")
    @classmethod
    def _of_card(cls, values: Any) -> Any:
        return with_card_side(values, "hand")

    @model_validator(mode="after")
    def _ends(self) -> Scenario:
        if self.push is not None and self.edge is None:
            raise ValueError("`push` needs `edge`: how far from the object the table ends, m")
        check_object_names(self.objects)
        return self

    @property
    def model(self) -> str:
        """The name of that model."""
        return Path(self.hand).stem


def as_written(side: Side) -> Vector:
    """Factors, (3,), between a vector as a scenario has it and as it is in the world: scenarios are written for the
    right hand, and a left one performs the mirror image in the x-z plane."""
    return np.array([1.0, -1.0 if side == "left" else 1.0, 1.0])


def load_scenario(name: str | Path) -> tuple[Scenario, Path]:
    """A scenario by path or name, and the file it came from. Raises ConfigError with the file."""
    path = find_file(name, "scenario", "scenarios", below=True)
    content = read_yaml(path)
    named = {key: value for key in ("grasp", "hand") if isinstance(value := content.get(key), str)}
    own = {key: str(path.parent / value) for key, value in named.items() if value.endswith(".yaml")}
    protocol = content.get("protocol")
    if isinstance(protocol, str) and is_file(path.parent / protocol):
        own["protocol"] = str(path.parent / protocol)
    scenario = parse_settings(Scenario, content | own, str(path))
    try:
        for wrist in (scenario.wrist, *(() if scenario.push is None else (scenario.push.wrist,))):
            matrix_facing(wrist.facing, wrist.fingers)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    return scenario, path


def scenario_protocol(scenario: Scenario, path: Path) -> TrialProtocol:
    """The protocol that the scenario in a file names. Raises ConfigError with the file."""
    try:
        return load_protocol(scenario.protocol)
    except ConfigError as error:
        raise ConfigError(f"{path}: protocol: {error}") from error


def scenario_grasp(scenario: Scenario, path: Path, spec: HandSpec, other: str | None = None) -> Grasp:
    """The grasp that the scenario in a file names, or another one, for the spec's side. Raises ConfigError; with the
    file where that names it."""
    try:
        return load_grasp(other or scenario.grasp, spec)
    except ConfigError as error:
        raise error if other else ConfigError(f"{path}: grasp: {error}") from error


def load_scenario_for(
    name: str | Path, spec: HandSpec, *, grasp: str | None = None, object_name: str | None = None
) -> tuple[Scenario, Path, Grasp]:
    """A scenario by path or name, the file it came from, and its grasp for a hand; with another grasp, or another
    object (`with_object`) in place of its first, if they are named. What is replaced need not be there. Raises
    ConfigError."""
    scenario, path = load_scenario(name)
    if scenario.model != spec.model and grasp is None:
        raise ConfigError(f"{path} is for the hand {scenario.model}; this one is {spec.model}: name another grasp, too")
    for index, each in enumerate(scenario.objects):
        if (index or object_name is None) and each.file is not None and not is_file(path.parent / each.file):
            raise ConfigError(f"{path}: objects.{index}.file: no file at {path.parent / each.file}")
    if object_name is not None:
        scenario = with_object(scenario, object_name)
    return scenario, path, scenario_grasp(scenario, path, spec, grasp)


def turn_pushes(protocol: TrialProtocol, axis: int, sign: float) -> TrialProtocol:
    """The protocol with its pushes along x turned to one of the six axes."""

    def turned(push: Vector3) -> Vector3:
        x, y, z = (sign * push[0] if k == axis else 0.0 for k in range(3))
        return x, y, z

    phases = tuple(p.model_copy(update={"push": turned(p.push)}) if any(p.push) else p for p in protocol.phases)
    return protocol.model_copy(update={"phases": phases, "directions": 1})


def load_protocol(name: str) -> TrialProtocol:
    """A protocol by path or name."""
    return load_settings(TrialProtocol, find_file(name, "protocol", "conf/protocols"))


def with_object(scenario: Scenario, name: str) -> Scenario:
    """The scenario with another object (`parse_object`) where its first one stands: at the same place on the table,
    with the same yaw. Raises ConfigError."""
    first, *others = scenario.objects
    placed = parse_object(name).model_copy(update={"at": first.at[:2], "yaw": first.yaw})
    check_object_names((placed, *others))
    return scenario.model_copy(update={"objects": (placed, *others)})


def parse_object(name: str) -> ScenarioObject:
    """An object of the catalogue, or a mesh by its path: in m, standing as its file has it, 500 kg/m³. Raises
    ConfigError for an unknown name and for a file of another kind."""
    from allegro_twin.sim.objects.catalogue import load_object, object_catalogue
    from allegro_twin.sim.objects.meshes import SUFFIXES
    from allegro_twin.sim.objects.scan_files import unread_kind

    path = Path(name)
    if path.suffix.lower() not in SUFFIXES:
        if path.is_file() and name not in object_catalogue():
            raise unread_kind(path)
        return ScenarioObject(name=load_object(name).name)
    return ScenarioObject(name=path.stem, shape="mesh", file=path.resolve())
