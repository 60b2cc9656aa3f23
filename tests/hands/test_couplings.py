"""Joints that follow others by the equalities of a file: with torque motors as with servos, in chains, by curves, and
up to their own stops."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from allegro_twin import Hand
from allegro_twin.errors import ConfigError
from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.hands import load_spec
from allegro_twin.kinematics import hand_kinematics
from allegro_twin.sim.hand_import.explore import ExploredHand, explore_hand

LINK = """<body name="{name}_{k}" pos="{at}"><joint name="{name}{k}" axis="0 -1 0" range="{span}" damping="0.02"/>
  <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.006" mass="0.05"/>"""
MOTOR = '<motor name="m_{0}" joint="{0}" ctrlrange="-1 1"/>'
GENERAL = '<general name="m_{0}" joint="{0}" gainprm="0.5" ctrlrange="-2 2"/>'
SERVO = '<position name="m_{0}" joint="{0}" kp="5" kv="0.2" ctrlrange="0 1" forcerange="-1 1"/>'


def finger(name: str, x: float, span: str = "-2 2") -> str:
    """Three links, the first of 0 … 1 rad."""
    first, *others = (LINK.format(name=name, k=k, at=f"{x} 0 0.02" if k == 1 else "0 0 0.04",
                                  span="0 1" if k == 1 else span) for k in (1, 2, 3))  # fmt: skip
    return first + "".join(others) + "</body></body></body>"


def explored(folder: Path, more: str, motor: str = MOTOR, span: str = "-2 2") -> ExploredHand:
    """Two fingers whose first joints are driven."""
    path = folder / "two.xml"
    path.write_text(f"""<mujoco model="two"><compiler angle="radian"/><worldbody><body name="palm">
      <geom type="box" size="0.05 0.03 0.01" mass="0.5"/>{finger("a", -0.04, span)}{finger("b", 0.04)}</body>
      </worldbody>{more}<actuator>{motor.format("a1")}{motor.format("b1")}</actuator></mujoco>""")
    return explore_hand(path)


def followers(found: ExploredHand) -> dict[str, Any]:
    return {row["name"]: (row["follows"], row["positions"]) for row in found.card.get("followers", ())}


def coupled(*laws: tuple[str, str, str], more: str = "") -> str:
    rows = [f'<joint joint1="{a}" joint2="{b}" polycoef="{law}"/>' for a, b, law in laws]
    return f"<equality>{''.join(rows)}{more}</equality>"


DRIVEN = np.linspace(0.0, 1.0, 11)
FIXED = """<tendon><fixed name="t"><joint joint="a2" coef="1"/><joint joint="a1" coef="-0.5"/></fixed></tendon>
  <equality><tendon tendon1="t"/></equality>"""
LAWS = {
    "one": (coupled(("a2", "a1", "0.1 0.8 0 0 0")), {"a2": 0.1 + 0.8 * DRIVEN}),
    "several": (coupled(("a2", "a1", "0 1 0 0 0"), ("a3", "a1", "0 -1 0 0 0")), {"a2": DRIVEN, "a3": -DRIVEN}),
    "a chain": (coupled(("a3", "a2", "0.2 2 0 0 0"), ("a2", "a1", "0 0.5 0 0 0")),
                {"a2": DRIVEN / 2, "a3": 0.2 + DRIVEN}),
    "a curve": (coupled(("a2", "a1", "0.1 0.2 0.5 -0.1 0.3")),
                {"a2": 0.1 + 0.2 * DRIVEN + 0.5 * DRIVEN**2 - 0.1 * DRIVEN**3 + 0.3 * DRIVEN**4}),
    "the other way": (coupled(("a1", "a2", "0 2 0 0 0")), {"a2": DRIVEN / 2}),
    "a tendon": (FIXED, {"a2": DRIVEN / 2}),
}  # fmt: skip


@pytest.mark.parametrize("motor", [MOTOR, GENERAL, SERVO])
@pytest.mark.parametrize("law", LAWS)
def test_a_joint_that_an_equality_couples_follows_a_torque_motor_as_it_follows_a_servo(
    law: str, motor: str, tmp_path: Path
) -> None:
    more, wanted = LAWS[law]
    found = explored(tmp_path, more, motor)
    assert followers(found).keys() == wanted.keys()
    for name, (follows, positions) in followers(found).items():
        assert follows == "a1"
        np.testing.assert_allclose(positions, wanted[name], atol=3e-3)
    swinging = {f"{name}{k}" for name in "ab" for k in (2, 3)} - wanted.keys()
    assert {note.split(":")[0] for note in found.notes if "swings freely" in note} == swinging


