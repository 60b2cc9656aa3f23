"""The structure of a hand by what hangs on what: palm, wrist, fingers, couplings; what is no hand is refused."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.hand_import.explore import explore_hand
from allegro_twin.surfaces.cli.hardware.hand import card_differences
from allegro_twin.surfaces.hand import Hand
from tests.hands.models import GRIPPER
from tests.surfaces.cli.wrong import built


def finger(name: str, place: str, *joints: str) -> str:
    """A chain of capsules of 40 mm; each joint is `axis range`."""
    text, end = "", ""
    for k, joint in enumerate(joints):
        axis, span = joint.split("|")
        at = place if k == 0 else "0 0 0.04"
        text += (
            f'<body name="{name}_{k}" pos="{at}"><joint name="{name}_j{k}" axis="{axis}" range="{span}" damping="0.05" '
            'armature="1e-4"/><geom type="capsule" fromto="0 0 0 0 0 0.035" size="0.008" mass="0.02"/>'
        )
        end += "</body>"
    return text + end


BEND, SIDE = "0 1 0|-0.2 1.5", "1 0 0|-0.4 0.4"
INDEX = finger("index", "0 0.03 0.08", SIDE, BEND, BEND)
THUMB = finger("thumb", "0.05 -0.03 0.02", "0 0 1|0 1.2", BEND)


def mjcf(body: str, servos: str = "", more: str = "") -> str:
    return (f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{body}</worldbody>'
            f"<actuator>{servos}</actuator>{more}</mujoco>")  # fmt: skip


def servos(*joints: str, **attributes: str) -> str:
    words = " ".join(f'{key}="{value}"' for key, value in ({"kp": "2", "kv": "0.1"} | attributes).items())
    return "".join(f'<position name="m_{joint}" joint="{joint}" {words}/>' for joint in joints)


ALL = ("index_j0", "index_j1", "index_j2", "thumb_j0", "thumb_j1")
PALM = '<body name="palm"><geom type="box" size="0.02 0.04 0.04" pos="0 0 0.04" mass="0.3"/>'


def card(tmp_path: Path, text: str, **asked: Any) -> dict[str, Any]:
    path = tmp_path / ("hand.urdf" if text.startswith("<robot") else "hand.xml")
    path.write_text(text)
    return explore_hand(path, **asked).card


def test_a_joint_that_moves_the_tip_of_its_own_finger_by_nothing_is_still_its_fingers(tmp_path: Path) -> None:
    """Abduction turns about an axis through a stretched finger's tip."""
    about_itself = finger("index", "0 0.03 0.08", "0 0 1|-0.4 0.4", BEND, BEND)
    found = card(tmp_path, mjcf(f"{PALM}{about_itself}{THUMB}</body>", servos(*ALL, forcerange="-1 1")))
    assert {name: row["joints"] for name, row in found["fingers"].items()} == {
        "index": ["index_j0", "index_j1", "index_j2"], "thumb": ["thumb_j0", "thumb_j1"]
    }  # fmt: skip


def test_a_wrist_is_a_wrist_and_no_finger(tmp_path: Path) -> None:
    wrist = ('<body name="forearm"><geom size="0.03" mass="1"/><body name="hand" pos="0 0 0.1">'
             '<joint name="wrist" axis="1 0 0" range="-0.5 0.5" damping="1"/>')  # fmt: skip
    text = mjcf(f"{wrist}{PALM}{INDEX}{THUMB}</body></body></body>", servos("wrist", *ALL, forcerange="-1 1"))
    found = card(tmp_path, text)
    assert found["root"] == "forearm"
    assert found["wrist"] == {"joints": ["wrist"], "palm": "hand"}
    assert sorted(found["fingers"]) == ["index", "thumb"]
    assert "wrist" not in [name for row in found["fingers"].values() for name in row["joints"]]


