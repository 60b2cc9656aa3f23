"""Grasp files as others write them, made here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.hands.library.library import load_grasp
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

STAGES = ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos")


def saved(path: Path, content: object) -> Path:
    """As NumPy saves a Python object."""
    boxed = np.empty((), dtype=object)
    boxed[()] = content
    np.save(path, boxed, allow_pickle=True)
    return path


def unit(seed: int) -> Array:
    values = np.random.default_rng(seed).normal(size=4)
    return np.asarray(values / np.linalg.norm(values))


def poses(seed: int, count: int = 3) -> Array:
    """Of a hand in the world, one a stage, (count, 7)."""
    rng = np.random.default_rng(seed)
    return np.array([[*rng.uniform(-0.2, 0.2, 3), *unit(seed + k)] for k in range(count)])


def postures(spec: HandSpec) -> Array:
    """(3, 16), rad."""
    grasp = load_grasp("medium_wrap", spec)
    return np.array([grasp.preshape, grasp.close, grasp.squeeze])


def bench(spec: HandSpec, seed: int = 1) -> dict[str, Any]:
    """DexGraspBench's dictionary of one grasp."""
    rows = np.hstack([poses(seed), postures(spec)])
    return {
        "obj_path": "assets/DGNObj/core_mug",
        "obj_scale": 0.08,
        "obj_pose": np.array([0.1, -0.2, 0.05, *unit(seed + 9)]),
        **dict(zip(STAGES, rows, strict=True)),
    }


def stacked(spec: HandSpec, count: int = 4) -> dict[str, Any]:
    """The same keys with a row a grasp."""
    records = [bench(spec, seed) for seed in range(count)]
    return records[0] | {key: np.array([record[key] for record in records]) for key in (*STAGES, "obj_pose")}


def bodex(spec: HandSpec, count: int = 2) -> dict[str, Any]:
    """BODex's own: one world, some grasps, three stages."""
    rows = np.array([np.hstack([poses(seed), postures(spec)]) for seed in range(count)])
    return {
        "robot_pose": rows[None],
        "joint_names": list(spec.joints),
        "obj_pose": np.array([[0.0, 0, 0.1, 1, 0, 0, 0]]),
        "obj_scale": np.array([0.1]),
        "obj_path": "core_bottle",
    }


def net(spec: HandSpec, count: int = 2) -> list[dict[str, Any]]:
    """DexGraspNet's list; its joints in no order."""
    entries = []
    for seed in range(count):
        close = dict(zip(spec.joints, postures(spec)[1].tolist(), strict=True))
        names = np.random.default_rng(seed).permutation(list(close))
        wrist = {"WRJTx": 0.01, "WRJTy": -0.02, "WRJTz": 0.1, "WRJRx": 0.3, "WRJRy": -0.2, "WRJRz": 1.0 + seed}
        entries.append({"qpos": wrist | {str(name): close[str(name)] for name in names}, "scale": 0.06 + 0.02 * seed})
    return entries
