"""The dictionaries of DexGraspBench, and of BODex, Dexonomy and whoever else writes the same keys."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.grasping.interchange.grasps import (
    FRAMES,
    MENAGERIE,
    PALM,
    Grasps,
    PalmFrame,
    check_grasps,
    check_hand,
)
from allegro_twin.grasping.interchange.orders import joint_orders, menagerie_order, order_by_name, reorder_joints
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import HAND
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

Order = str | tuple[int, ...] | None
_QPOS = ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")
_OBJECT = ("obj_path", "obj_code", "obj_name", "object_code", "scene_path")


def read_record(
    record: Mapping[str, Any], spec: HandSpec, source: Path, *, order: Order = None, frame: PalmFrame | None = None
) -> Grasps:
    """The grasps of a file's dictionary: `robot_pose` (BODex: of its URDF's palm), or the three `*_qpos` and perhaps
    `approach_qpos` (DexGraspBench: of Menagerie's world). Of another hand than the Allegro the pose is our palm's. A
    file that we wrote says which hand, side and frame it has. Raises ConfigError."""
    where = str(source)
    check_hand(record.get("hand"), record.get("side"), spec, where)
    raw = "robot_pose" in record
    stages = _robot_pose(record, where) if raw else _qpos(record, where)
    if stages.shape[-1] < 8:
        raise ConfigError(f"{where}: {stages.shape[-1]} numbers a grasp: a pose of 7 and one a joint are needed")
    if "joint_names" in record and order is None:
        order = order_by_name(_texts(record["joint_names"], where), spec, where)
    menagerie = not raw and spec.model == HAND
    if order is None and menagerie:
        order = menagerie_order(spec)
    if frame is None:
        frame = FRAMES.get(str(record.get("frame")), MENAGERIE if menagerie else PALM)
    return check_grasps(
        spec, stages[..., :7], reorder_joints(stages[..., 7:], spec, where, order),
        _of_object(record, "obj_pose", (1, 0, 0, 0), len(stages), where), _scale(record, len(stages), where),
        object_name=next((str(record[key]) for key in _OBJECT if key in record), source.parent.name),
        frame=frame, source=where,
    )  # fmt: skip


def make_record(grasps: Grasps) -> dict[str, Any]:
    """The dictionary of DexGraspBench: of one grasp as its own tools take it, of more with one row a grasp. Of the
    Allegro as Menagerie's file has it; of another hand with its own joints' names and the pose of our palm. With three
    keys of ours: `hand`, `side`, `frame`."""
    spec, frame, order = grasps.spec, PALM, list(range(grasps.spec.n_joints))
    if spec.model == HAND:
        spec, frame = load_spec(side=spec.side, serial=f"menagerie_{spec.side}"), MENAGERIE
        order = list(joint_orders(spec)[menagerie_order(spec)])
    there = grasps.in_frame(frame)
    rows = np.concatenate([there.hand, there.joints[..., order]], axis=-1)
    names = spec.joints if spec.foreign is None or spec.foreign.keeps else spec.foreign.joints
    record: dict[str, Any] = {
        "hand": spec.model,
        "side": spec.side,
        "frame": frame.name,
        "obj_path": there.object,
        "obj_pose": np.array(there.object_pose),
        "obj_scale": np.array(there.scale),
        "joint_names": [names[joint] for joint in order],
        **{key: rows[:, stage - 3] for stage, key in enumerate(_QPOS)},
    }
    if rows.shape[1] > 3:
        record["approach_qpos"] = rows[:, :-3]
    if len(there) == 1:
        arrays = {key: value[0] for key, value in record.items() if isinstance(value, np.ndarray)}
        record |= arrays | {"obj_scale": float(there.scale[0])}
    return record


def write_dexgraspbench(path: Path, grasps: Grasps) -> None:
    """A `.npy` that DexGraspBench reads; its own tools want one grasp a file. Raises RecordingError."""
    with atomic_file(path) as temporary:
        np.save(temporary, np.array(make_record(grasps), dtype=object), allow_pickle=True)


def _robot_pose(record: Mapping[str, Any], where: str) -> Array:
    """(k, s, 7 + n), from the same with a world in front."""
    found = _numbers(record, "robot_pose", where)
    if found.ndim == 4 and found.shape[0] == 1:
        found = found[0]
    if found.ndim != 3 or (len(found) and found.shape[1] < 3):
        raise ConfigError(f"{where}: robot_pose has the shape (worlds 1, grasps, 3 or more stages, 7 + joints), not "
                          f"{np.shape(record['robot_pose'])}")  # fmt: skip
    return found


def _qpos(record: Mapping[str, Any], where: str) -> Array:
    """The stages that are there, one after the other, (k, s, 7 + n)."""
    pre, grasp, squeeze = (_with_pose(record, key, where) for key in _QPOS)
    if grasp.ndim == 2 and len(grasp) == 1 and pre.ndim == 2 and len(pre) > 1:
        stages = [pre[None], grasp[None], squeeze.reshape(1, 1, -1)]  # The way to one grasp, as some write it.
    else:
        stages = [np.atleast_2d(rows)[:, None] for rows in (pre, grasp, squeeze)]
    if "approach_qpos" in record:
        way = _numbers(record, "approach_qpos", where)
        stages.insert(0, way[None] if way.ndim == 2 else way)
    try:
        return np.concatenate(stages, axis=1)
    except ValueError as error:
        sizes = ", ".join(f"{key} {np.shape(record[key])}" for key in _QPOS)
        raise ConfigError(f"{where}: the stages do not fit each other: {sizes}") from error


def _with_pose(record: Mapping[str, Any], key: str, where: str) -> Array:
    """Pose and joints in one row; DexGraspBench's first version has the pose apart."""
    joints, pose = _numbers(record, key, where), key.replace("_qpos", "_pose")
    if "grasp_pose" not in record:
        return joints
    placed = _numbers(record, pose if pose in record else "grasp_pose", where)
    return np.concatenate([placed, joints], axis=-1)


def _scale(record: Mapping[str, Any], count: int, where: str) -> Array:
    found = _numbers(record, "obj_scale", where).ravel() if "obj_scale" in record else np.ones(1)
    if len(found) not in (1, count):
        raise ConfigError(f"{where}: obj_scale has {len(found)} values for {count} grasps")
    return found if len(found) == count else np.full(count, found[0])


def _of_object(record: Mapping[str, Any], key: str, turn: tuple[int, ...], count: int, where: str) -> Array:
    """The object's pose for each grasp, (k, 7); at the origin where the file says nothing."""
    found = _numbers(record, key, where) if key in record else np.array([0.0, 0, 0, *turn])
    if found.shape[-1:] != (7,) or found.size not in (7, 7 * count):
        raise ConfigError(
            f"{where}: {key} has the shape {found.shape} for {count} grasps; it is 7 numbers, or 7 a grasp"
        )
    return found.reshape(-1, 7)


def _texts(names: object, where: str) -> list[str]:
    found = names.tolist() if isinstance(names, np.ndarray) else names
    if not isinstance(found, list | tuple) or not all(isinstance(name, str) for name in found):
        raise ConfigError(f"{where}: joint_names is no list of names, but {type(names).__name__}")
    return list(found)


def _numbers(record: Mapping[str, Any], key: str, where: str) -> Array:
    if key not in record:
        raise ConfigError(f"{where}: has no {key}; it has: {', '.join(sorted(repr(name) for name in record))}")
    try:
        return np.asarray(record[key], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {key} is no array of numbers, but {type(record[key]).__name__}") from error