WRISTED = ('<body name="forearm"><geom size="0.03" mass="1"/><body name="hand" pos="0 0 0.3">'
           '<joint name="wrist" axis="1 0 0" range="-0.5 0.5" damping="1"/>'
           f"{PALM}{INDEX}{THUMB}</body></body></body>")  # fmt: skip


def test_a_fingertip_goes_where_it_is_told_wherever_the_wrist_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("wristed.xml").write_text(mjcf(WRISTED, servos("wrist", *ALL, kp="20", forcerange="-9 9")))
    built()(["hand", "new", "wristed.xml", "--no-film"], standalone_mode=False)
    with Hand.open("mine/sim_wristed.yaml") as hand:
        hand.move_to([0.4, 0.1, 0.5, 0.4, 0.3, 0.3], speed=2.0)
        tip = hand.fingertips()["index"].position
        hand.move_fingertips({"index": tip})
        np.testing.assert_allclose(hand.fingertips()["index"].position, tip, atol=1e-3)
        beside = tip + np.array([0.0, 0.004, -0.004])
        hand.move_fingertips({"index": beside})
        np.testing.assert_allclose(hand.fingertips()["index"].position, beside, atol=2e-3)
    env = gym.make("allegro_twin.gym:AllegroTwin/Reach-v0", hand="mine/wristed.yaml")
    observed, _ = env.reset(seed=0)
    assert observed in env.observation_space
    env.close()


def test_a_recording_of_a_card_is_replayed_by_the_block_that_recorded_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gripper.xml").write_text(GRIPPER)
    built()(["hand", "new", "gripper.xml", "--no-film"], standalone_mode=False)
    built()(["run", "mine/sim_gripper.yaml", "--record", "it.arrow"], standalone_mode=False)
    replay: dict[str, Any] = {
        "hand": {"model": "mine/gripper.yaml", "side": "right"},
        "backend": {"kind": "replay", "file": "it.arrow"},
        "controller": {"kind": "position"},
    }
    write_settings(Path("replay.yaml"), replay, "the same hand")
    built()(["run", "replay.yaml"], standalone_mode=False)
    write_settings(Path("replay.yaml"), replay | {"hand": {"model": "leap"}}, "another")
    with pytest.raises(ConfigError, match=r"change `hand` to \{model: gripper, side: right\}"):
        built()(["run", "replay.yaml"], standalone_mode=False)


def test_fingers_on_the_world_have_the_world_for_their_palm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loose.xml").write_text(mjcf(INDEX + THUMB, servos(*ALL, forcerange="-1 1")))
    built()(["hand", "new", "loose.xml", "--no-film"], standalone_mode=False)
    assert "taken for the palm" in capsys.readouterr().out.replace("\n", " ")
    with Hand.open("mine/sim_loose.yaml") as hand:
        hand.move_to(np.full(5, 0.3), speed=2.0)
        np.testing.assert_allclose(hand.state.position, 0.3, atol=0.05)


def test_a_loop_is_one_finger(tmp_path: Path) -> None:
    four_bar = (
        '<body name="crank" pos="0 0.03 0.04"><joint name="crank" axis="1 0 0" range="0 0.8" damping="0.1"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.005" mass="0.02"/></body>'
        '<body name="rocker" pos="0 0.04 0.04"><joint name="rocker" axis="1 0 0" range="-1 1" damping="0.1"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.005" mass="0.02"/>'
        '<body name="pad" pos="0 0 0.03"><joint name="pad" axis="1 0 0" range="-1 1" damping="0.1"/>'
        '<geom type="capsule" fromto="0 -0.01 0 0 0 0" size="0.005" mass="0.02"/></body></body>'
    )
    loop = '<equality><connect body1="pad" body2="crank" anchor="0 -0.01 0"/></equality>'
    motors = servos("crank", "thumb_j0", "thumb_j1", forcerange="-1 1")
    found = card(tmp_path, mjcf(f"{PALM}{four_bar}{THUMB}</body>", motors, loop))
    assert len(found["fingers"]) == 2
    (linkage,) = (row for name, row in found["fingers"].items() if name != "thumb")
    assert linkage["joints"] == ["crank"]
    assert linkage["tip"][0] == "pad"


