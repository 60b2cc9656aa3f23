"""Grasps from a file of any format that is known, told apart by what is in it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import read_yaml
from allegro_twin.grasping.interchange.dexgraspbench import Order, read_record
from allegro_twin.grasping.interchange.dexgraspnet import read_entries
from allegro_twin.grasping.interchange.grasps import FRAMES, PALM, Grasps
from allegro_twin.grasping.interchange.ours import read_yaml_grasps
from allegro_twin.grasping.interchange.plain import load_plain
from allegro_twin.grasping.scenario import Scenario, ScenarioObject, as_written, parse_object
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.taxonomy import ClaimedType
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.objects.catalogue import object_catalogue
from allegro_twin.sim.objects.meshes import SUFFIXES, mesh_middle
from allegro_twin.spec import SIDES, HandSpec, Side

_YAML = (".yaml", ".yml")


def read_grasps(path: Path, spec: HandSpec, *, order: Order = None, frame: str | None = None) -> Grasps:
    """DexGraspBench, BODex, Dexonomy or DexGraspNet `.npy`, or our YAML.

    `order`: order of the joints in a file without names, one of `joint_orders`. `frame`: frame of the hand, `palm`
    or `menagerie`, where it is another than the format's own. Raises ConfigError, in a line, also for a file that
    says that it is of another hand.
    """
    if frame is not None and frame not in FRAMES:
        raise ConfigError(unknown("frame", frame, FRAMES))
    _check_file(path)
    if path.suffix in _YAML:
        return read_yaml_grasps(path, spec)
    content = load_plain(path)
    if isinstance(content, Mapping) and "qpos" not in content:
        return read_record(content, spec, path, order=order, frame=FRAMES[frame] if frame else None)
    return read_entries(_entries(content, path), spec, path)


class OwnHand(NamedTuple):
    """Hand that a grasp file names; None: it does not say."""

    model: str | None
    side: Side | None
    named: bool
    """Its joints have names, which no other hand has."""
    frame: str | None
    """Frame of the palm's pose, where the file says it or its format has one for every hand."""


def own_hand(path: Path) -> OwnHand:
    """Which hand a grasp file says that it is of. Raises ConfigError."""
    _check_file(path)
    content = read_yaml(path) if path.suffix in _YAML else load_plain(path)
    if not isinstance(content, Mapping):
        return OwnHand(None, None, True, PALM.name)  # DexGraspNet's.
    model, side = content.get("hand"), content.get("side")
    of_format = None if "grasp_qpos" in content else PALM.name
    return OwnHand(
        model if isinstance(model, str) else None, next((each for each in SIDES if each == side), None),
        bool({"joint_names", "qpos"} & content.keys()), content.get("frame", of_format),
    )  # fmt: skip


def _check_file(path: Path) -> None:
    if not path.is_file():
        raise ConfigError(f"no grasps at {path}")
    if path.suffix not in (*_YAML, ".npy"):
        raise ConfigError(f"{path}: grasps are read from .npy and .yaml")


def _entries(content: Any, path: Path) -> list[Any]:
    if isinstance(content, Mapping):
        return [content]
    rows = content.ravel().tolist() if isinstance(content, np.ndarray) and content.dtype == object else content
    if not isinstance(rows, list | tuple):
        raise ConfigError(f"{path}: holds bare numbers; a grasp file is a dictionary, or a list of them")
    return list(rows)


# The formats do not say of which type a grasp is, and this number is none of the taxonomy's 33.
_UNTYPED = ClaimedType.model_construct(number=0, name="not said", type="precision", opposition="pad")


class ImportedGrasp(NamedTuple):
    """One grasp of a file."""

    scenario: Scenario
    grasp: Grasp
    folder: Path