def test_an_equality_that_is_switched_off_couples_nothing_and_one_that_fixes_a_joint_lets_nothing_swing(
    tmp_path: Path,
) -> None:
    off = coupled(("a2", "a1", "0 1 0 0 0")).replace("<joint ", '<joint active="false" ')
    found = explored(tmp_path, off)
    assert not followers(found)
    assert any(note.startswith("a2: nobody drives this joint") for note in found.notes)
    fixed = explored(tmp_path, '<equality><joint joint1="a2" polycoef="0 0 0 0 0"/></equality>')
    assert not any(note.startswith("a2:") for note in fixed.notes)


def test_a_joint_that_an_equality_fixes_elsewhere_than_it_is_drawn_is_told_with_how_far(tmp_path: Path) -> None:
    found = explored(tmp_path, '<equality><joint joint1="a2" polycoef="0.3 0 0 0 0"/></equality>')
    (note,) = (note for note in found.notes if note.startswith("a2:"))
    assert note.startswith("a2: an equality fixes it 0.3 rad from where the file draws it; kinematics has it as drawn")


def opened(tmp_path: Path, found: ExploredHand) -> Hand:
    write_settings(tmp_path / "two.yaml", found.card, "two")
    run = {"hand": {"model": "two.yaml"}, "backend": {"kind": "sim"}, "controller": {"kind": "pd"}}
    write_settings(tmp_path / "sim_two.yaml", run, "two in simulation")
    return Hand.open(str(tmp_path / "sim_two.yaml"))


def test_a_torque_hand_with_a_coupled_joint_has_its_fingertip_and_carries_the_coupled_links(tmp_path: Path) -> None:
    held = "".join(f'<joint joint1="{name}" polycoef="0 0 0 0 0"/>' for name in ("a3", "b2", "b3"))
    found = explored(tmp_path, coupled(("a2", "a1", "0.1 0.8 0 0 0"), more=held))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "two.xml"))
    data = mujoco.MjData(model)
    data.qpos[[model.joint("a1").qposadr[0], model.joint("a2").qposadr[0]]] = 0.6, 0.1 + 0.8 * 0.6
    mujoco.mj_kinematics(model, data)
    tip = data.body("a_3").xpos + data.body("a_3").xmat.reshape(3, 3) @ [0.0, 0.0, 0.03]
    with opened(tmp_path, found) as hand:
        hand.move_to([0.6, 0.0], speed=2.0)
        hand.wait(0.5)
        assert hand.state.position[0] == pytest.approx(0.6, abs=5e-3)
        axes = found.card["palm"]
        facing, along = np.array(axes["facing"]), np.array(axes["fingers"])
        turn = np.stack([facing, np.cross(along, facing), along])
        position = hand.fingertips()["a"].position
        assert np.asarray(position) == pytest.approx(turn @ tip, abs=2e-3)
        hand.set_controller("gravity")
        hand.wait(0.03)
        position, torque = hand.state.position[0], hand.state.torque[0]
        model.opt.gravity[:] = turn.T @ hand.gravity
    data.qpos[[model.joint("a1").qposadr[0], model.joint("a2").qposadr[0]]] = position, 0.1 + 0.8 * position
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)
    bias = [float(data.qfrc_bias[model.joint(name).dofadr[0]]) for name in ("a1", "a2")]
    assert torque == pytest.approx(bias[0] + 0.8 * bias[1], rel=0.05)
    assert abs(0.8 * bias[1]) > 0.1 * abs(torque)
    spec = load_spec(str(tmp_path / "two.yaml"))
    solver = hand_kinematics(spec).finger("a")
    there = solver.fk([0.6]).position
    assert np.asarray(there) == pytest.approx(turn @ tip, abs=1e-4)


def test_chosen_gains_carry_the_joints_that_follow(tmp_path: Path) -> None:
    alone = explored(tmp_path, "").card["gains"]["default"]
    found = explored(tmp_path, coupled(("a2", "a1", "0 1 0 0 0"), ("a3", "b1", "0 0 0 0 0"))).card["gains"]["default"]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "two.xml"))
    data, inertia = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    both = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    assert found["kp"][0] / alone["kp"][0] == pytest.approx(both @ inertia @ both / inertia[0, 0], rel=1e-3)
    assert found["kp"][1] == alone["kp"][1]


