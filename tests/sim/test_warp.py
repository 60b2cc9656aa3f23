"""On a Warp device the same tasks run on the same physics, as exactly as single precision allows.

Levels and tolerances are those of the parity guide in MuJoCo's manual (doc/skills/parity). The kernels compile for
minutes when they have not been cached yet, and run on one processor here, so these tests are long.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.types import Array

T, FAIR = 20, 6
"""Simulations; how many must be left to compare."""
GRAZING = 1e-5  # m. Contacts so near the threshold may be on either side of it in single precision.
# atol and rtol of what a forward pass computes.
FORWARD = {
    "xpos": (1e-5, 1e-4),
    "xquat": (1e-5, 1e-4),
    "geom_xpos": (1e-5, 1e-4),
    "qfrc_bias": (1e-3, 1e-3),
    "qfrc_passive": (1e-3, 1e-3),
    "qfrc_actuator": (1e-3, 1e-3),
    "qfrc_smooth": (1e-3, 1e-3),
    "qfrc_constraint": (1e-1, 1e-2),
    "qacc": (1e-1, 1e-2),
}
SCENES: list[tuple[str, dict[str, Any]]] = [
    ("Reach", {}),
    ("Grasp", {"objects": ("tennis_ball", "orange"), "randomise": "default"}),
    ("Grasp", {"objects": ("tennis_ball", "foam_brick"), "randomise": "default"}),
    ("Reorient", {}),
]


def warp() -> Any:
    pytest.importorskip("mujoco_warp", reason="mujoco_warp is not installed: pip install 'allegro-twin[warp]'")
    return __import__("mujoco_warp")


def pair(task: str, **kwargs: Any) -> tuple[HandVectorEnv, HandVectorEnv]:
    """The same episodes on MuJoCo and on Warp's CPU device, some steps after their beginning."""
    kwargs = {"autoreset_mode": "disabled", **kwargs}  # Another episode would have another size and friction.
    cpu, device = HandVectorEnv(task, T, threads=1, **kwargs), HandVectorEnv(task, T, device="warp:cpu", **kwargs)
    cpu.reset(seed=0)
    device.reset(seed=0)
    generator = np.random.default_rng(0)
    for _ in range(30):
        cpu.step(generator.uniform(-0.7, 0.7, (T, 16)).astype(np.float32))
    follow(cpu, device)
    return cpu, device


def follow(cpu: HandVectorEnv, device: HandVectorEnv) -> None:
    """Give the device's simulations the states of the others, rounded to single precision on both sides."""
    for row in range(T):
        state = cpu.engine.worlds.state(row).astype(np.float32).astype(np.float64)
        cpu.engine.worlds.restore(row, state)
        device.engine.worlds.restore(row, state)


