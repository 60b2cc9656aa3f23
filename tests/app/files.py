"""A short protocol, a scenario that is the user's own, and grasps as others write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from allegro_twin.grasping.interchange.dexgraspbench import write_dexgraspbench
from allegro_twin.grasping.interchange.grasps import PALM, Grasps, check_grasps
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.kinematics.orientation import matrix_facing, quaternion_from_matrix
from allegro_twin.spec import Side
from allegro_twin.types import Array

SHORT = """version: 7
floating: true
physics: {{gravity: [0, 0, 0]}}
phases:
  - {{name: close, seconds: 0.15, hand: close}}
  - {{name: squeeze, seconds: 0.15, hand: squeeze}}
  - {{name: push, seconds: 0.15, push: [{push}, 0, 0], check: true}}
reference: squeeze
"""
"""Half a second, and no table."""


def short(folder: Path, push: float = 10.0) -> Path:
    """A protocol with a push of so many m/s²."""
    path = folder / f"short_{push:g}.yaml"
    path.write_text(SHORT.format(push=push))
    return path


def scenario(folder: Path, friction: float = 0.8) -> Path:
    """A lemon of the user's own, or the same again with another friction."""
    _, path = load_scenario("lemon")
    mine = folder / "mine.yaml"
    mine.write_text(path.read_text().replace("friction: 0.8", f"friction: {friction}"))
    return mine


def grasps(path: Path, count: int = 1, thing: str = "lemon", hand: str = "allegro", side: Side = "right") -> Grasps:
    """A hand's own grasp of the lemon as a file of DexGraspBench's, each 1 mm further along x."""
    spec = load_spec(hand, side)
    settings, _ = load_scenario("lemon" if hand == "allegro" else f"{hand}_lemon")
    grasp = load_grasp(settings.grasp, spec)
    turn = quaternion_from_matrix(matrix_facing(settings.wrist.facing, settings.wrist.fingers))
    x, y, z = settings.wrist.position
    if side == "left":
        y, turn = -y, turn * [1.0, -1.0, 1.0, -1.0]
    palms: Array = np.array([[x + 0.001 * k, y, z, *turn] for k in range(count)])
    joints = [[grasp.preshape, grasp.close, grasp.squeeze]] * count
    made = check_grasps(
        spec, np.repeat(palms[:, None], 3, axis=1), joints, [0.0, 0, 0, 1, 0, 0, 0], 1.0,
        object_name=thing, frame=PALM, source=str(path),
    )  # fmt: skip
    write_dexgraspbench(path, made)
    return made
