"""States in which fingertips hold an object above the upturned palm: searched for once, then only read."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from allegro_twin.control import laws
from allegro_twin.description.hands import load_spec
from allegro_twin.files.assets import data_root
from allegro_twin.files.cache import cache_folder
from allegro_twin.files.whole import whole_file
from allegro_twin.gym.randomise import Physics
from allegro_twin.gym.settings import EnvSettings
from allegro_twin.gym.tasks.base import Flags
from allegro_twin.gym.tasks.scenes import PALM, THING, upturned
from allegro_twin.gym.tasks.vectors import tilt
from allegro_twin.kinematics.orientation import quaternion_from_vector
from allegro_twin.kinematics.tips import Fingertips
from allegro_twin.library.gains import load_gains
from allegro_twin.sim.batch import Rows, Worlds
from allegro_twin.sim.objects import Thing
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

VERSION = 1
"""Of the search; counted up when another search would find other states."""
COUNT, SIZES, FRICTION, SEED = 1024, (0.9, 1.1), 0.5, 20260101
"""How many states; factors on the object's size; the sliding friction in which they were found; of the search."""
PERIOD = 0.003  # s, of the law and of the physics.
AT_ONCE = 512  # Simulations.
_CARRIED, _CLOSING, _SEEN, _WATCHED, _PERIODS = 60, 80, 110, 250, 450  # Periods: the object is let go of, the fingers
# have closed, what has fallen is given up, the rest has come to rest, and the end.
_FALLEN = 0.008  # m
_STILL, _UPRIGHT = 0.001, np.radians(8.0)  # m that it moves from then to the end; its tilt.
_GAP, _HIGHEST, _ASIDE = 0.008, 0.090, 0.035  # m: above the palm; highest middle; from the middle of the palm's edge.
_BELOW, _APART = (-0.035, 0.005), (0.02, 0.1)  # m: the object's middle from the lower tips; fingers from thumb.
_FINGER = ((-0.15, 0.15), (0.75, 1.55), (0.0, 1.0), (0.0, 0.8))  # rad, from the palm outward: what is searched in.
_THUMB = ((0.7, 1.39), (0.4, 1.16), (0.0, 1.3), (-0.1, 1.0))
_SPREAD = 0.15  # rad, of a finger from the others.
_SQUEEZE, _PRESS = (0.05, 0.30), (0.0, 0.25)  # rad beyond the first touch: the fingers' base joints, the thumb's two.


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """For one side, a state a row."""

    position: Array
    """Of the joints, (m, n), rad."""
    target: Array
    """Of the position law that holds the object so, (m, n), rad."""
    pose: Array
    """Of the object, world, (m, 7), m."""
    size: Array
    """Factor on the object's size, (m,)."""


def held(thing: Thing, side: str) -> Held:
    """From the package, or from the cache of this machine, where a first use searches for some minutes. Raises
    ConfigError where there is no cache."""
    name = file_name(thing)
    path = data_root() / "conf" / "starts" / name
    if not path.is_file():
        path = cache_folder("starts", f"how fingertips hold a {thing.name}") / name
        if not path.is_file():
            write(thing, path)
    found = _read(path)
    return found if side == "right" else _mirrored(found)


def write(thing: Thing, path: Path) -> None:
    """Search for the states of the right hand and write them. Raises RecordingError."""
    found = searched(thing)
    arrays = {"position": found.position, "target": found.target, "pose": found.pose, "size": found.size}
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **{name: array.astype(np.float32) for name, array in arrays.items()})  # type: ignore[arg-type]  # Taken for its options.


def searched(thing: Thing, count: int = COUNT, seed: int = SEED) -> Held:
    """Close random postures of the right hand around the object, let go of it, and keep what holds."""
    rng = np.random.default_rng(seed)
    parts: list[tuple[Array, ...]] = []
    while sum(len(part[0]) for part in parts) < count:
        parts.append(_tried(thing, rng))
    columns = [np.concatenate(column)[:count] for column in zip(*parts, strict=True)]
    order = np.argsort(columns[3], kind="stable")
    return Held(*(column[order] for column in columns))