def import_grasp(path: Path, row: int, spec: HandSpec, object_name: str | None = None) -> ImportedGrasp:
    """Grasp number `row` of a file. `object_name`: the object, where the file's own path is not here. The palm is where
    the file has it at the closed posture; of a left hand the scenario has its mirror image, as any. Raises
    ConfigError."""
    grasps = load_grasps(path, spec)
    placed = _object(grasps, row, object_name, path)
    palm = grasps.palm[row, -2]
    if placed.file is not None:
        palm = grasps.palm_from(mesh_middle(placed.file, placed.scale))[row, -2]
    turn, mirror = matrix_from_quaternion(palm[3:]), as_written(spec.side)
    wrist = {"position": (mirror * palm[:3]).tolist(), "facing": (mirror * turn[:, 0]).tolist(),
             "fingers": (mirror * turn[:, 2]).tolist(), "retreat": (0.0, 0.0, 0.0)}  # fmt: skip
    name = f"{path.stem}_{row}"
    grasp = Grasp(name, _UNTYPED, 1.0, "minimum_jerk", grasps.preshape[row], grasps.close[row], grasps.squeeze[row])
    scenario = Scenario.model_validate(
        {"objects": [placed.model_dump()], "grasp": name, "hand": spec.model_reference, "side": spec.side,
         "wrist": wrist, "protocol": "fc"}
    )  # fmt: skip
    return ImportedGrasp(scenario, grasp, path.parent)


@lru_cache(maxsize=32)
def _read(path: Path, changed: int, spec: HandSpec) -> Grasps:
    return read_grasps(path, spec).within(spec)


def load_grasps(path: Path, spec: HandSpec) -> Grasps:
    """Those of a file, with every joint inside its limits. Raises ConfigError."""
    return _read(path, path.stat().st_mtime_ns if path.is_file() else 0, spec)


def assumed_hand(path: Path, spec: HandSpec, *, named: bool) -> str:
    """A sentence on what a file does not say of its hand, and how it is read therefore; empty where it says all.
    `named`: whether a person has named the hand. Raises ConfigError."""
    own, said = own_hand(path), []
    if not named and own.model is None and not own.named:
        said.append(f"says of no hand and names no joints: read as of {spec.name} (--hand has others)")
    if own.frame is None and spec.model != HAND:
        said.append(f"does not say of which frame its poses are: read as of our palm of {spec.name}")
    return f"{path.name}: {'; '.join(said)}" if said else ""


def replaced_object(path: Path, object_name: str, spec: HandSpec) -> str:
    """A sentence on what of a file does not count where `object_name` stands for its object; empty where all does.
    Raises ConfigError."""
    grasps, own = load_grasps(path, spec), Path(object_name).suffix.lower() in SUFFIXES
    said = []
    if Path(grasps.object).stem != Path(object_name).stem:
        said.append(f"its grasps are for {grasps.object!r} and are tried on {object_name}")
    if not own and not np.all(grasps.scale == 1.0):
        scales = ", ".join(f"{scale:g}" for scale in np.unique(grasps.scale)[:3])
        said.append(f"its scale ({scales}) does not count: {object_name} has the catalogue's size")
    return f"{path.name}: {'; '.join(said)}" if said else ""


def _object(grasps: Grasps, row: int, object_name: str | None, path: Path) -> ScenarioObject:
    name = grasps.object if object_name is None else object_name
    if object_name is not None and Path(name).suffix.lower() not in SUFFIXES:
        return parse_object(name)
    places = [Path(name), path.parent / name]
    if object_name is None:
        places.reverse()  # What a file names is beside it.
        if name in object_catalogue():
            if grasps.scale[row] != 1.0:
                raise ConfigError(
                    f"{path}: its object {name!r} has the catalogue's size, and its scale is {grasps.scale[row]:g}: "
                    "write scale: 1, or name a mesh"
                )
            return parse_object(name)
    file = next((place for place in places if place.is_file() and place.suffix.lower() in SUFFIXES), None)
    if file is None:
        raise ConfigError(f"{path}: its object {name!r} is no mesh here and not in the catalogue: say --object FILE")
    scale = None if grasps.scale[row] == 1.0 else float(grasps.scale[row])  # 1 says nothing of the mesh's unit.
    return parse_object(str(file)).model_copy(update={"scale": scale})
