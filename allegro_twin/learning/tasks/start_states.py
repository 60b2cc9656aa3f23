"""Start states of in-hand tasks: fingertips hold an object above the upturned palm. They are searched for once and
stored.

The search closes postures of the right hand around an object, lets it go, and keeps what holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

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
from allegro_twin.sim.model.physics import Physics as ScenePhysics
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

SIZES, FRICTION = (0.9, 1.1), 0.5
"""Factors on the object's size; the sliding friction at which it must be held."""
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


def try_candidates(
    thing: GraspObject, search: StartStateSearch, rng: np.random.Generator
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
    size = physics.sizes(worlds.variant, rng.uniform(*SIZES, AT_ONCE))
    height = 2.0 * size * thing.half_extents()[2]
    physics.apply(rows, {"size": size})
    posture, target, place, yaw = search.tries(spec, height, rng)
    turned = quaternion_from_vector(yaw[:, None] * (0.0, 0.0, 1.0))
    worlds.position[...] = posture
    watched, going = place, rows
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
    still = np.intersect1d(going, _unmoved(body.pose[:, :3], watched, _STILL))
    kept = still[_in_place(body.pose[still, :3], height[still]) & (tilt(body.pose[still, 3:]) < _UPRIGHT)]
    return worlds.position[kept], target[kept], body.pose[kept], size[kept]


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
COUNT, SEED, SEARCH = 1024, 20260101, StartStateSearch()
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


def load_start_states(thing: GraspObject, side: str, search: StartStateSearch = SEARCH) -> StartStates:
    """Load start states from the package, or from the cache of this machine; the first use searches for some minutes.
    Raises ConfigError without a cache."""
    name = file_name(thing, search)
    path = data_root() / "conf" / "starts" / name
    if not path.is_file():
        path = cache_folder("starts", f"how fingertips hold a {thing.name}") / name
        if not path.is_file():
            write_start_states(thing, path, search)
    found = _read(path)
    return found if side == "right" else _mirror(found)


def write_start_states(thing: GraspObject, path: Path, search: StartStateSearch = SEARCH) -> None:
    """Search for the start states of the right hand and write them. Raises RecordingError."""
    found = search_start_states(thing, search)
    arrays = {"position": found.position, "target": found.target, "pose": found.pose, "size": found.size}
    short = {name: array.astype(np.float32) for name, array in arrays.items()}
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **short)  # type: ignore[arg-type]  # Taken for its options.


def search_start_states(
    thing: GraspObject, search: StartStateSearch, count: int = COUNT, seed: int = SEED
) -> StartStates:
    """Search for `count` states, or as many as a long search finds. Raises ConfigError where it finds none."""
    rng = np.random.default_rng(seed)
    parts: list[tuple[Array, ...]] = []
    while sum(len(part[0]) for part in parts) < count and len(parts) < MOST:
        parts.append(try_candidates(thing, search, rng))
    if not any(len(part[0]) for part in parts):
        raise ConfigError(f"no grasp of the fingertips was found that holds {thing.name} above the palm: it may be too "
                          "large, too small or too heavy")  # fmt: skip
    columns = [np.concatenate(column)[:count] for column in zip(*parts, strict=True)]
    order = np.argsort(columns[3], kind="stable")
    return StartStates(*(column[order] for column in columns))


def file_name(thing: GraspObject, search: StartStateSearch = SEARCH) -> str:
    """File name; it depends on the search, the object and the hand."""
    own = (thing.shape, thing.size, thing.mass, thing.file, thing.scale)
    whole = (
        VERSION,
        own,
        repr(search).replace("StartStateSearch", "Search", 1),
        COUNT,
        SEED,
        SIZES,
        FRICTION,
        _hand_fingerprint(),
        repr(ScenePhysics()),
    )
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
