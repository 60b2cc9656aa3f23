"""Start states of in-hand tasks: fingers hold an object above the upturned palm. They are searched for once and
stored.

The search closes postures of the right hand around an object, lets it go, and keeps what holds; for tasks in the
fingertips what fingertips alone hold, once for trainings and once for tests.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.control import laws
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import cache_folder, data_root
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import quaternion_from_vector
from allegro_twin.learning.environments.randomise import PhysicsRandomiser
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.tasks.base import Flags
from allegro_twin.learning.tasks.scenes import PALM, THING, upturned_model
from allegro_twin.learning.tasks.vectors import tilt
from allegro_twin.sim.batch.cpu import Rows, SimBatch
from allegro_twin.sim.batch.link_contacts import LinkContacts
from allegro_twin.sim.model.physics import Physics as ScenePhysics
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

FRICTION = 0.5
"""Sliding friction at which the object must be held."""
PERIOD = 0.003  # s, of the control law and of the physics.
AT_ONCE = 512  # Simulations.
_CARRIED, _CLOSING, _SEEN, _WATCHED, _PERIODS = 60, 80, 110, 250, 450  # Periods: the object is released, the fingers
# have closed, fallen objects are given up, the rest has come to rest, and the end.
_FALLEN = 0.008  # m
_STILL, _UPRIGHT = 0.001, np.radians(8.0)  # m of motion from then to the end; its tilt.
_GAP, _HIGHEST, _ASIDE = 0.008, 0.090, 0.035  # m: above the palm; highest middle; from the middle of the palm's edge.


class StartCandidates(NamedTuple):
    """Candidates to try, one per row."""

    posture: Array
    """Before the fingers close, (n, 16), rad."""
    target: Array
    """When they have closed, (n, 16), rad."""
    place: Array
    """Position of the object's middle, world, (n, 3), m."""
    yaw: Array
    """Yaw of the object, (n,), rad."""


