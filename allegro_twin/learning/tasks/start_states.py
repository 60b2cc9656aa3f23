"""States in which fingertips hold an object above the upturned palm: searched for once, then only read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.atomic_write import whole_file
from allegro_twin.files.cache import cache_folder
from allegro_twin.files.fingerprint import fingerprint
from allegro_twin.hands.description.hands import load_spec
from allegro_twin.learning.tasks.start_state_search import FRICTION, SIZES, Search, tried
from allegro_twin.sim.model.physics import Physics
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.types import Array

VERSION = 2
"""Of the search; counted up when another search would find other states."""
COUNT, SEED, SEARCH = 1024, 20260101, Search()
MOST = 200
"""Batches, after which a search is given up: it finds too little."""


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """For one side, a state a row, in order of size."""

    position: Array
    """Of the joints, (m, n), rad."""
    target: Array
    """Of the position law that holds the object so, (m, n), rad."""
    pose: Array
    """Of the object, world, (m, 7), m."""
    size: Array
    """Factor on the object's size, (m,)."""


def held(thing: GraspObject, side: str, search: Search = SEARCH) -> Held:
    """From the package, or from the cache of this machine, where a first use searches for some minutes. Raises
    ConfigError where there is no cache."""
    name = file_name(thing, search)
    path = data_root() / "conf" / "starts" / name
    if not path.is_file():
        path = cache_folder("starts", f"how fingertips hold a {thing.name}") / name
        if not path.is_file():
            write(thing, path, search)
    found = _read(path)
    return found if side == "right" else _mirrored(found)


def write(thing: GraspObject, path: Path, search: Search = SEARCH) -> None:
    """Search for the states of the right hand and write them. Raises RecordingError."""
    found = searched(thing, search)
    arrays = {"position": found.position, "target": found.target, "pose": found.pose, "size": found.size}
    short = {name: array.astype(np.float32) for name, array in arrays.items()}
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **short)  # type: ignore[arg-type]  # Taken for its options.


def searched(thing: GraspObject, search: Search, count: int = COUNT, seed: int = SEED) -> Held:
    """So many states, or as many as a long search finds. Raises ConfigError where it finds none."""
    rng = np.random.default_rng(seed)
    parts: list[tuple[Array, ...]] = []
    while sum(len(part[0]) for part in parts) < count and len(parts) < MOST:
        parts.append(tried(thing, search, rng))
    if not any(len(part[0]) for part in parts):
        raise ConfigError(f"no grasp of the fingertips was found that holds {thing.name} above the palm: it may be too "
                          "large, too small or too heavy")  # fmt: skip
    columns = [np.concatenate(column)[:count] for column in zip(*parts, strict=True)]
    order = np.argsort(columns[3], kind="stable")
    return Held(*(column[order] for column in columns))


def file_name(thing: GraspObject, search: Search = SEARCH) -> str:
    """Another search, another object, or another hand, has another."""
    own = (thing.shape, thing.size, thing.mass, thing.file, thing.scale)
    whole = (VERSION, own, repr(search), COUNT, SEED, SIZES, FRICTION, _hand(), repr(Physics()))
    return f"{fingerprint(*whole)}.npz"


def _hand() -> str:
    """Of the hand that searches: its shapes and masses, its limits and its motors."""
    spec = load_spec(side="right")
    motors, mjcf = spec.actuation, data_root() / "models" / "mjcf" / f"{spec.name}.xml"
    driven = (motors.torque_limit, motors.damping, motors.armature, motors.frictionloss)
    return fingerprint(mjcf, spec.lower, spec.upper, driven)


def _mirrored(right: Held) -> Held:
    """The same states of the left hand."""
    spec = load_spec(side="right")
    pose = right.pose * (1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0)
    return Held(spec.mirrored(right.position), spec.mirrored(right.target), pose, right.size)


def _read(path: Path) -> Held:
    with np.load(path) as kept:
        return Held(*(kept[name].astype(np.float64) for name in ("position", "target", "pose", "size")))
