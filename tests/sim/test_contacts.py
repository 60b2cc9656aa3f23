"""What the contacts of a scene say of a grasp: where, which way, how hard, by whom, how they move."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.carrying import least_effort
from allegro_twin.grasping.metrics.trial_metrics import contact_metrics, contacts_in_scene
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.contact.contacts import SceneContacts, contact_jacobians, find_contacts
from allegro_twin.sim.contact.probe import contact_free_postures
from allegro_twin.sim.model.parts import part_names
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject
from allegro_twin.spec import HandSpec, Side
from tests.sim.test_foreign import menagerie_like

MASS = 0.1


def on_the_palm(spec: HandSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A cube that has come to rest on a palm that looks at the sky."""
    up = np.array([0.5**0.5, 0.0, -(0.5**0.5), 0.0])  # The palm's x axis points up.
    cube = GraspObject("cube", "box", (0.03, 0.03, 0.03), MASS)
    beside = -0.03 if spec.side == "right" else 0.03  # Away from the thumb.
    things = [PlacedObject(cube, (0.05, beside, 0.0265), (1.0, 0.0, 0.0, 0.0))]
    model = compile_scene(spec, Stage(np.zeros(3), up, things))
    data = mujoco.MjData(model)
    for _ in range(500):
        mujoco.mj_step(model, data)
    return model, data


def seen(spec: HandSpec) -> tuple[mujoco.MjModel, mujoco.MjData, SceneContacts]:
    model, data = on_the_palm(spec)
    return model, data, find_contacts(model, data, spec, "cube")


def test_the_forces_of_the_contacts_carry_the_weight(side: Side) -> None:
    spec = load_spec(side=side)
    _, _, touch = seen(spec)
    np.testing.assert_allclose(touch.force.sum(axis=0), [0, 0, MASS * 9.81], atol=5e-3)
    assert {part_names(spec)[part] for part in touch.part} == {"palm"}
    np.testing.assert_allclose(touch.normals, [[0, 0, 1]] * len(touch.points), atol=1e-2)
    np.testing.assert_allclose(np.einsum("ki,ki->k", touch.normals, touch.tangents), 0.0, atol=1e-12)
    assert ((touch.depth > 0) & (touch.depth < 1e-3)).all()
    np.testing.assert_array_equal(touch.friction, 0.8)
    np.testing.assert_array_equal(touch.torsion, 0.01)


def test_postures_in_which_something_always_touches_are_refused_with_the_two_bodies(spec: HandSpec) -> None:
    up = np.array([0.5**0.5, 0.0, -(0.5**0.5), 0.0])
    inside = PlacedObject(GraspObject("cube", "box", (0.03, 0.03, 0.03), MASS), (0.03, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    model = compile_scene(spec, Stage(np.zeros(3), up, [inside]))
    with pytest.raises(ConfigError, match="something touches in each of 2 postures, such as palm_link and cube: where"):
        contact_free_postures(model, spec, np.array([spec.rest, spec.rest]), 1)
    bare = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    np.testing.assert_array_equal(contact_free_postures(bare, spec, spec.rest[None], 1), spec.rest[None])
    with pytest.raises(ConfigError, match=f"{spec.name}: no postures to look for one .* give one or more"):
        contact_free_postures(bare, spec, np.empty((0, spec.n_joints)), 1)


def test_the_length_is_from_the_centre_to_the_farthest_corner(spec: HandSpec) -> None:
    _, data, touch = seen(spec)
    assert touch.length == pytest.approx(0.015 * 3**0.5)
    np.testing.assert_allclose(touch.centre, data.body("cube").xpos)


def test_tips_that_are_bodies_of_their_own_belong_to_their_finger(tmp_path: Path) -> None:
    spec = load_spec(serial=str(menagerie_like(tmp_path, "right")))
    model, data = on_the_palm(spec)
    data.qpos[model.joint("cube").qposadr[0] :][:3] = data.body("mf_tip").xpos + np.array([0, 0, 0.024])
    mujoco.mj_forward(model, data)
    assert {part_names(spec)[part] for part in find_contacts(model, data, spec, "cube").part} == {"middle"}


def test_jacobians_are_how_the_contact_points_of_the_hand_move(spec: HandSpec) -> None:
    model, data = on_the_palm(spec)
    tip = data.site(spec.fingers[1].tip).xpos
    data.qpos[model.joint("cube").qposadr[0] :][:3] = tip + np.array([0, 0, 0.026])
    mujoco.mj_forward(model, data)
    touch = find_contacts(model, data, spec, "cube")
    found = contact_jacobians(model, data, spec, touch)
    assert found.shape == (len(touch.points), 6, 16)
    place, step = int(model.joint(spec.joints[5]).qposadr[0]), 1e-6
    body = int(touch.bodies[0])
    local = data.xmat[body].reshape(3, 3).T @ (touch.points[0] - data.xpos[body])
    data.qpos[place] += step
    mujoco.mj_kinematics(model, data)
    moved = data.xpos[body] + data.xmat[body].reshape(3, 3) @ local
    np.testing.assert_allclose((moved - touch.points[0]) / step, found[0, :3, 5], atol=1e-5)
    assert not found[:, :, :4].any()


def test_contacts_that_are_only_near_are_seen_when_asked_for(spec: HandSpec) -> None:
    model, data = on_the_palm(spec)
    data.qpos[model.joint("cube").qposadr[0] + 2] += 0.002
    model.geom_gap[:] = 0.01
    mujoco.mj_forward(model, data)
    assert not len(find_contacts(model, data, spec, "cube").points)
    near = find_contacts(model, data, spec, "cube", near=0.005)
    assert len(near.points)
    assert (near.depth < 0).all()
    assert not near.force.any()


def test_the_row_of_a_report_has_every_figure(spec: HandSpec) -> None:
    """A cube that lies on a palm is carried and not held: no ball of wrenches, its weight without any torque."""
    model, data, touch = seen(spec)
    row = contact_metrics(touch, MASS, contact_jacobians(model, data, spec, touch), spec.actuation.torque_limit)
    assert row["contacts"] == len(touch.points)
    assert row["fingers"] == 1
    assert row["epsilon"] == 0.0
    assert row["lp"] <= 0.0
    assert row["qp"] > 0.5
    assert row["carry"] == pytest.approx(MASS * 9.81, rel=1e-3)
    assert row["torque_share"] == pytest.approx(0.0, abs=1e-9)
    assert (
        least_effort(contacts_in_scene(touch), np.zeros((len(touch.points), 6, 16)), np.ones(16), np.zeros(6)).share
        == 0.0
    )


def test_where_an_effort_is_unknown_no_share_of_it_is_in_the_row(spec: HandSpec) -> None:
    model, data, touch = seen(spec)
    limit = np.append(spec.actuation.torque_limit[:-1], np.inf)
    row = contact_metrics(touch, MASS, contact_jacobians(model, data, spec, touch), limit)
    assert np.isnan(row["torque_share"])


def test_an_object_that_nothing_touches_has_a_row_too(spec: HandSpec) -> None:
    model, data = on_the_palm(spec)
    data.qpos[model.joint("cube").qposadr[0] + 2] += 0.5
    mujoco.mj_forward(model, data)
    touch = find_contacts(model, data, spec, "cube")
    row = contact_metrics(touch, MASS, contact_jacobians(model, data, spec, touch), spec.actuation.torque_limit)
    assert (row["contacts"], row["epsilon"], row["carry"]) == (0, 0.0, np.inf)
    assert row["penetration_mm"] == 0.0