def test_an_arm_is_refused(tmp_path: Path) -> None:
    arm = finger("link", "0 0 0.1", *[SIDE, BEND] * 3)
    joints = [f"link_j{k}" for k in range(6)]
    with pytest.raises(ConfigError, match="6 joints in one chain and no fingers: an arm, not a hand"):
        card(tmp_path, mjcf(f'<body name="base"><geom size="0.1" mass="1"/>{arm}</body>', servos(*joints)))
    held = arm.replace("</body>" * 6, f"{PALM}{INDEX}{THUMB}</body>" + "</body>" * 6)
    text = mjcf(f'<body name="base"><geom size="0.1" mass="1"/>{held}</body>', servos(*joints, *ALL))
    with pytest.raises(ConfigError, match=r"6 joints before the palm \(link_5\): an arm with a hand"):
        card(tmp_path, text)


def test_a_range_is_the_joints_met_with_what_the_command_asks_for(tmp_path: Path) -> None:
    wide = servos(*ALL, forcerange="-1 1", ctrlrange="-0.4 1.0")
    rows = {row["name"]: row for row in card(tmp_path, mjcf(f"{PALM}{INDEX}{THUMB}</body>", wide))["driven"]}
    assert (rows["index_j0"]["lower"], rows["index_j0"]["upper"]) == (-0.4, 0.4)
    assert (rows["index_j1"]["lower"], rows["index_j1"]["upper"]) == (-0.2, 1.0)
    nowhere = servos(*ALL, ctrlrange="2 3")
    with pytest.raises(ConfigError, match="they have nothing in common"):
        card(tmp_path, mjcf(f"{PALM}{INDEX}{THUMB}</body>", nowhere))


def test_an_effort_is_the_smallest_that_the_file_says_and_never_invented(tmp_path: Path) -> None:
    body = f"{PALM}{INDEX}{THUMB}</body>"

    def efforts(text: str) -> set[Any]:
        return {row["effort"] for row in card(tmp_path, text)["driven"]}

    assert efforts(mjcf(body, servos(*ALL))) == {"unknown"}
    assert efforts(mjcf(body, servos(*ALL, ctrlrange="-0.4 1.0"))) == {"unknown"}
    assert efforts(mjcf(body, servos(*ALL, forcerange="-0.5 0.7"))) == {0.7}
    less = body.replace('damping="0.05"', 'damping="0.05" actuatorfrcrange="-0.3 0.3"')
    assert efforts(mjcf(less, servos(*ALL, forcerange="-0.5 0.7"))) == {0.3}
    motors = "".join(f'<motor name="m_{joint}" joint="{joint}" gear="2" ctrlrange="-0.1 0.1"/>' for joint in ALL)
    assert efforts(mjcf(body, motors)) == {0.2}


def test_a_hand_of_unknown_efforts_runs_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("strong.xml").write_text(mjcf(f"{PALM}{INDEX}{THUMB}</body>", servos(*ALL)))
    built()(["hand", "new", "strong.xml", "--no-film"], standalone_mode=False)
    assert "effort unknown of all motors" in capsys.readouterr().out.replace("\n", " ")
    assert "The effort of every motor" in Path("mine/strong.md").read_text()
    assert np.isinf(load_spec("mine/strong.yaml").actuation.torque_limit).all()
    built()(["hand", "show", "mine/strong.yaml"], standalone_mode=False)
    shown = capsys.readouterr().out
    assert shown.count("unknown") == 5
    assert " inf " not in shown
    with Hand.open("mine/sim_strong.yaml") as hand:
        hand.move_to([0.0, 0.4, 0.4, 0.3, 0.3], speed=2.0)
        np.testing.assert_allclose(hand.state.position, [0.0, 0.4, 0.4, 0.3, 0.3], atol=0.05)
        hand.set_controller("limp")
    built()(["run", "mine/sim_strong.yaml", "--record", "it.arrow"], standalone_mode=False)
    built()(["export", "it.arrow", "it.parquet"], standalone_mode=False)


