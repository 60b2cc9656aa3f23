"""Grasps as others write them, made into what a trial needs: a scenario without a table, and a grasp."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.interchange.grasps import Grasps
from allegro_twin.grasping.interchange.read import read_grasps
from allegro_twin.grasping.scenario import ObjectSettings, Scenario, object_of
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.taxonomy import ClaimedType
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.objects.meshes import SUFFIXES, middle_of
from allegro_twin.spec import HandSpec

# The formats do not say of which type a grasp is, and this number is none of the taxonomy's 33.
_UNTYPED = ClaimedType.model_construct(number=0, name="not said", type="precision", opposition="pad")


class Foreign(NamedTuple):
    """One grasp of a file."""

    scenario: Scenario
    grasp: Grasp
    folder: Path


def foreign(path: Path, row: int, spec: HandSpec, thing: str | None = None) -> Foreign:
    """Grasp number `row` of a file. `thing`: the object, where the file's own path is not here. The palm stays where
    the file has it at the closed posture. Raises ConfigError."""
    grasps = grasps_in(path, spec)
    placed = _object(grasps, row, thing, path)
    palm = grasps.palm[row, -2]
    if placed.file is not None:
        palm = grasps.palm_from(middle_of(placed.file, placed.scale))[row, -2]
    turn = matrix_from_quaternion(palm[3:])
    wrist = {"position": palm[:3].tolist(), "facing": turn[:, 0].tolist(), "fingers": turn[:, 2].tolist(),
             "retreat": (0.0, 0.0, 0.0)}  # fmt: skip
    name = f"{path.stem}_{row}"
    grasp = Grasp(name, _UNTYPED, 1.0, "minimum_jerk", grasps.preshape[row], grasps.close[row], grasps.squeeze[row])
    scenario = Scenario.model_validate(
        {"objects": [placed.model_dump()], "grasp": name, "side": spec.side, "wrist": wrist, "protocol": "fc"}
    )
    return Foreign(scenario, grasp, path.parent)


@lru_cache(maxsize=32)
def _read(path: Path, changed: int, spec: HandSpec) -> Grasps:
    return read_grasps(path, spec).within(spec)


def grasps_in(path: Path, spec: HandSpec) -> Grasps:
    """Those of a file, with every joint inside its limits. Raises ConfigError."""
    return _read(path, path.stat().st_mtime_ns if path.is_file() else 0, spec)


def _object(grasps: Grasps, row: int, thing: str | None, path: Path) -> ObjectSettings:
    name = grasps.object if thing is None else thing
    if thing is not None and Path(name).suffix.lower() not in SUFFIXES:
        return object_of(name)
    places = [Path(name), path.parent / name]
    file = next((place for place in places if place.is_file() and place.suffix.lower() in SUFFIXES), None)
    if file is None:
        raise ConfigError(f"{path}: its object {name!r} is no mesh here: say --object FILE")
    scale = float(grasps.scale[row])
    return object_of(str(file)).model_copy(update={"scale": scale})