def seen(env: HandVectorEnv, row: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
    snapshot = env.engine.worlds.snapshot(row)
    return snapshot.model, snapshot.data


def clear(data: mujoco.MjData) -> bool:
    """Whether no contact is at the edge between being one and not being one."""
    return not bool((np.abs(data.contact.dist - data.contact.includemargin) <= GRAZING).any())


@pytest.mark.long
@pytest.mark.parametrize(("task", "kwargs"), SCENES)
def test_from_the_same_states_one_step_on_the_device_comes_to_the_same_speeds(
    task: str, kwargs: dict[str, Any]
) -> None:
    """Level two: a batch of states of a trajectory, one step from each, each simulation with its own model."""
    warp()
    cpu, device = pair(task, **kwargs)
    ours, theirs = cpu.engine.worlds, device.engine.worlds
    scenes = [seen(cpu, row) for row in range(T)]
    fair = [row for row, (_, data) in enumerate(scenes) if clear(data)]
    assert len(fair) >= FAIR, "too few states say something"
    qacc = np.array([data.qacc for _, data in scenes])
    ours.step(None, 1)
    theirs.step(None, 1)
    speeds = [np.array([seen(env, row)[1].qvel for row in range(T)]) for env in (cpu, device)]
    atol, rtol = FORWARD["qacc"]
    allowed = device.engine.settings.timestep * (atol + rtol * np.abs(qacc))
    worst = np.abs(speeds[0] - speeds[1]) / allowed
    assert worst[fair].max() <= 1.0
    assert worst.max() > 0.0, "two engines that agree to the bit are one"


@pytest.mark.long
@pytest.mark.parametrize(("task", "kwargs"), SCENES)
def test_every_stage_of_a_forward_pass_agrees(task: str, kwargs: dict[str, Any]) -> None:
    """Level one: which stage of the pipeline is the first to differ."""
    mjw = warp()
    cpu, device = pair(task, **kwargs)
    worlds: Any = device.engine.worlds  # What is on the device is nobody's business but this test's.
    worlds.step(None, 1)
    follow(device, cpu)
    mjw.forward(worlds._m, worlds._d)
    fields = {name: getattr(worlds._d, name).numpy() for name in FORWARD}
    compared = 0
    for row in range(T):
        model, data = seen(device, row)
        if not clear(data):
            continue
        compared += 1
        rounding = of_rounding(model, data)
        for name, (atol, rtol) in FORWARD.items():
            reference = getattr(data, name)
            ours = fields[name][row].reshape(reference.shape)
            if name == "xquat":
                ours = np.where((ours * reference).sum(axis=-1, keepdims=True) < 0, -ours, ours)
            extra = rounding if name == "qacc" else 0.0
            error = np.abs(ours - reference) / (atol + rtol * np.abs(reference) + extra)
            assert error.max() <= 1.0, f"{name} of simulation {row}: {error.max():.1f} times what is allowed"
    assert compared >= FAIR


def of_rounding(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """What rounding forces and inertias to single precision may do to accelerations: 8 ε |M⁻¹| (|M| |q̈| + |f|)."""
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    force = np.abs(data.qfrc_smooth) + np.abs(data.qfrc_constraint)
    bound = np.abs(np.linalg.inv(mass)) @ (np.abs(mass) @ np.abs(data.qacc) + force)
    return np.asarray(8.0 * float(np.finfo(np.float32).eps) * bound)


@pytest.mark.long
def test_an_episode_on_the_device_is_that_of_the_processor_until_rounding_has_grown() -> None:
    """Level three, through the environment: observations, rewards, ends and infos. Nothing touches in these steps."""
    warp()
    cpu, device = HandVectorEnv("Reach", 4), HandVectorEnv("Reach", 4, device="warp:cpu")
    for env in (cpu, device):
        env.reset(seed=5, options={"posture": "home"})
    generator = np.random.default_rng(1)
    for _ in range(12):
        action = generator.uniform(-0.3, 0.3, (4, 16)).astype(np.float32)
        (first, reward, *ends, _), (second, theirs, *their_ends, _) = cpu.step(action), device.step(action)
        assert isinstance(first, dict)
        assert isinstance(second, dict)
        # The steepest number in an observation, kp over the torque limit, is 51 a radian: 4 µrad.
        np.testing.assert_allclose(first["observation"], second["observation"], atol=2e-4)
        np.testing.assert_allclose(first["achieved_goal"], second["achieved_goal"], atol=1e-6)
        np.testing.assert_allclose(reward, theirs, atol=1e-5)
        np.testing.assert_array_equal(ends, their_ends)


@pytest.mark.long
def test_simulations_that_do_not_step_stay_as_they_are() -> None:
    warp()
    device = HandVectorEnv("Reach", 4, device="warp:cpu")
    device.reset(seed=0)
    worlds = device.engine.worlds
    worlds.control[:] = 0.1
    before = [worlds.state(row) for row in range(4)]
    worlds.step(np.array([0, 2]), 1)
    moved = [not np.array_equal(worlds.state(row), before[row]) for row in range(4)]
    assert moved == [True, False, True, False]


@pytest.mark.long
def test_an_action_copies_little_between_device_and_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """For NumPy's environment the actions go up, and what overflowed and the outcome come down; a learner on the device
    asks only what overflowed, and who has ended."""
    warp()
    torch = pytest.importorskip("torch")
    copies: list[str] = []

    def counted(kind: str, owner: Any, name: str) -> None:
        original = getattr(owner, name)

        def noted(*args: Any, **kwargs: Any) -> Any:
            copies.append(kind)
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, noted)

    ours, theirs = HandVectorEnv("Rotate", 4, device="warp:cpu"), TensorVectorEnv("Rotate", 4, device="warp:cpu")
    ours.reset(seed=0)
    theirs.reset()
    still = torch.zeros((4, 16))
    counted("up", torch, "tensor")
    for name in ("cpu", "item", "tolist", "__bool__", "__int__", "__float__"):
        counted("down", torch.Tensor, name)
    counted("down", torch, "nonzero")
    ours.step(np.zeros((4, 16), np.float32))
    assert sorted(copies) == ["down", "down", "up"]
    copies.clear()
    theirs.step(still)
    assert copies == ["down", "down"]


@pytest.mark.long
@pytest.mark.parametrize("room", [{"contacts": 1}, {"constraints": 20}])
def test_contacts_that_find_no_room_are_an_error_and_not_left_out(room: dict[str, Any]) -> None:
    warp()
    device = HandVectorEnv("Reorient", 2, device="warp:cpu", **room)
    device.reset(seed=0)
    with pytest.raises(ConfigError, match="more contacts or constraints than room on the device .*: raise contacts"):
        device.step(np.zeros((2, 16), np.float32))


@pytest.mark.long
@pytest.mark.parametrize("why", ["_missed", "_outgrown"])
def test_a_contact_that_is_given_up_or_too_many_constraints_end_that_episode_alone(why: str) -> None:
    warp()
    n, second = 10, np.arange(10) == 1
    device = HandVectorEnv("Reorient", n, device="warp:cpu", autoreset_mode="disabled")
    device.reset(seed=0)
    worlds: Any = device.engine.worlds
    worlds._overflow[1] |= getattr(worlds, why)
    _, _, terminated, _, info = device.step(np.zeros((n, 16), np.float32))
    assert list(info["diverged"]) == list(second)
    assert list(terminated) == list(second)
    device.reset(options={"reset_mask": second})
    _, _, terminated, _, info = device.step(np.zeros((n, 16), np.float32))
    assert not terminated.any()
    assert not info.get("diverged", np.zeros(3)).any()
    assert bool(worlds.position.isfinite().all())


@pytest.mark.long
def test_room_that_more_than_a_tenth_outgrow_is_too_small() -> None:
    warp()
    device = HandVectorEnv("Reorient", 10, device="warp:cpu", autoreset_mode="disabled")
    device.reset(seed=0)
    worlds: Any = device.engine.worlds
    worlds._overflow[:2] |= worlds._outgrown
    with pytest.raises(
        ConfigError, match="simulation 0 of 10 has more contacts or constraints than room on the device"
    ):
        worlds.check()


@pytest.mark.long
def test_contacts_on_the_device_are_those_of_every_physics_step() -> None:
    warp()
    device = HandVectorEnv("Reorient", 4, device="warp:cpu")
    device.reset(seed=0)
    worlds: Any = device.engine.worlds
    states, singly = [worlds.state(row) for row in range(4)], []
    for _ in range(3):
        worlds.step(None, 1)
        singly.append(np.array(worlds.contact_steps[0].cpu()))
    for row, state in enumerate(states):
        worlds.restore(row, state)
    worlds.step(None, 3)
    assert np.abs(singly).max() > 0.01
    np.testing.assert_allclose(np.array(worlds.contact_steps.cpu()), singly, rtol=1e-3, atol=1e-3)


@pytest.mark.long
def test_objects_of_several_shapes_weigh_and_turn_as_they_do_on_processors() -> None:
    warp()
    names = ("tennis_ball", "tomato_soup_can", "rubiks_cube", "lemon")
    device, cpu = (HandVectorEnv("Grasp", 8, device=where, objects=names) for where in ("warp:cpu", "cpu"))
    _, info = device.reset(seed=0)
    assert set(info["object"]) == set(names)
    assert list(info["object"]) == list(cpu.reset(seed=0)[1]["object"])
    for row in range(8):
        one, other = (env.engine.worlds.snapshot(row).model for env in (device, cpu))
        assert one.body("object").mass == pytest.approx(other.body("object").mass, rel=1e-6)
        assert one.body("object").inertia == pytest.approx(other.body("object").inertia, rel=1e-6)
    device.step(np.zeros((8, 16), np.float32))


def test_boxes_of_meshes_are_not_repeated_for_every_simulation() -> None:
    """They are tens of thousands, and only pictures look at them: 8,192 copies took 11 GB."""
    warp()
    pytest.importorskip("torch")
    worlds = TensorVectorEnv("Rotate", 3, device="warp:cpu").engine.worlds
    assert worlds.expand("bvh_aabb").shape[1] < 100 < len(worlds.model.bvh_aabb)
    np.testing.assert_allclose(worlds.snapshot(1).model.bvh_aabb, worlds.models[0].bvh_aabb, atol=1e-6)


@pytest.mark.long
def test_meshes_of_several_shapes_need_the_processor(tmp_path: Path) -> None:
    warp()
    path = tmp_path / "wedge.obj"
    path.write_text("v 0 0 0\nv .06 0 0\nv 0 .06 0\nv 0 0 .06\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    wedge = {"name": "wedge", "shape": "mesh", "file": str(path), "mass": 0.1, "like": "rubiks_cube"}
    with pytest.raises(ConfigError, match="same layout|choose objects of primitive shapes, or one mesh"):
        HandVectorEnv("Grasp", 2, device="warp:cpu", objects=("tennis_ball", wedge))


def test_without_mujoco_warp_its_device_is_refused_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(ConfigError, match=r"device 'warp' needs MuJoCo Warp: pip install 'allegro-twin\[warp\]'"):
        HandEnv("Reach", device="warp")


def test_without_a_gpu_its_device_is_refused_and_nothing_takes_its_place() -> None:
    warp()
    if __import__("warp").get_cuda_device_count():
        pytest.skip("there is an NVIDIA GPU here")
    with pytest.raises(ConfigError, match="device 'warp' needs an NVIDIA GPU, and Warp finds none; 'cpu' is MuJoCo"):
        HandEnv("Reach", device="warp")


def test_an_unknown_device_is_named() -> None:
    with pytest.raises(ConfigError, match="device: input should be 'cpu', 'warp' or 'warp:cpu', not 'gpu'"):
        HandEnv("Reach", device="gpu")