@dataclass(frozen=True, slots=True)
class StartStateSearch:
    """Ranges of the candidates, rad: fingers opposite the thumb, in any posture that leaves room for the object between
    them. Its repr is part of the name of the stored file."""

    finger: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.75, 1.55), (0.0, 1.0), (0.0, 0.8))
    """From the palm outward."""
    thumb: tuple[tuple[float, float], ...] = ((0.7, 1.39), (0.4, 1.16), (0.0, 1.3), (-0.1, 1.0))
    spread: float = 0.15
    """Of a finger from the others."""
    squeeze: tuple[float, float] = (0.05, 0.30)
    press: tuple[float, float] = (0.0, 0.25)
    """Beyond the posture: of the fingers' base joints, and of the thumb's two."""
    below: tuple[float, float] = (-0.035, 0.005)
    """m, of the object's middle from the lowest tips."""
    apart: tuple[float, float] = (0.02, 0.1)
    """m, from the thumb to the fingers."""
    tips: int = field(default=0, repr=False)
    """Fingertips, at least, that must hold the object, and no other link may touch it; 0: whatever holds."""

    def tries(self, spec: HandSpec, height: Array, rng: np.random.Generator) -> StartCandidates:
        """Draw candidates for objects of this height (n,), m."""
        n, tips = len(height), hand_kinematics(spec).batch_fingertips()
        posture, squeeze, place = (np.zeros((n, k)) for k in (16, 16, 3))
        missing = np.arange(n)
        while len(missing):
            posture[missing], squeeze[missing] = self._postures(len(missing), rng)
            posture = np.clip(posture, spec.lower + 0.01, spec.upper - 0.01)
            world = tips(posture[missing])[..., ::-1]  # The palm's x is up, its z along the world's x.
            fingers, thumb = world[:, :3].mean(axis=1), world[:, 3]
            place[missing] = (fingers + thumb) / 2
            low = np.minimum(fingers[:, 2], thumb[:, 2])
            place[missing, 2] = low + rng.uniform(*self.below, len(missing))
            apart = fingers[:, 0] - thumb[:, 0]
            good = (apart > self.apart[0]) & (apart < self.apart[1]) & _in_place(place[missing], height[missing])
            missing = missing[~good]
        target = np.clip(posture + squeeze, spec.lower, spec.upper)
        return StartCandidates(posture, target, place, rng.uniform(-np.pi / 4, np.pi / 4, n))

    def _postures(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        finger = np.array([rng.uniform(*wide, n) for wide in self.finger]).T
        fingers = finger[:, None] + rng.uniform(-self.spread, self.spread, (n, 3, 4))
        thumb = np.array([rng.uniform(*wide, n) for wide in self.thumb]).T
        squeeze = np.zeros((n, 4, 4))
        squeeze[:, :3, 1] = rng.uniform(*self.squeeze, (n, 1))
        squeeze[:, 3, 1:3] = rng.uniform(*self.press, (n, 2))
        return np.concatenate([fingers.reshape(n, 12), thumb], axis=1), squeeze.reshape(n, 16)


class StartSet(NamedTuple):
    """A set of states of one object."""

    seed: int
    most: int
    """States."""
    sizes: tuple[tuple[float, float], ...]
    """Ranges of the factor on the object's size."""


def try_candidates(
    thing: GraspObject, search: StartStateSearch, wanted: StartSet, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Try one batch. Returns what was held: joint positions and targets (m, 16), rad, pose (m, 7), m, and factor on the
    size (m,)."""
    spec = load_spec(side="right")
    gains = load_gains("default", spec)
    model = upturned_model(spec, thing, (0.0, 0.0, 0.2), EnvSettings(timestep=PERIOD), FRICTION)
    worlds, rows = SimBatch(spec, model, AT_ONCE, 0), np.arange(AT_ONCE)
    worlds.choose(rows, np.zeros(AT_ONCE, np.int64))
    body = worlds.free_body(THING)
    physics = PhysicsRandomiser(worlds, body)
    size = physics.sizes(worlds.variant, _draw_sizes(wanted.sizes, rng))
    height = 2.0 * size * thing.half_extents()[2]
    physics.apply(rows, {"size": size})
    posture, target, place, yaw = search.tries(spec, height, rng)
    turned = quaternion_from_vector(yaw[:, None] * (0.0, 0.0, 1.0))
    worlds.position[...] = posture
    watched, going, contacts = place, rows, LinkContacts(worlds)
    for k in range(_PERIODS):
        if k < _CARRIED:
            body.pose[:, :3], body.pose[:, 3:] = place, turned
            body.velocity[...] = body.spin[...] = 0.0
        if k == _SEEN:
            going = _unmoved(body.pose[:, :3], place, _FALLEN)
        if k == _WATCHED:
            watched = np.array(body.pose[:, :3])
        wish = posture + (target - posture) * min(k / _CLOSING, 1.0)
        worlds.control[...] = laws.pd(wish - worlds.position, -worlds.velocity, gains.kp, gains.kd)
        worlds.step(None if k < _SEEN else going, 1)
        if k >= _WATCHED:
            contacts.add_period()
    still = np.intersect1d(going, _unmoved(body.pose[:, :3], watched, _STILL))
    good = _in_place(body.pose[still, :3], height[still]) & (tilt(body.pose[still, 3:]) < _UPRIGHT)
    if search.tips:
        good &= (contacts.touching("tips") >= search.tips)[still]
        good &= ((contacts.touching("middle") + contacts.touching("palm")) == 0)[still]
    kept = still[good]
    return worlds.position[kept], target[kept], body.pose[kept], size[kept]


def survives_noise(thing: GraspObject, states: StartStates, rng: np.random.Generator) -> Flags:
    """Whether fingertips still hold, and nothing else does, after `SHAKES` draws of an episode's own noise on each
    state, (m,)."""
    spec = load_spec(side="right")
    gains, many = load_gains("default", spec), np.tile(np.arange(len(states.size)), SHAKES)
    rows = np.arange(len(many))
    model = upturned_model(spec, thing, (0.0, 0.0, 0.2), EnvSettings(timestep=PERIOD), FRICTION)
    worlds = SimBatch(spec, model, len(many), 0)
    worlds.choose(rows, 0 * rows)
    body = worlds.free_body(THING)
    physics = PhysicsRandomiser(worlds, body)
    physics.apply(rows, {"size": physics.sizes(worlds.variant, states.size[many])})
    place = states.pose[many, :3] + rng.uniform(-NOISE_PLACE, NOISE_PLACE, (len(many), 3))
    shaken = states.position[many] + rng.uniform(-NOISE_JOINT, NOISE_JOINT, (len(many), spec.n_joints))
    worlds.position[...] = np.clip(shaken, spec.lower, spec.upper)
    body.pose[:, :3], body.pose[:, 3:], contacts = place, states.pose[many, 3:], LinkContacts(worlds)
    for _ in range(_WATCHED):
        worlds.control[...] = laws.pd(states.target[many] - worlds.position, -worlds.velocity, gains.kp, gains.kd)
        worlds.step(None, 1)
        contacts.add_period()
    kept = np.linalg.norm(body.pose[:, :3] - place, axis=-1) < _FALLEN
    kept &= contacts.touching("palm") == 0
    found: Flags = kept.reshape(SHAKES, -1).all(axis=0)
    return found


def _draw_sizes(ranges: tuple[tuple[float, float], ...], rng: np.random.Generator) -> Array:
    """Evenly from all ranges, (AT_ONCE,)."""
    if len(ranges) == 1:
        whole: Array = rng.uniform(*ranges[0], AT_ONCE)
        return whole
    low, high = np.array(ranges)[rng.choice(len(ranges), AT_ONCE, p=_widths(ranges))].T
    found: Array = rng.uniform(low, high)
    return found


def _widths(ranges: tuple[tuple[float, float], ...]) -> Array:
    wide = np.array([high - low for low, high in ranges])
    shares: Array = wide / wide.sum()
    return shares


def _unmoved(place: Array, other: Array, most: float) -> Rows:
    """Rows that are at most `most` from where they were."""
    return np.flatnonzero(np.linalg.norm(place - other, axis=-1) < most)


def _in_place(place: Array, height: Array) -> Flags:
    """Where an object may be: above the palm, and neither high nor aside."""
    low = PALM + height / 2 + _GAP
    inside: Flags = (place[:, 2] > low) & (place[:, 2] < _HIGHEST) & (np.abs(place[:, :2]).max(axis=-1) < _ASIDE)
    return inside


VERSION = 2
"""Version of the search, counted up when it would find other states."""
ANYHOW = StartStateSearch()
"""Whatever holds, proximal links and palm's edge included: for tasks that allow the palm."""
FINGERTIPS = StartStateSearch(below=(-0.02, 0.01), tips=3)
"""Three fingertips or four, the thumb's among them, and nothing else."""
ALL = StartSet(20260101, 1024, ((0.9, 1.1),))
"""Of `ANYHOW`."""
TRAIN = StartSet(20260101, 512, ((0.9, 1.1),))
"""Of `FINGERTIPS`, for trainings."""
TEST = StartSet(20260102, 256, ((0.85, 0.9), (1.1, 1.15)))
"""For tests: no state of a training, and of sizes that no training has."""
NOISE_JOINT, NOISE_PLACE, SHAKES = 0.02, 0.001, 4
"""rad and m: half-widths of an episode's noise on its start; draws of it that a state of `FINGERTIPS` survives."""
MOST = 200
"""Batches, after which a search that finds too little ends."""


@dataclass(frozen=True, slots=True, eq=False)
class StartStates:
    """Start states of one side, one per row, in order of size."""

    position: Array
    """Joint positions, (m, n), rad."""
    target: Array
    """Set-points of the position control that holds the object, (m, n), rad."""
    pose: Array
    """Pose of the object, world, (m, 7), m."""
    size: Array
    """Factor on the object's size, (m,)."""

    def of(self, rows: Any) -> StartStates:
        """Those of some rows."""
        return StartStates(self.position[rows], self.target[rows], self.pose[rows], self.size[rows])


def load_start_states(
    thing: GraspObject, side: str, search: StartStateSearch = ANYHOW, wanted: StartSet = ALL
) -> StartStates:
    """Load start states from the package, or from the cache of this machine; the first use searches for some minutes.
    Raises ConfigError without a cache."""
    name = file_name(thing, search, wanted)
    path = data_root() / "conf" / "starts" / name
    if not path.is_file():
        path = cache_folder("starts", f"how fingertips hold a {thing.name}") / name
        if not path.is_file():
            write_start_states(thing, path, search, wanted)
    found = _read(path)
    return found if side == "right" else _mirror(found)


def write_start_states(
    thing: GraspObject, path: Path, search: StartStateSearch = ANYHOW, wanted: StartSet = ALL
) -> None:
    """Search for the start states of the right hand and write them. Raises RecordingError."""
    found = search_start_states(thing, search, wanted)
    arrays = {"position": found.position, "target": found.target, "pose": found.pose, "size": found.size}
    short = {name: array.astype(np.float32) for name, array in arrays.items()}
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **short)  # type: ignore[arg-type]  # Taken for its options.


def search_start_states(thing: GraspObject, search: StartStateSearch, wanted: StartSet = ALL) -> StartStates:
    """Search for as many states as are wanted, or as a long search finds; those in the fingertips that noise shakes
    loose are left out. Raises ConfigError where it finds none."""
    rng, count = np.random.default_rng(wanted.seed), wanted.most
    parts: list[tuple[Array, ...]] = []
    while sum(len(part[0]) for part in parts) < count and len(parts) < MOST:
        parts.append(try_candidates(thing, search, wanted, rng))
    if not any(len(part[0]) for part in parts):
        raise ConfigError(f"no grasp of the fingertips was found that holds {thing.name} above the palm: it may be too "
                          "large, too small or too heavy")  # fmt: skip
    columns = [np.concatenate(column)[:count] for column in zip(*parts, strict=True)]
    order = np.argsort(columns[3], kind="stable")
    found = StartStates(*(column[order] for column in columns))
    return found.of(survives_noise(thing, found, np.random.default_rng((wanted.seed, 1)))) if search.tips else found


def file_name(thing: GraspObject, search: StartStateSearch = ANYHOW, wanted: StartSet = ALL) -> str:
    """File name; it depends on the search, the object and the hand."""
    own = (thing.shape, thing.size, thing.mass, thing.file, thing.scale)
    sizes = wanted.sizes[0] if len(wanted.sizes) == 1 else wanted.sizes
    whole = (
        VERSION,
        own,
        repr(search).replace("StartStateSearch", "Search", 1),
        wanted.most,
        wanted.seed,
        sizes,
        FRICTION,
        _hand_fingerprint(),
        repr(ScenePhysics()),
    ) + ((search.tips,) if search.tips else ())
    return f"{fingerprint(*whole)}.npz"


def _hand_fingerprint() -> str:
    """Fingerprint of the searching hand: shapes and masses, limits and motors."""
    spec = load_spec(side="right")
    motors, mjcf = spec.actuation, data_root() / "models" / "mjcf" / f"{spec.name}.xml"
    driven = (motors.torque_limit, motors.damping, motors.armature, motors.frictionloss)
    return fingerprint(mjcf, spec.lower, spec.upper, driven)


def _mirror(right: StartStates) -> StartStates:
    """The same states of the left hand."""
    spec = load_spec(side="right")
    pose = right.pose * (1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0)
    return StartStates(spec.mirror_posture(right.position), spec.mirror_posture(right.target), pose, right.size)


def _read(path: Path) -> StartStates:
    with np.load(path) as kept:
        return StartStates(*(kept[name].astype(np.float64) for name in ("position", "target", "pose", "size")))
