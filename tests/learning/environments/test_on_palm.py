"""How long an object was on the palm is told by `info`, whatever its shape and however the wrist leans."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_vector
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.episode import EpisodeBackend
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.controller import ZeroPolicy
from allegro_twin.learning.tasks.in_hand import ON_PALM, ObjectShapes, palm_clearance
from allegro_twin.learning.tasks.scenes import palm_height
from allegro_twin.learning.training.evaluation import evaluate
from allegro_twin.learning.training.report import Comparison, write_report
from allegro_twin.learning.training.settings import load_recipe
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.surfaces.cli import console

PALM = palm_height(load_spec())

N = 4


def surface(thing: GraspObject, rng: np.random.Generator) -> np.ndarray[Any, Any]:
    """Points of a thing's surface, (k, 3), m: its corners or rims, or many."""
    half = thing.half_extents()
    directions = rng.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    match thing.shape:
        case "box":
            return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
        case "cylinder":
            around = np.linspace(0.0, 2 * np.pi, 20_000)
            up = np.array([0.0, 0.0, 1.0])
            rim = np.stack([np.cos(around), np.sin(around), 0 * around], axis=-1)
            return np.concatenate([(rim + up) * half, (rim - up) * half])
        case "mesh":
            return thing.mesh().vertices
        case _:
            return directions * half


def pyramid(folder: Path) -> GraspObject:
    file = folder / "pyramid.obj"
    file.write_text(
        "v 0 0 0.03\nv 0.02 0.02 0\nv -0.02 0.02 0\nv -0.02 -0.02 0\nv 0.02 -0.02 0\n"
        "f 1 2 3\nf 1 3 4\nf 1 4 5\nf 1 5 2\nf 2 5 4\nf 2 4 3\n"
    )
    return GraspObject("pyramid", "mesh", (), 0.05, file)


def test_the_lowest_point_is_that_of_the_surface(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    things = [
        GraspObject("box", "box", (0.05, 0.06, 0.08), 0.1),
        GraspObject("ball", "sphere", (0.05,), 0.1),
        GraspObject("egg", "ellipsoid", (0.04, 0.07), 0.1),
        GraspObject("can", "cylinder", (0.05, 0.08), 0.1),
        pyramid(tmp_path),
    ]
    pose = np.concatenate([rng.normal(0, 0.05, (5, 3)), rng.normal(size=(5, 4))], axis=-1)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=-1, keepdims=True)
    tilt, factor = rng.uniform(-0.05, 0.05, (5, 3)), np.array([0.9, 1.0, 1.1, 1.05, 1.0])
    which: Any = np.arange(5)
    normal = matrix_from_quaternion(quaternion_from_vector(tilt)) @ [0.0, 0.0, 1.0]
    found = palm_clearance(pose, ObjectShapes(things, np), which, factor, normal, PALM)
    for row, thing in enumerate(things):
        points = surface(thing, rng) * factor[row] @ matrix_from_quaternion(pose[row, 3:]).T + pose[row, :3]
        assert found[row] == pytest.approx((points @ normal[row]).min() - PALM, abs=2e-6), thing.name


def test_the_plane_of_the_palm_leans_with_it() -> None:
    env = HandVectorEnv("Rotate", N, timestep=0.003, randomise={"wrist_tilt": (0.1, 0.3)})
    env.reset(seed=0)
    palm = env.engine.worlds.model.body("palm_link").id
    lean = matrix_from_quaternion(env.engine.worlds.expand("body_quat")[:, palm])
    task: Any = env.engine.task
    # The palm's x looks up; without a tilt the world's z is its normal.
    np.testing.assert_allclose(task._normal, lean @ [1.0, 0.0, 0.0], atol=1e-12)
    plain: Any = HandEnv("Rotate", timestep=0.003).engine.task
    np.testing.assert_array_equal(plain._normal, [[0.0, 0.0, 1.0]])


