"""The URDF of a tendon hand is the tree of its MJCF, whatever pulls its joints."""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.generate.tendon_mjcf import tables
from allegro_twin.kinematics.hand import HandKinematics, hand_kinematics

HANDS = [path.stem for path in tables()]


def urdf_of(name: str) -> str:
    return str(data_root() / "models" / "urdf" / f"{name}_right.urdf")


@pytest.mark.parametrize("name", HANDS)
def test_every_link_is_where_the_mjcf_has_it_at_any_position_of_every_hinge(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(data_root() / "models" / "mjcf" / f"{name}_right.xml"))
    data, tree = mujoco.MjData(model), pin.buildModelFromUrdf(urdf_of(name))
    found, random = tree.createData(), np.random.default_rng(0)
    assert tree.nq == model.nq
    for _ in range(20):
        data.qpos[:] = random.uniform(*model.jnt_range.T)
        q = np.zeros(tree.nq)
        for number in range(model.njnt):
            q[tree.idx_qs[tree.getJointId(model.joint(number).name)]] = data.qpos[number]
        mujoco.mj_kinematics(model, data)
        pin.framesForwardKinematics(tree, found, q)
        for body in range(2, model.nbody):
            frame = found.oMf[tree.getFrameId(f"{model.body(body).name}_link")]
            np.testing.assert_allclose(frame.translation, data.xpos[body], atol=1e-9)
            np.testing.assert_allclose(frame.rotation, data.xmat[body].reshape(3, 3), atol=1e-9)


@pytest.mark.parametrize("name", HANDS)
def test_fingertips_jacobians_and_weight_are_those_of_the_mjcf(name: str) -> None:
    spec, random = load_spec(name), np.random.default_rng(1)
    ours, theirs = hand_kinematics(spec), HandKinematics(spec, data_root() / "models" / "urdf" / f"{name}_right.urdf")
    for _ in range(5):
        position, gravity = random.uniform(spec.lower, spec.upper), random.normal(size=3)
        for finger in spec.fingers:
            one, other = (each.fingertips(position)[finger.name] for each in (ours, theirs))
            np.testing.assert_allclose(one.position, other.position, atol=1e-9)
            first, second = (each.jacobian(position)[finger.name] for each in (ours, theirs))
            np.testing.assert_allclose(first, second, atol=1e-9)
        weight = [each.gravity_torque(position, gravity) for each in (ours, theirs)]
        np.testing.assert_allclose(weight[0], weight[1], atol=1e-7)


@pytest.mark.parametrize("name", HANDS)
def test_what_follows_is_marked_with_its_motor_and_nothing_is_tied(name: str) -> None:
    spec, root = load_spec(name), ElementTree.parse(urdf_of(name)).getroot()
    joints = {each.attrib["name"]: each for each in root.findall("joint[@type='revolute']")}
    marked = {name: each.find("follows") for name, each in joints.items()}
    motors = {name: mark.attrib["motor"] for name, mark in marked.items() if mark is not None}
    assert {each.name: spec.joints[each.driven] for each in spec.followers}.items() <= motors.items()
    assert set(joints) - set(motors) == set(spec.joints) & set(joints)
    assert not root.findall("joint/mimic")
    for name, each in joints.items():
        limit = each.find("limit")
        assert limit is not None
        assert (float(limit.attrib["effort"]) == 0.0) == (name in motors)


@pytest.mark.parametrize("name", HANDS)
def test_mujoco_reads_a_tendon_hands_urdf_without_repairing_an_inertia(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(urdf_of(name))
    whole = mujoco.MjModel.from_xml_path(str(data_root() / "models" / "mjcf" / f"{name}_right.xml"))
    assert model.njnt == whole.njnt