def test_one_finger_can_be_said_and_the_others_stay_guesses(tmp_path: Path) -> None:
    text = mjcf(f"{PALM}{INDEX}{THUMB}</body>", servos(*ALL, forcerange="-1 1"))
    said = card(tmp_path, text, fingers={"pointer": "index_2"})["fingers"]
    assert {name: row["joints"][0] for name, row in said.items()} == {"pointer": "index_j0", "thumb": "thumb_j0"}
    notes = " ".join(explore_hand(tmp_path / "hand.xml", fingers={"pointer": "index_2", "pollex": "thumb_1"}).notes)
    assert "names are guesses" not in notes


@pytest.mark.parametrize(
    ("fingers", "message"),
    [
        ({"pointer": "index_3"}, "--finger pointer: no body named 'index_3'; did you mean 'index_2'"),
        ({"pointer": "palm"}, "palm is no part of one finger on the palm; their ends are index_2, thumb_1"),
        ({"a": "index_2", "b": "index_1"}, "--finger b=index_1 is the finger that is a already"),
    ],
)
def test_a_finger_that_is_none_is_refused(fingers: dict[str, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        card(tmp_path, mjcf(f"{PALM}{INDEX}{THUMB}</body>", servos(*ALL, forcerange="-1 1")), fingers=fingers)


def test_what_cannot_be_a_hand_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hand.xml").write_text(mjcf(WRISTED, servos("wrist", *ALL, forcerange="-1 1")))
    for words, message in (
        (["--finger", "thumb"], "--finger thumb: it is NAME=BODY"),
        (["--finger", "thumb=index_2", "--finger", "thumb=thumb_1"], "--finger thumb: twice"),
        (["--root", "hand"], "--root hand hangs on other bodies; take forearm, and say --palm hand"),
        (["--check", "hand.xml"], "hand.xml"),
    ):
        with pytest.raises(ConfigError, match=message) as raised:
            built()(["hand", "new", "hand.xml", *words], standalone_mode=False)
        assert "\n" not in str(raised.value)
    for name, message in (("nothing.xml", "nothing.xml: no such file"), (".", "a folder, not a model file")):
        with pytest.raises(ConfigError, match=message):
            built()(["hand", "new", name, "--name", "x"], standalone_mode=False)


def test_a_card_is_checked_against_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gripper.xml").write_text(GRIPPER)
    built()(["hand", "new", "gripper.xml", "--no-film"], standalone_mode=False)
    built()(["hand", "new", "gripper.xml", "--check", "mine/gripper.yaml"], standalone_mode=False)
    Path("gripper.xml").write_text(GRIPPER.replace("-20 20", "-15 15"))
    with pytest.raises(ConfigError, match="1 value differs from the file"):
        built()(["hand", "new", "gripper.xml", "--check", "mine/gripper.yaml"], standalone_mode=False)
    changed = explore_hand(Path("gripper.xml")).card
    assert card_differences(changed, changed) == []
    assert card_differences(changed | {"root": "x"}, changed) == ["root: x in the card, base in the file"]


def test_a_check_says_which_quantity_differs_and_both_values(tmp_path: Path) -> None:
    path = tmp_path / "gripper.xml"
    path.write_text(GRIPPER)
    found = explore_hand(path).card
    card = copy.deepcopy(found)
    card["driven"][0]["upper"] = 0.025
    card["fingers"]["left_finger"]["tip"] = ["base", [0.0, 0.0, 0.03]]
    card["followers"][0]["positions"][3] += 0.004
    card["palm"]["facing"] = [1.0, 0.0, 0.0]
    card["fingers"]["thumb"] = card["fingers"].pop("right_finger")
    facing = " ".join(f"{value:g}" for value in found["palm"]["facing"])
    position = found["followers"][0]["positions"][3]
    assert card_differences(card, found) == [
        f"palm, facing: 1 0 0 in the card, {facing} in the file",
        "driven left, upper: 0.025 in the card, 0.03 in the file",
        f"followers right, positions: {position + 0.004:g} in the card, {position:g} in the file, at place 4 of 11, "
        "where they differ most",
        "finger left_finger, tip: base 0 0 0.03 in the card, left_finger 0 0 0.055 in the file",
        "finger right_finger: not in the card, in the file",
        "finger thumb: in the card, not in the file",
    ]


LINK = """<link name="{name}"><inertial><origin xyz="0 0 0.02"/><mass value="0.05"/>
<inertia ixx="{ixx}" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.02"/><geometry><box size="0.015 0.015 0.03"/></geometry></collision></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>
<axis xyz="0 1 0"/><limit lower="0" upper="1.4" effort="{effort}" velocity="1"/>{more}</joint>"""
MIMIC = '<mimic joint="a" multiplier="{0}" offset="{1}"/>'


def urdf(effort: float = 0.8, ixx: float = 1e-5, multiplier: float = 0.5, offset: float = 0.1) -> str:
    links = "".join(LINK.format(name=name, ixx=ixx) for name in ("palm", "a1", "a2", "a3", "b1"))
    joints = [
        JOINT.format(name="a", parent="palm", child="a1", at="0 0.04 0.05", effort=effort, more=""),
        JOINT.format(name="a_mid", parent="a1", child="a2", at="0 0 0.05", effort=9,
                     more=MIMIC.format(multiplier, offset)),
        JOINT.format(name="a_end", parent="a2", child="a3", at="0 0 0.05", effort=9,
                     more='<mimic joint="a_mid" multiplier="2"/>'),
        JOINT.format(name="b", parent="palm", child="b1", at="0 -0.04 0.05", effort=effort, more=""),
    ]  # fmt: skip
    return f'<robot name="two">{links}{"".join(joints)}</robot>'


def test_a_urdf_is_a_hand_with_servos_and_a_joint_that_mimics_a_mimic_follows_the_first(tmp_path: Path) -> None:
    found = card(tmp_path, urdf())
    assert [row["name"] for row in found["driven"]] == ["a", "b"]
    assert {row["effort"] for row in found["driven"]} == {0.8}
    assert {row["stiffness"] for row in found["driven"]} == {8.0}
    followers = {row["name"]: row for row in found["followers"]}
    assert {row["follows"] for row in followers.values()} == {"a"}
    np.testing.assert_allclose(followers["a_mid"]["positions"], 0.1 + 0.5 * np.linspace(0, 1.2, 11), atol=2e-3)
    np.testing.assert_allclose(followers["a_end"]["positions"], 0.2 + 1.0 * np.linspace(0, 1.2, 11), atol=4e-3)
    assert len(found["fingers"]) == 2


@pytest.mark.parametrize("effort", [0.0, 1000.0])
def test_an_effort_of_a_urdf_that_is_none_is_unknown(effort: float, tmp_path: Path) -> None:
    assert {row["effort"] for row in card(tmp_path, urdf(effort=effort))["driven"]} == {"unknown"}


def test_an_inertia_that_no_body_has_is_repaired_and_said(tmp_path: Path) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text(urdf(ixx=5e-5))
    notes = " ".join(explore_hand(path).notes)
    assert "inertias that no rigid body has were repaired about the same axes: palm, a1, a2, a3, b1" in notes
    path.write_text(urdf())
    assert "repaired" not in " ".join(explore_hand(path).notes)


def test_a_urdf_runs_from_the_mjcf_that_is_written_beside_its_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("two.urdf").write_text(urdf(ixx=5e-5))
    built()(["hand", "new", "two.urdf", "--no-film"], standalone_mode=False)
    assert Path("mine/two.xml").is_file()
    with Hand.open("mine/sim_two.yaml") as hand:
        hand.move_to([0.8, 0.4], speed=1.0)
        np.testing.assert_allclose(hand.state.position, [0.8, 0.4], atol=0.06)
    write_settings(Path("mine/two.yaml"), {"mjcf": "../two.urdf", "root": "palm", "commands": ["position"], "driven": [
        {"name": "a", "actuator": "a", "lower": 0, "upper": 1, "effort": 1.0}]}, "two")  # fmt: skip
    with pytest.raises(ConfigError, match="a URDF: `allegro-twin hand new two.urdf` makes an MJCF of it"):
        Hand.open("mine/sim_two.yaml")


def test_a_mesh_that_touches_and_is_not_there_is_named(tmp_path: Path) -> None:
    text = urdf().replace('<box size="0.015 0.015 0.03"/>', '<mesh filename="package://two/meshes/a.stl"/>', 1)
    with pytest.raises(
        ConfigError,
        match="link palm: collision mesh package://two/meshes/a.stl: no folder two above the URDF or in ROS_PACKAGE",
    ):
        card(tmp_path, text)


@pytest.mark.slow
def test_meshes_of_a_urdf_are_found_wherever_its_card_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    corners = ["v 0 0 0", "v 0.03 0 0", "v 0 0.03 0", "v 0 0 0.06"]
    sides = ["f 1 3 2", "f 1 2 4", "f 2 3 4", "f 1 4 3"]
    there, here = tmp_path / "robots" / "two", tmp_path / "lab" / "bench"
    for folder in (there / "meshes", here):
        folder.mkdir(parents=True)
    (there / "meshes" / "a.obj").write_text("\n".join(corners + sides))
    text = urdf().replace('<box size="0.015 0.015 0.03"/>', '<mesh filename="package://two/meshes/a.obj"/>', 1)
    (there / "two.urdf").write_text(text)
    monkeypatch.chdir(here)
    built()(["hand", "new", "../../robots/two/two.urdf", "--out", "hands/mine", "--no-film"], standalone_mode=False)
    assert 'file="../../../../robots/two/meshes/a.obj"' in Path("hands/mine/two.xml").read_text()
    monkeypatch.chdir(tmp_path)
    assert load_spec("lab/bench/hands/mine/two.yaml").n_joints == 2


def radial(count: int) -> str:
    """Fingers around a palm, each closing toward its middle: two of them from one side, the others from the other."""
    fingers = []
    for k in range(count):
        turn, x = (0, 0.04) if k else (180, -0.04)
        fingers.append(f'''<body name="f{k}" pos="{x} {0.03 * k} 0.02" euler="0 0 {turn}">
          <joint name="j{k}" axis="0 -1 0" range="0 80"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.07" size="0.008" mass="0.05"/></body>''')
    motors = "".join(f'<position name="m{k}" joint="j{k}" kp="5" forcerange="-1 1"/>' for k in range(count))
    return f"""<mujoco><worldbody><body name="palm"><geom type="box" size="0.05 0.05 0.01"/>{"".join(fingers)}</body>
      </worldbody><actuator>{motors}</actuator></mujoco>"""


@pytest.mark.slow
def test_a_palm_whose_fingers_close_on_each_other_faces_along_them(tmp_path: Path) -> None:
    path = tmp_path / "three.xml"
    path.write_text(radial(3))
    assert explore_hand(path).card["palm"] == {"facing": [0.0, 0.0, 1.0], "fingers": [-1.0, 0.0, 0.0]}


@pytest.mark.parametrize(
    ("file", "side", "noted"),
    [("three_left", "right", "left"), ("three_left", "left", ""), ("right_hand", "left", "right")],
)
def test_a_file_whose_name_says_the_other_side_than_the_card_is_noted(
    tmp_path: Path, file: str, side: Any, noted: str
) -> None:
    path = tmp_path / f"{file}.xml"
    path.write_text(mjcf(f"{PALM}{INDEX}{THUMB}</body>", servos(*ALL)))
    notes = [note for note in explore_hand(path, side=side).notes if "--side" in note]
    assert notes == (
        [f"the file's name says {noted}, and the card is a {side} hand's: say `--side {noted}`"] * bool(noted)
    )