def _tried(thing: Thing, rng: np.random.Generator) -> tuple[Array, ...]:
    """One batch of the search: what held of it."""
    spec = load_spec(side="right")
    gains = load_gains("default", spec)
    model = upturned(spec, thing, (0.0, 0.0, 0.2), EnvSettings(timestep=PERIOD), FRICTION)
    worlds, rows = Worlds(spec, model, AT_ONCE, 0), np.arange(AT_ONCE)
    worlds.choose(rows, np.zeros(AT_ONCE, np.int64))
    body = worlds.free(THING)
    size = rng.uniform(*SIZES, AT_ONCE)
    height = 2.0 * size * thing.half_extents()[2]
    Physics(worlds, body).apply(rows, {"size": size})
    posture, squeeze, place = _chosen(spec, height, rng)
    yaw = quaternion_from_vector(rng.uniform(-np.pi / 4, np.pi / 4, (AT_ONCE, 1)) * (0.0, 0.0, 1.0))
    worlds.position[...] = posture
    watched = target = posture
    going: Rows | None = None
    for k in range(_PERIODS):
        if k < _CARRIED:
            body.pose[:, :3], body.pose[:, 3:] = place, yaw
            body.velocity[...] = body.spin[...] = 0.0
        if k == _SEEN:
            going = np.flatnonzero(np.linalg.norm(body.pose[:, :3] - place, axis=-1) < _FALLEN)
        if k == _WATCHED:
            watched = np.array(body.pose[:, :3])
        target = np.clip(posture + squeeze * min(k / _CLOSING, 1.0), spec.lower, spec.upper)
        worlds.torque[...] = laws.pd(target - worlds.position, -worlds.velocity, gains.kp, gains.kd)
        worlds.step(going, 1)
    assert going is not None
    middle, quaternion = body.pose[:, :3], body.pose[:, 3:]
    kept = (
        np.isin(rows, going)
        & (np.linalg.norm(middle - watched, axis=-1) < _STILL)
        & (tilt(quaternion) < _UPRIGHT)
        & _inside(middle, height)
    )
    return worlds.position[kept], target[kept], body.pose[kept], size[kept]


def _chosen(spec: HandSpec, height: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Postures, how far the targets lie beyond them, (n, 16) each, rad, and a place for the object between the tips,
    (n, 3), m: drawn until the place is one where an object can be."""
    tips = Fingertips(spec)
    posture, squeeze, place = (np.zeros((AT_ONCE, k)) for k in (16, 16, 3))
    missing = np.arange(AT_ONCE)
    while len(missing):
        posture[missing], squeeze[missing] = _postures(len(missing), rng)
        posture = np.clip(posture, spec.lower + 0.01, spec.upper - 0.01)
        world = tips(posture[missing])[..., ::-1]  # The palm's x is up, its z along the world's x.
        fingers, thumb = world[:, :3].mean(axis=1), world[:, 3]
        place[missing] = (fingers + thumb) / 2
        low = np.minimum(fingers[:, 2], thumb[:, 2])
        place[missing, 2] = low + rng.uniform(*_BELOW, len(missing))
        apart = fingers[:, 0] - thumb[:, 0]
        good = (apart > _APART[0]) & (apart < _APART[1]) & _inside(place[missing], height[missing])
        missing = missing[~good]
    return posture, squeeze, place


def _inside(place: Array, height: Array) -> Flags:
    """Where an object may be: above the palm, and neither high nor aside."""
    low, high = PALM + height / 2 + _GAP, _HIGHEST
    inside: Flags = (place[:, 2] > low) & (place[:, 2] < high) & (np.abs(place[:, :2]).max(axis=-1) < _ASIDE)
    return inside


def _postures(n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    finger = np.array([rng.uniform(*wide, n) for wide in _FINGER]).T
    finger[:, 0] = 0.0
    fingers = finger[:, None] + rng.uniform(-_SPREAD, _SPREAD, (n, 3, 4))
    thumb = np.array([rng.uniform(*wide, n) for wide in _THUMB]).T
    squeeze = np.zeros((n, 4, 4))
    squeeze[:, :3, 1] = rng.uniform(*_SQUEEZE, (n, 1))
    squeeze[:, 3, 1:3] = rng.uniform(*_PRESS, (n, 2))
    return np.concatenate([fingers.reshape(n, 12), thumb], axis=1), squeeze.reshape(n, 16)


def _mirrored(right: Held) -> Held:
    """The same states of the left hand."""
    spec = load_spec(side="right")
    pose = right.pose * (1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0)
    return Held(spec.mirrored(right.position), spec.mirrored(right.target), pose, right.size)


def file_name(thing: Thing) -> str:
    """Another search, or another object, has another."""
    content = repr((VERSION, thing.shape, thing.size, thing.mass, str(thing.file or ""), COUNT, SIZES, FRICTION, SEED))
    return f"{hashlib.sha256(content.encode()).hexdigest()[:16]}.npz"


def _read(path: Path) -> Held:
    with np.load(path) as kept:
        return Held(*(kept[name].astype(np.float64) for name in ("position", "target", "pose", "size")))
