"""The generated models are up to date, agree with the official table, with each other and with their mirror image."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description import facts, inertia
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.generate.__main__ import stale
from allegro_twin.hands.generate.mesh import rounded_box
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run, until
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import SIDES, HandSpec, Side
from allegro_twin.types import Array

SPECS = {side: load_spec(side=side) for side in SIDES}
SEEDS = st.integers(0, 2**32 - 1)


def mjcf(side: Side) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_path(str(data_root() / "models" / "mjcf" / f"allegro_{side}.xml"))
    return model, mujoco.MjData(model)


MODELS = {side: mjcf(side) for side in SIDES}
HANDS = {side: hand_kinematics(SPECS[side]) for side in SIDES}


def random_posture(seed: int, spec: HandSpec) -> Array:
    return np.random.default_rng(seed).uniform(spec.lower, spec.upper)


def tips_in_mujoco(side: Side, position: Array) -> dict[str, tuple[Array, Array]]:
    model, data = MODELS[side]
    data.qpos[:] = position
    mujoco.mj_forward(model, data)
    return {
        f.name: (data.site(f.tip).xpos.copy(), data.site(f.tip).xmat.reshape(3, 3).copy()) for f in SPECS[side].fingers
    }


def test_the_committed_models_are_what_the_facts_give() -> None:
    assert stale() == []


def test_a_changed_model_file_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import shutil

    from allegro_twin.hands.generate import __main__ as make

    shutil.copytree(data_root() / "models", tmp_path / "models")
    changed = tmp_path / "models" / "urdf" / "allegro_left.urdf"
    changed.write_text(changed.read_text().replace("0.0435", "0.0436"))
    (tmp_path / "models" / "mjcf" / "left_over.xml").write_text("")
    monkeypatch.setattr(make, "data_root", lambda: tmp_path)
    assert make.stale() == ["mjcf/left_over.xml", "urdf/allegro_left.urdf"]


@pytest.mark.parametrize(
    ("finger", "thumb_0", "expected"),
    [
        ("index", 0.263, (0.0, 0.05531, 0.13344)),
        ("middle", 0.263, (0.0, 0.0, 0.13620)),
        ("ring", 0.263, (0.0, -0.05531, 0.13344)),
        ("thumb", 0.263, (0.02596, 0.16123, -0.08550)),
    ],
)
def test_the_right_fingertips_are_where_the_official_urdf_has_them(
    finger: str, thumb_0: float, expected: tuple[float, float, float]
) -> None:
    position = np.zeros(16)
    position[12] = thumb_0
    np.testing.assert_allclose(HANDS["right"].fingertips(position)[finger].position, expected, atol=6e-6)


@settings(max_examples=200, deadline=None)
@given(SEEDS, st.sampled_from(SIDES))
def test_mujoco_and_pinocchio_agree_on_every_fingertip(seed: int, side: Side) -> None:
    position = random_posture(seed, SPECS[side])
    tips = HANDS[side].fingertips(position)
    for name, (place, rotation) in tips_in_mujoco(side, position).items():
        np.testing.assert_allclose(tips[name].position, place, atol=1e-9)
        np.testing.assert_allclose(tips[name].rotation, rotation, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(SEEDS, st.sampled_from(SIDES))
def test_mujoco_and_pinocchio_agree_on_gravity_for_any_direction(seed: int, side: Side) -> None:
    model, data = MODELS[side]
    position = random_posture(seed, SPECS[side])
    gravity = np.random.default_rng(seed + 1).normal(size=3) * 9.81
    model.opt.gravity = gravity
    data.qpos[:], data.qvel[:], data.ctrl[:] = position, 0.0, 0.0
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(HANDS[side].gravity_torque(position, gravity), data.qfrc_bias, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(SEEDS)
def test_the_left_hand_is_the_exact_mirror_image(seed: int) -> None:
    position = random_posture(seed, SPECS["right"])
    mirror = np.diag([1.0, -1.0, 1.0])
    right = HANDS["right"].fingertips(position)
    left = HANDS["left"].fingertips(SPECS["right"].mirror_posture(position))
    for name, pose in right.items():
        np.testing.assert_allclose(left[name].position, mirror @ pose.position, atol=1e-15)
        np.testing.assert_allclose(left[name].rotation, mirror @ pose.rotation @ mirror, atol=1e-14)


@settings(max_examples=100, deadline=None)
@given(SEEDS)
def test_the_left_hand_weighs_on_its_joints_as_the_mirrored_right(seed: int) -> None:
    position = random_posture(seed, SPECS["right"])
    gravity = np.random.default_rng(seed).normal(size=3)
    right = HANDS["right"].gravity_torque(position, gravity)
    left = HANDS["left"].gravity_torque(SPECS["right"].mirror_posture(position), gravity * (1, -1, 1))
    np.testing.assert_allclose(left, SPECS["right"].mirror_posture(right), atol=1e-15)


def test_masses_are_the_manufacturers_drawing(side: Side) -> None:
    model, _ = MODELS[side]
    assert model.body_subtreemass[model.body("palm_link").id] == pytest.approx(1.1644, abs=1e-12)
    for first, mass in (("link_0.0", 0.1466), ("link_4.0", 0.1466), ("link_8.0", 0.1466), ("link_12.0", 0.2122)):
        assert model.body_subtreemass[model.body(first).id] == pytest.approx(mass, abs=1e-12)
    assert model.body("palm_link").mass[0] == pytest.approx(0.5124, abs=1e-12)


def test_every_inertia_is_that_of_a_body_which_can_exist(side: Side) -> None:
    for link in facts.load_facts("allegro", side).links:
        principal = np.linalg.eigvalsh(inertia.link_inertia(link).inertia)
        assert principal[0] > 0
        assert principal[0] + principal[1] > principal[2]


def test_inertia_equals_what_mujoco_computes_from_the_same_primitives() -> None:
    for link in facts.load_facts("allegro", "right").links:
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(name="link")
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=link.box.half, pos=link.box.at, mass=link.mass)
        if link.tip is not None:
            ends = [0, 0, link.tip.start, 0, 0, link.tip.end]
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=[link.tip.radius, 0, 0], mass=link.tip.mass
            )
        model = spec.compile()
        ours = inertia.link_inertia(link)
        np.testing.assert_allclose(model.body("link").ipos, ours.center, atol=1e-12)
        np.testing.assert_allclose(np.sort(model.body("link").inertia), np.linalg.eigvalsh(ours.inertia), atol=1e-12)


def test_the_thumb_base_box_is_on_the_thumbs_side_of_each_hand() -> None:
    right = MODELS["right"][0].geom("link_12.0_box").pos[1]
    left = MODELS["left"][0].geom("link_12.0_box").pos[1]
    assert (right, left) == (0.009, -0.009)


def test_both_formats_carry_the_official_names(side: Side) -> None:
    model, _ = MODELS[side]
    urdf = pin.buildModelFromUrdf(str(data_root() / "models" / "urdf" / f"allegro_{side}.urdf"))
    for name in SPECS[side].joints:
        assert model.joint(name).id >= 0
        assert urdf.existJointName(name)
    for finger in SPECS[side].fingers:
        assert model.site(finger.tip).id >= 0
        assert urdf.existFrame(finger.tip)
        assert model.sensor(f"{finger.name}_touch").dim[0] == 4


def test_mujoco_reads_the_urdf_without_repairing_an_inertia(side: Side) -> None:
    model = mujoco.MjModel.from_xml_path(str(data_root() / "models" / "urdf" / f"allegro_{side}.urdf"))
    assert (model.nq, model.nv) == (16, 16)


def test_neighbouring_fingers_can_touch() -> None:
    model, data = MODELS["right"]
    position = np.clip(0.0, SPECS["right"].lower, SPECS["right"].upper)
    position[[1, 5]] = 1.0
    position[[0, 4]] = -0.47, 0.47
    data.qpos[:] = position
    mujoco.mj_forward(model, data)
    bodies = {model.body(model.geom_bodyid[g]).name for pair in data.contact.geom for g in pair}
    assert any(name.startswith(("link_3", "link_2")) for name in bodies)
    assert any(name.startswith(("link_6", "link_7")) for name in bodies)


def test_a_rounded_box_is_closed_and_has_the_volume_of_one() -> None:
    half, radius = (0.02, 0.015, 0.03), 0.005
    vertices, triangles = rounded_box(half, radius)
    edges = {tuple(sorted((t[i], t[(i + 1) % 3]))) for t in triangles for i in range(3) if len(set(t)) == 3}
    faces = [t for t in triangles if len(set(t)) == 3]
    assert len(vertices) - len(edges) + len(faces) == 2
    corners = vertices[np.array(faces)]
    volume = np.einsum("ki,ki->k", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    a, b, c = (2 * (h - radius) for h in half)
    exact = (
        a * b * c + 2 * radius * (a * b + b * c + c * a) + np.pi * radius**2 * (a + b + c) + 4 / 3 * np.pi * radius**3
    )
    assert volume == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize("corner", list(product((0, 1), repeat=3)))
def test_no_posture_that_the_motors_reach_is_stuck(corner: tuple[int, int, int], side: Side) -> None:
    """From wherever they get towards a corner of the range, the motors bring the hand home again."""
    spec = SPECS[side]
    home = load_posture("home", spec)
    towards = np.where(np.tile([0, *corner], 4), spec.upper, spec.lower)
    moves = Moves([Waypoint(towards, seconds=1.5), Waypoint(home, seconds=1.5)])
    backend = SimBackend(spec, compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0, 0, 0]))), posture=home)
    positions = [s.state.position for s in until(3.5, run(backend, PD(moves, load_gains("default", spec))))]
    assert np.abs(positions[500] - home).max() > 0.5
    np.testing.assert_allclose(positions[-1], home, atol=0.05)


@settings(max_examples=300, deadline=None)
@given(SEEDS, st.sampled_from(SIDES))
def test_inside_the_limits_only_the_ends_of_the_fingers_touch_the_palm(seed: int, side: Side) -> None:
    model, data = MODELS[side]
    data.qpos[:] = random_posture(seed, SPECS[side])
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    palm = model.body("palm_link").id
    for pair in model.geom_bodyid[data.contact.geom]:
        if palm in pair:
            other = model.body(int(pair.sum() - palm)).name
            assert other in {"link_2.0", "link_3.0", "link_6.0", "link_7.0", "link_10.0", "link_11.0", "link_15.0"}
