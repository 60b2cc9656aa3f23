"""Base class of in-hand tasks: an object in the fingertips of the upturned hand, observed by a camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from allegro_twin.array_api import array_namespace
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.library.entries import HAND
from allegro_twin.learning.environments.objects import ObjectChoice, load_object
from allegro_twin.learning.environments.observation_model import ObjectCamera, ObjectObservation
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.learning.environments.settings import EnvSettings, ResetOptions
from allegro_twin.learning.tasks.base import Flags, Task, Ticks
from allegro_twin.learning.tasks.scenes import (
    FACING,
    OBJECT,
    add_variant,
    make_worlds,
    not_one_environment,
    palm_height,
    palm_turn,
    turn_with_palm,
    upturned_model,
)
from allegro_twin.learning.tasks.start_states import (
    ALL,
    ANYHOW,
    CRADLE,
    FINGERTIPS,
    NOISE_JOINT,
    NOISE_PLACE,
    TEST,
    TRAIN,
    Search,
    StartStates,
    load_start_states,
)
from allegro_twin.learning.tasks.vectors import length, rotate_vectors
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.link_contacts import LinkContacts
from allegro_twin.sim.objects import catalogue
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.types import Array

ON_PALM = 0.005
"""m. An object whose lowest point is less than this above the palm's surface counts as on the palm. Episodes begin 8 mm
or more above (`start_states._GAP`), and an object on the palm is within 1 mm of it."""
_CORNERS, _ROUND, _TUBE, _MESH = range(4)
_KINDS = {"box": _CORNERS, "sphere": _ROUND, "ellipsoid": _ROUND, "cylinder": _TUBE, "mesh": _MESH}


class ObjectShapes:
    """Shapes of objects, on the device of the simulations: kind, half-sizes, (k, 3), m, and for meshes the vertices,
    (k, vertices, 3), m."""

    def __init__(self, objects: Sequence[GraspObject], xp: Any) -> None:
        self.kind = xp.asarray(np.array([_KINDS[grasp_object.shape] for grasp_object in objects]), np.int64)
        self.half = xp.asarray(np.stack([grasp_object.half_extents() for grasp_object in objects]))
        vertices = [
            grasp_object.mesh().vertices if grasp_object.shape == "mesh" else np.zeros((1, 3))
            for grasp_object in objects
        ]
        most = max(map(len, vertices))
        padded = [np.concatenate([each, np.repeat(each[:1], most - len(each), axis=0)]) for each in vertices]
        self.vertices = xp.asarray(np.stack(padded)) if most > 1 else None


def palm_clearance(pose: Array, shapes: ObjectShapes, kind: Array, factor: Array, normal: Array, palm: float) -> Array:
    """Height of the objects' lowest points over the palm's surface, shape (n,), m; negative below it. `pose`: (n, 7),
    world; `kind`: index of each object's shape, (n,); `factor`: its size, (n,); `normal`: of the palm, (n, 3); `palm`:
    height of its surface above its origin, m."""
    xp = array_namespace(pose)
    back = xp.concatenate([pose[:, 3:4], -pose[:, 4:]], axis=-1)
    down, half = -rotate_vectors(back, normal), shapes.half[kind] * factor[:, None]
    parts = xp.abs(down * half)
    shape = shapes.kind[kind]
    tube = length(parts[:, :2]) + parts[:, 2]
    reach = xp.where(shape == _CORNERS, parts.sum(axis=-1), xp.where(shape == _ROUND, length(parts), tube))
    if shapes.vertices is not None:
        points = (shapes.vertices[kind] * down[:, None, :]).sum(axis=-1)
        reach = xp.where(shape == _MESH, xp.max(points, axis=-1) * factor, reach)
    found: Array = (pose[:, :3] * normal).sum(axis=-1) - reach - palm
    return found


LARGEST = 0.09  # m. Longer ones do not fit between the fingers and the thumb.
ASIDE = 0.06  # m from where it began: no longer in the hand.
DROPPED = -20.0  # Cost of losing the object: more than the steps of a throw can earn.
FAST, SPINS = 0.5, 5.0  # m/s and rad/s: scales of the observed speeds.
_FRICTION = (0.5, 1.0)
_NEAR = 16  # States in order of size, among which one near a wanted size is drawn.


OBJECTS = ("cube", "cylinder", "ball", "bar")
"""What the fingertips turn, of conf/in_hand/objects.yaml. Its hex nut is a mesh, which has a batch of its own."""
OF_OTHERS = ("cube",)
"""What the fingertips of another hand turn, where nothing is named: of each more object states are searched for."""
OF_PALM = ("rubiks_cube",)
"""What is turned where the palm is allowed."""


class InHandTask(Task):
    """The palm looks up, and an episode begins in one of the start states, with some noise. Where the palm leans
    (`randomise.wrist_tilt`, or the lean in a twin's file) the object is turned with it: the same grasp under another
    gravity. The world's z stays vertical.

    In the fingertips (`palm: forbidden`, the default) an episode ends when palm or proximal links touch the object:
    only distal and middle links may. With `palm: allowed` it may be put down on the palm. Either way `info` has the
    share of the contact force since the reset by fingertips, middle links and palm (with the proximal links), and
    `on_palm`, the share of time near the palm.
    """

    step: ClassVar[float] = 0.08
    """rad per action, where the settings name no other."""
    options: ClassVar[tuple[str, ...]] = ("object", "size", "friction")
    own_settings: ClassVar[tuple[str, ...]] = ("observation", "palm", "starts", "grip")
    share_terms: ClassVar[tuple[str, ...]] = ("on_palm", "by_tips")
    in_fingertips: ClassVar[tuple[str, ...]] = OBJECTS
    """Objects, where the settings name none and the palm is forbidden."""

    def __init__(self, settings: EnvSettings, n: int, threads: int) -> None:
        super().__init__(settings, n, threads)
        if self.spec.model != HAND and settings.palm == "allowed":
            raise ConfigError(f"{self.name} with palm: allowed is a task of {HAND}; {self.spec.model} has it in the "
                              "fingertips: palm: forbidden")  # fmt: skip
        self.n_privileged = 13 if settings.observation == "full" else 0
        self._held: list[StartStates] = []
        self._objects: list[catalogue.GraspObject] = []
        self._names: list[str] = []
        self._table: StartStates | None = None
        self._shapes: ObjectShapes
        self._palm_ends = settings.palm == "forbidden"
        if settings.starts == "test" and not self._palm_ends:
            raise ConfigError("starts: test is of palm: forbidden; with the palm allowed there is one set of states")
        if settings.grip == "cradle" and not self._palm_ends:
            raise ConfigError("grip: cradle is of palm: forbidden; with the palm allowed an object is held anyhow")
        usual = (self.in_fingertips if self.spec.model == HAND else OF_OTHERS) if self._palm_ends else OF_PALM
        chosen = settings.objects or usual
        self._n_choices = len(chosen)
        objects = [in_hand_object(choice) for choice in chosen]
        for grasp_object in objects:  # Before the first search, which takes its time.
            _check_together(grasp_object, objects[0])
        for grasp_object in objects:
            self._add_object(grasp_object, n, threads)
        self.interface = self._interface(step=self.step)
        self._lower, self._upper = (self.worlds.xp.asarray(limit) for limit in (self.spec.lower, self.spec.upper))
        self.object_body = self.worlds.free_body(OBJECT)
        self.camera = ObjectCamera(settings.randomise, self.object_body, settings.decimation)
        xp = self.worlds.xp
        self.place = xp.zeros((n, 3))
        """Position of the object at the beginning, m, world."""
        self.kind, self._state = xp.zeros(n, np.int64), xp.zeros(n, np.int64)
        self.start: Array = xp.zeros((n, self.spec.n_joints))
        """Set-points of the fingers at the beginning, rad."""
        self._factor, self._low = xp.ones(n), xp.zeros(n)
        """Size factors of the objects; decisions since the reset at which they were on the palm."""
        self._upward, self._facing = xp.asarray(np.array([0.0, 0.0, 1.0])), xp.asarray(FACING)
        self._normal, self._palm = xp.zeros((n, 3)) + self._upward, palm_height(self.spec)
        """Normal of the palm's surface, world; and height of that surface above the palm's origin, m."""
        self._leans = self.spec.drive is not None and bool(self.spec.drive.tilt.any())
        """Whether the hand's file has its palm lean, which the table of start states does not."""
        self.contacts = LinkContacts(self.worlds)
        self.shown: ObjectObservation
        """The camera's observation at this decision."""

    def variant(self, rows: Rows, draws: Draws, options: ResetOptions) -> Rows:
        drawn = draws.integers(self._n_choices)
        if options.object is None:
            return drawn
        if options.object not in self._names:
            self.add_object(options.object, None)
        return drawn * 0 + self._names.index(options.object)

    def object_names(self) -> tuple[str, ...]:
        return tuple(self._names[: self._n_choices])

    def draw_variation(
        self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions
    ) -> None:
        """Draw the start state, which gives the object's size, and the friction. Raises ConfigError for a chosen size
        that no start state has."""
        if options.size is not None:
            self._check_size(variant, options.size)
        friction, among = draws.uniform(*_FRICTION)[:, 0], draws.uniform(0.0, 1.0)[:, 0]
        values.setdefault("friction", friction)
        table = self._states()
        within = self.settings.randomise.size if options.size is None else None
        state = _choose_state(table.size[variant], values.get("size"), among, within)
        self._state[rows] = state
        values["size"] = table.size[variant, state]

    def begin(self, rows: Rows, variant: Rows, draws: Draws, values: dict[str, Array], options: ResetOptions) -> None:
        assert self.object_body is not None
        table, state = self._states(), self._state[rows]
        position, target, pose = (part[variant, state] for part in (table.position, table.target, table.pose))
        noise = draws.uniform(-NOISE_JOINT, NOISE_JOINT, self.spec.n_joints)
        self.worlds.place(rows, self.worlds.xp.clip(position + noise, self._lower, self._upper))
        pose[:, :3] += draws.uniform(-NOISE_PLACE, NOISE_PLACE, 3)
        self._normal[rows] = self._upward
        if self._leans or "wrist_tilt" in values:
            turn = palm_turn(self.worlds, rows, self._facing)
            pose = turn_with_palm(self.worlds, variant, turn, pose)
            self._normal[rows] = rotate_vectors(turn, 0.0 * pose[:, :3] + self._upward)
        self.object_body.pose[rows] = pose
        self.kind[rows], self.start[rows], self.place[rows] = variant, target, pose[:, :3]
        self._factor[rows], self._low[rows] = values["size"], 0.0
        self.contacts.begin(rows)
        self.camera.begin(rows, values, draws)

    def initial_targets(self, rows: Rows) -> Array:
        return self.start[rows]

    def look(self, tick: Ticks) -> None:
        if self.n_privileged:
            self.shown = self.camera.look(tick)

    def privileged_observation(self, tick: Ticks) -> Array | None:
        return self.encode_object(self.shown) if self.n_privileged else None

    def encode_object(self, observation: ObjectObservation) -> Array:
        """The object's shift from where it began, in 5 cm; the direction of its own z axis, two numbers; cosine and
        sine of four times its yaw, since a quarter turn looks the same; its velocity and angular velocity. All in world
        axes."""
        w, x, y, z = (observation.quaternion[:, k] for k in range(4))
        xp = self.worlds.xp
        yaw = 4.0 * xp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        found: Array = xp.zeros((self.n, 13))
        found[:, :3] = (observation.position - self.place) / 0.05
        found[:, 3], found[:, 4] = 2 * (x * z + w * y), 2 * (y * z - w * x)
        found[:, 5], found[:, 6] = xp.cos(yaw), xp.sin(yaw)
        found[:, 7:10], found[:, 10:] = observation.velocity / FAST, observation.spin / SPINS
        return found

    def live_arrays(self) -> dict[str, NDArray[Any]]:
        own = {
            "place": self.place, "kind": self.kind, "start_state": self._state, "start": self.start,
            "factor": self._factor, "low": self._low, "normal": self._normal,
        }  # fmt: skip
        parts = {"contacts": self.contacts.live_arrays(), "camera": self.camera.live_arrays()}
        return own | {f"{name}/{key}": array for name, arrays in parts.items() for key, array in arrays.items()}

    def reset_info(self, rows: Rows) -> dict[str, NDArray[np.generic]]:
        return {"object": np.array([self._names[number] for number in self.kind[rows].tolist()], dtype=object)}

    def plan_surroundings(self, tick: Ticks) -> None:
        self.contacts.begin_decision()

    def move_surroundings(self, k: int) -> None:
        if k:
            self.contacts.add_period()
        if k == self.settings.decimation - 1:
            self.contacts.count()

    def lost(self) -> Flags:
        """Who has lost the object: it is aside, or rests on what must not touch it. Call once per decision, and before
        `palm_terms`."""
        assert self.object_body is not None
        self.contacts.add_period()
        self.contacts.count()
        aside: Flags = length(self.object_body.pose[:, :3] - self.place) > ASIDE
        return aside | (self.contacts.touching("palm") > 0) if self._palm_ends else aside

    def palm_terms(self, tick: Ticks) -> dict[str, Array]:
        """Height of the object's lowest point above the palm's surface, m (`clearance`), the share of decisions since
        the reset at which it was less than `ON_PALM` (`on_palm`), and shares of the contact force since the reset
        (`by_tips`, `by_middle`, `by_palm`), (n,) each. Call once per decision."""
        assert self.object_body is not None
        xp = self.worlds.xp
        over = palm_clearance(self.object_body.pose, self._shapes, self.kind, self._factor, self._normal, self._palm)
        self._low += (over < ON_PALM) & (tick > 0)
        decisions = xp.maximum(xp.asarray(tick // self.settings.decimation, np.float64), 1.0)
        shares = {f"by_{name}": share for name, share in self.contacts.shares().items()}
        return {"clearance": over, "on_palm": self._low / decisions} | shares

    def _check_size(self, variant: Rows, size: float) -> None:
        for number in sorted({*variant.tolist()}):
            held, name = self._held[number].size, self._names[number]
            if not any(low <= size <= high for low, high in self._sizes) and not (held == size).any():
                known = " or ".join(f"{low:g} to {high:g}" for low, high in self._sizes)
                raise ConfigError(f"size {size:g}: start states have {name} at {known} times its size, and each "
                                  "episode takes one near what is asked for")  # fmt: skip

    def add_object(self, choice: ObjectChoice, grasp: str | None) -> None:
        grasp_object = in_hand_object(choice)
        _check_together(grasp_object, self._objects[0])
        self._add_object(grasp_object, self.n, 1)
        self.added.append((choice, grasp))

    def _add_object(self, grasp_object: catalogue.GraspObject, n: int, threads: int) -> None:
        """Add an object with its start states. Raises ConfigError for one that is too large."""
        longest = 2 * grasp_object.half_extents().max()
        if longest > LARGEST:
            raise ConfigError(
                f"{grasp_object.name} is too large for {self.name}: {longest * 1000:.0f} mm long; "
                f"at most {LARGEST * 1000:.0f} mm can be"
            )
        search: Search = CRADLE if self.settings.grip == "cradle" else FINGERTIPS
        kind = (search, TEST if self.settings.starts == "test" else TRAIN) if self._palm_ends else (ANYHOW, ALL)
        self._sizes = kind[1].sizes
        states = load_start_states(grasp_object, self.settings.side, *kind, self.spec.model_reference)
        # On a device all simulations have geoms of the same types.
        mixed = self.settings.device != "cpu" and self._n_choices > 1 and grasp_object.shape in catalogue.SIZES_OF_KIND
        model = upturned_model(self.spec, grasp_object, (0.0, 0.0, 0.1), self.settings, every_shape=mixed)
        if self._names:
            add_variant(self.worlds, model, grasp_object.name, self._names[0])
        else:
            self.worlds = make_worlds(self.spec, model, n, threads, self.settings)
        self._held.append(states)
        self._table = None
        self._objects.append(grasp_object)
        self._names.append(grasp_object.name)
        self._shapes = ObjectShapes(self._objects, self.worlds.xp)

    def _states(self) -> StartStates:
        """Start states of all objects in one table, (objects, states, …). Missing states have infinite size."""
        if self._table is None:
            most = max(len(held.size) for held in self._held)
            fill = {"size": np.inf, "position": 0.0, "target": 0.0, "pose": 0.0}
            parts = {}
            for name, value in fill.items():
                columns = [getattr(held, name) for held in self._held]
                padded = [
                    np.concatenate([c, np.full((most - len(c), *c.shape[1:]), value)]) if len(c) < most else c
                    for c in columns
                ]
                parts[name] = self.worlds.xp.asarray(np.stack(padded))
            self._table = StartStates(**parts)
        return self._table


def _check_together(grasp_object: catalogue.GraspObject, first: catalogue.GraspObject) -> None:
    """Raises ConfigError for a mesh beside something else."""
    shapes = {(each.shape, each.file, each.scale, each.collision) for each in (first, grasp_object)}
    if len(shapes) > 1 and any(shape == "mesh" for shape, *_ in shapes):
        raise not_one_environment(grasp_object.name, first.name, "scenes of one batch share their meshes")


def in_hand_object(choice: ObjectChoice) -> catalogue.GraspObject:
    """An object of conf/in_hand/objects.yaml by name, or any other. Raises ConfigError."""
    folder = data_root() / "conf" / "in_hand"
    known = read_yaml(folder / "objects.yaml")
    if not isinstance(choice, str) or choice not in known:
        return load_object(choice)
    row = known[choice]
    size, mass = tuple(edge / 1000.0 for edge in row.get("size", ())), row["mass"] / 1000.0
    file = folder / row["file"] if "file" in row else None
    return catalogue.GraspObject(choice, row["shape"], size, mass, file, collision="hull" if file else "pieces")


def _choose_state(sizes: Array, wanted: Array | None, among: Array, within: tuple[float, float] | None = None) -> Rows:
    """Index of a start state for each row, from sizes in order (m, k), inf where there are no more, and numbers `among`
    in [0, 1), (m,); near the wanted size (m,), and `within` a range where one is. Raises ConfigError where none is
    near."""
    xp = array_namespace(sizes)
    count = xp.isfinite(sizes).sum(axis=-1)
    if wanted is None:
        state: Rows = xp.minimum(xp.asarray(among * count, np.int64), count - 1)
        return state
    last = sizes[xp.arange(len(sizes)), count - 1]
    beyond = (wanted < sizes[:, 0] - 0.005) | (wanted > last + 0.005)
    if bool(beyond.any()):
        row = int(xp.flatnonzero(beyond)[0])
        raise ConfigError(f"fingertips are taught to hold this object at {float(sizes[row, 0]):.2f} to "
                          f"{float(last[row]):.2f} times its size, not {float(wanted[row]):g}")  # fmt: skip
    near = (sizes < wanted[:, None]).sum(axis=-1) + xp.asarray((among - 0.5) * _NEAR, np.int64)
    first, beyond = 0 * count, count
    if within is not None:
        first, beyond = ((sizes < within[0]).sum(axis=-1), (sizes <= within[1]).sum(axis=-1))
        some = beyond > first
        first, beyond = xp.where(some, first, 0), xp.where(some, beyond, count)
    chosen: Rows = xp.minimum(xp.maximum(near, first), beyond - 1)
    return chosen
