"""DexGraspNet's entries: grasps with their joints by name and the wrist in translation and Euler angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.interchange.grasps import PALM, Grasps, check_grasps
from allegro_twin.grasping.interchange.orders import joint_names, order_by_name, permute_joints, reorder_joints
from allegro_twin.kinematics.orientation import quaternion_from_euler
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

_POSITION, _TURN = ("WRJTx", "WRJTy", "WRJTz"), ("WRJRx", "WRJRy", "WRJRz")
OPENED, PRESSED = 0.9, 1.1
"""Scales of the joints for the pre-shape and the squeeze that these entries lack, as DexGraspBench makes them."""


def read_entries(entries: Sequence[Mapping[str, Any]], spec: HandSpec, source: Path) -> Grasps:
    """The grasps of a file, whose object lies at the origin, scaled. Raises ConfigError."""
    where = str(source)
    if not len(entries):
        raise ConfigError(f"{where}: holds no grasp")
    known = joint_names(spec)
    rows = [_row(entry, spec, f"{where}: grasp {number}", known) for number, entry in enumerate(entries)]
    pose, joints, scale = (np.array(column) for column in zip(*rows, strict=True))
    postures = np.stack([OPENED * joints, joints, PRESSED * joints], axis=1)
    added = f"{where} (pre-shape and squeeze: {OPENED} and {PRESSED} times the joints)"
    reorder_joints(postures, spec, where)
    return check_grasps(
        spec, np.repeat(pose[:, None], 3, axis=1), postures, [0, 0, 0, 1, 0, 0, 0], scale,
        object_name=str(entries[0].get("object_code", source.stem)), frame=PALM, source=added,
    )  # fmt: skip


def _row(entry: Mapping[str, Any], spec: HandSpec, where: str, known: Mapping[str, int]) -> tuple[Array, Array, float]:
    """Pose (7,), joints (n,), scale."""
    found = entry.get("qpos") if isinstance(entry, Mapping) else None
    if not isinstance(found, Mapping):
        raise ConfigError(f"{where}: is no mapping with a `qpos` of joints by name")
    missing = [name for name in (*_POSITION, *_TURN) if name not in found]
    if missing:
        raise ConfigError(f"{where}: qpos has no {', '.join(missing)}")
    names = [str(name) for name in found if name not in (*_POSITION, *_TURN)]
    order = order_by_name(names, spec, where, known)
    values = {str(name): _number(value, f"{where}: {name}") for name, value in found.items()}
    turn = quaternion_from_euler([values[name] for name in _TURN])
    pose = np.concatenate([[values[name] for name in _POSITION], turn])
    joints = permute_joints(np.array([values[name] for name in names]), order)
    return pose, joints, _number(entry.get("scale", 1.0), f"{where}: scale")


def _number(value: object, what: str) -> float:
    try:
        return float(value)  # type: ignore[arg-type]  # Whatever the file has.
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{what} is no number, but {type(value).__name__}") from error