def upturned() -> Any:
    env = HandEnv("Rotate", timestep=0.003, palm="allowed")
    return env.engine.worlds.model.body("palm_link").quat


def put(env: Any, height: float) -> None:
    """Upright cubes with their lower side so high over the plane of the palm, m, where no finger is."""
    task = env.engine.task
    size = np.asarray(env.engine.worlds.expand("geom_size"))[:, task.object_body.geoms.start, 2]
    task.object_body.pose[:, :2] = -0.2, 0.0
    task.object_body.pose[:, 2] = PALM + height + size
    task.place[:] = task.object_body.pose[:, :3]
    task.object_body.pose[:, 3:] = 1.0, 0.0, 0.0, 0.0
    task.object_body.velocity[:] = task.object_body.spin[:] = 0.0


@pytest.mark.parametrize("task", ["Rotate", "Reorient"])
@pytest.mark.parametrize("kind", ["single", "batch", "tensors"])
def test_the_share_of_decisions_on_the_palm_is_in_info(task: str, kind: str) -> None:
    settings: dict[str, Any] = {"timestep": 0.003, "decimation": 1, "palm": "allowed"}
    env: Any
    if kind == "single":
        env, action = HandEnv(task, **settings), np.zeros(16, np.float32)
    elif kind == "batch":
        env, action = HandVectorEnv(task, N, autoreset_mode="disabled", **settings), np.zeros((N, 16), np.float32)
    else:
        torch = pytest.importorskip("torch", reason="tensors: extra rsl")
        env, action = TensorVectorEnv(task, N, **settings), torch.zeros((N, 16))
    env.reset() if kind == "tensors" else env.reset(seed=0)
    shares = []
    for height in (0.02, 0.02, 0.0025, 0.0025, 0.02, 0.02):
        put(env, height)
        info = env.step(action)[4]
        np.testing.assert_allclose(np.asarray(info["clearance"]), height, atol=2e-4)  # It falls for 3 ms.
        shares.append(np.asarray(info["on_palm"]))
    for found, wanted in zip(shares, (0, 0, 1 / 3, 2 / 4, 2 / 5, 2 / 6), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-6)
    env.reset() if kind == "tensors" else env.reset(seed=1)
    put(env, 0.02)
    np.testing.assert_array_equal(np.asarray(env.step(action)[4]["on_palm"]), 0.0)  # Of this episode alone.


def test_an_episode_begins_above_the_palm_and_a_dropped_cube_ends_on_it() -> None:
    env = HandEnv("Rotate", timestep=0.003, palm="allowed")
    env.reset(seed=0)
    info = env.step(np.zeros(16, np.float32))[4]
    assert info["clearance"] > ON_PALM
    opened = np.array([0.0, -1.0, -1.0, -1.0] * 3 + [0.0, -1.0, -1.0, -1.0], np.float32)
    failed = False
    for _ in range(40):
        _, _, failed, _, info = env.step(opened)
        if failed or info["clearance"] < 0.001:
            break
    assert failed or info["on_palm"] > 0.0


@pytest.mark.slow
def test_evaluations_report_it_in_tables_files_and_over_can(tmp_path: Path) -> None:
    settings = EnvSettings(timestep=0.003, decimation=100, palm="allowed")
    found = evaluate(ZeroPolicy(16), "Rotate", settings, 2, seed=3)
    assert found.shares["on_palm"].shape == (2,)
    assert ((found.shares["on_palm"] >= 0.0) & (found.shares["on_palm"] <= 1.0)).all()
    both = [Comparison("trained on", found, found)]
    table = console.policy_table(both, load_recipe("rotate_on_palm"), 3)
    assert "on palm, share of time: policy, no action" in [column.header for column in table.columns]
    write_report(both, tmp_path / "evaluation.json")
    assert '"on_palm"' in (tmp_path / "evaluation.json").read_text()
    episode = EpisodeBackend("Rotate", settings, 3)
    episode.reset()
    assert episode.shares == {"on_palm": 0.0, "by_tips": 0.0}