@pytest.mark.parametrize("motor", [MOTOR, SERVO])
def test_a_driven_joint_goes_as_far_as_the_stop_of_what_follows_it(motor: str, tmp_path: Path) -> None:
    laws = coupled(("a2", "a1", "0.1 -0.5 0 0 0"), ("a3", "a2", "0 1 0 0 0"))
    found = explored(tmp_path, laws, motor, span="0 1.2")
    row = found.card["driven"][0]
    assert (row["lower"], row["upper"]) == (0.0, pytest.approx(0.2))
    np.testing.assert_allclose(followers(found)["a3"][1], 0.1 - 0.5 * np.linspace(0.0, 0.2, 11), atol=1e-3)
    note = "the range of a1 is shortened from 0 … 1 to 0 … 0.2: a2 follows it, and has the range 0 … 1.2"
    assert note in found.notes
    whole = explored(tmp_path, coupled(("a2", "a1", "0 1.001 0 0 0")), motor, span="0 1")
    assert whole.card["driven"][0]["upper"] == 1.0  # By 1 mrad: a rounding.
    with pytest.raises(
        ConfigError, match=r"joint a2 follows a1 and is outside its own range 0 … 1.2 wherever a1 is in"
    ):
        explored(tmp_path, coupled(("a2", "a1", "-2 1 0 0 0")), motor, span="0 1.2")


URDF_LINK = """<link name="{0}"><inertial><mass value="0.04"/><origin xyz="0 0 0.02"/>
  <inertia ixx="1e-5" iyy="1e-5" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial><collision><origin xyz="0 0 0.02"/>
  <geometry><box size="0.014 0.016 0.04"/></geometry></collision></link>"""
URDF_JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/>
  <axis xyz="0 -1 0"/><limit lower="0" upper="1.2" effort="1" velocity="3"/>{4}</joint>"""


def test_a_mimic_joint_of_a_urdf_keeps_its_range_and_shortens_that_of_the_joint_that_it_follows(tmp_path: Path) -> None:
    links = "".join(URDF_LINK.format(name) for name in ("palm", "a_1", "a_2", "b_1"))
    joints = [("a1", "palm", "a_1", "0.05 0 0.03", ""), ("b1", "palm", "b_1", "-0.05 0 0.03", ""),
              ("a2", "a_1", "a_2", "0 0 0.05", '<mimic joint="a1" multiplier="-0.5" offset="0.1"/>')]  # fmt: skip
    path = tmp_path / "two.urdf"
    text = f'<robot name="two">{links}{"".join(URDF_JOINT.format(*row) for row in joints)}</robot>'
    path.write_text(text)
    found = explore_hand(path)
    assert {row["name"]: row["upper"] for row in found.card["driven"]} == {"a1": pytest.approx(0.2), "b1": 1.2}
    assert any("the range of a1 is shortened" in note for note in found.notes)
    assert list(found.spec.joint("a2").range) == [0.0, 1.2]
    path.write_text(text.replace('offset="0.1"', 'offset="-0.1"'))
    with pytest.raises(ConfigError, match="joint a2 follows a1 and is outside its own range"):
        explore_hand(path)


def both(second: float) -> str:
    """b2 follows b1 by half its way, and a1 by a share of its."""
    return f"""<tendon><fixed name="t"><joint joint="b2" coef="1"/><joint joint="b1" coef="-0.5"/>
      <joint joint="a1" coef="{-second}"/></fixed></tendon><equality><tendon tendon1="t"/></equality>"""


@pytest.mark.parametrize("motor", [MOTOR, SERVO])
def test_a_joint_that_follows_two_motors_is_refused_with_both_and_a_trace_of_a_second_is_said(
    motor: str, tmp_path: Path
) -> None:
    words = r"joint b2 follows two motors, b1 \(by 0.5 rad\) and a1 \(by 0.4 rad\), .*: couple it to one of them"
    with pytest.raises(ConfigError, match=words):
        explored(tmp_path, both(0.4), motor)
    found = explored(tmp_path, both(0.0102), motor)
    assert followers(found)["b2"][0] == "b1"
    words = r"b2 follows b1 \(by 0.5 rad\); that it also moves with a1 \(by 0.010\d* rad\) is left out"
    assert any(re.fullmatch(words, note) for note in found.notes)
    assert not any("left out" in note for note in explored(tmp_path, both(0.0), motor).notes)


@pytest.mark.parametrize(
    ("mass", "kv", "words"),
    [
        ("0.05", "0.4", r"[ab][23] does not come to rest with [ab]1 at 0.1: after 20 s it still moves .* by 0.\d+ rad"),
        ("0.003", "0", "its simulation diverges with [ab]1 at 0.1"),
    ],
)
def test_a_follower_that_does_not_come_to_rest_is_refused_with_how_far_it_still_moves(
    mass: str, kv: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # For MUJOCO_LOG.TXT.
    link = LINK.replace('mass="0.05"', f'mass="{mass}"').replace('damping="0.02"', "")
    monkeypatch.setattr("tests.hands.test_couplings.LINK", link)
    laws = coupled(("a2", "a1", "0 0.6 0 0 0"), ("a3", "a2", "0 0.9 0 0 0"))
    with pytest.raises(ConfigError, match=f"{words}, so nobody can say where .* are: give it more damping or armature"):
        explored(tmp_path, laws, SERVO.replace('kp="5" kv="0.2"', f'kp="20" kv="{kv}"'))
