"""Grasps from a file of any format that is known, told apart by what is in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.grasping.interchange.dexgraspbench import Order, from_record
from allegro_twin.grasping.interchange.dexgraspnet import from_entries
from allegro_twin.grasping.interchange.grasps import FRAMES, Grasps
from allegro_twin.grasping.interchange.ours import read_yaml_grasps
from allegro_twin.grasping.interchange.plain import load_plain
from allegro_twin.spec import HandSpec


def read_grasps(path: Path, spec: HandSpec, *, order: Order = None, frame: str | None = None) -> Grasps:
    """DexGraspBench, BODex, Dexonomy or DexGraspNet `.npy`, or our YAML.

    `order`: of the joints in a file without names, one of `orders.orders`. `frame`: of the hand, `palm` or `menagerie`,
    where it is another than the format's own. Raises ConfigError, in a line.
    """
    if frame is not None and frame not in FRAMES:
        raise ConfigError(unknown("frame", frame, FRAMES))
    if not path.is_file():
        raise ConfigError(f"no grasps at {path}")
    if path.suffix in (".yaml", ".yml"):
        return read_yaml_grasps(path, spec)
    if path.suffix != ".npy":
        raise ConfigError(f"{path}: grasps are read from .npy and .yaml")
    content = load_plain(path)
    if isinstance(content, Mapping) and "qpos" not in content:
        return from_record(content, spec, path, order=order, frame=FRAMES[frame] if frame else None)
    return from_entries(_entries(content, path), spec, path)


def _entries(content: Any, path: Path) -> list[Any]:
    if isinstance(content, Mapping):
        return [content]
    rows = content.ravel().tolist() if isinstance(content, np.ndarray) and content.dtype == object else content
    if not isinstance(rows, list | tuple):
        raise ConfigError(f"{path}: holds bare numbers; a grasp file is a dictionary, or a list of them")
    return list(rows)
