"""Hands as strangers write them: torque motors, gears, files in the wrong unit, and what `hand new` says of each."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from allegro_twin import Hand, load_config
from allegro_twin.errors import ConfigError
from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.hands import load_gains, load_spec
from allegro_twin.recording.reader import load
from allegro_twin.sim.hand_import.explore import explore_hand
from allegro_twin.sim.model.scene import hand_spec
from tests.surfaces.cli.wrong import built

FINGER = """<body name="{name}_base" pos="{x} 0 0.03">
  <joint name="{name}_1" axis="0 -1 0" range="-0.3 1.4" damping="0.02" armature="0.0005"/>
  <geom type="capsule" fromto="0 0 0 0 0 0.05" size="0.008" mass="0.04"/>
  <body name="{name}_tip" pos="0 0 0.05">
    <joint name="{name}_2" axis="0 -1 0" range="0 1.5" damping="0.02" armature="0.0005"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.007" mass="0.02"/>
  </body></body>"""
HAND = f"""<mujoco model="two"><compiler angle="radian"/><worldbody><body name="palm">
  <geom type="box" size="0.05 0.03 0.02" mass="0.5"/>{FINGER.format(name="f1", x=0.04)}
  {FINGER.format(name="f2", x=-0.04)}</body></worldbody><actuator>MOTORS</actuator></mujoco>"""
MOTOR = '<motor name="a_{0}" joint="{0}" ctrlrange="-1 1"/>'
GEARED_MOTOR = '<motor name="a_{0}" joint="{0}" gear="-50" ctrlrange="-0.02 0.02"/>'
GEARED_SERVO = '<position name="a_{0}" joint="{0}" gear="2" kp="3" kv="0.1" ctrlrange="-0.6 3" forcerange="-1 1"/>'
SERVO = '<position name="a_{0}" joint="{0}" kp="3" kv="0.1" ctrlrange="-0.3 1.5" forcerange="-1 1"/>'
JOINTS = ("f1_1", "f1_2", "f2_1", "f2_2")
LINK = """<link name="{0}">{1}<collision><origin xyz="0 0 0.025"/><geometry><cylinder radius="0.008" length="0.05"/>
  </geometry></collision></link>"""
INERTIAL = """<inertial><mass value="0.04"/><origin xyz="0 0 0.02"/>
  <inertia ixx="1e-5" iyy="1e-5" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial>"""
TURN = """<joint name="{0}_joint" type="revolute"><parent link="palm"/><child link="{0}"/><origin xyz="{1} 0 0.03"/>
  <axis xyz="0 -1 0"/><limit lower="-0.3" upper="1.4" effort="1" velocity="5"/></joint>"""
URDF = f"""<robot name="two">{LINK.format("palm", INERTIAL)}{LINK.format("one", INERTIAL)}{LINK.format("two", INERTIAL)}
  {TURN.format("one", 0.04)}{TURN.format("two", -0.04)}</robot>"""


def mjcf(folder: Path, motor: str, name: str = "two") -> Path:
    path = folder / f"{name}.xml"
    path.write_text(HAND.replace("MOTORS", "".join(motor.format(joint) for joint in JOINTS)))
    return path


def urdf(folder: Path, *changes: tuple[str, str]) -> Path:
    text = URDF
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "two.urdf"
    path.write_text(text)
    return path


def command(*words: str) -> None:
    built()(list(words), standalone_mode=False)


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("allegro_twin.surfaces.cli.hardware.hand._picture", lambda *_args, **_more: False)


@pytest.mark.parametrize("motor", [MOTOR, GEARED_MOTOR, '<motor name="a_{0}" joint="{0}"/>'])
def test_a_hand_with_torque_motors_holds_a_posture_under_the_gains_of_its_card(motor: str, tmp_path: Path) -> None:
    command("hand", "new", str(mjcf(tmp_path, motor)), "--no-film")
    with Hand.open("mine/sim_two.yaml") as hand:
        hand.move_to([0.3, 0.4, 0.3, 0.4], speed=2.0)
        hand.wait(0.8)
        assert hand.state.position == pytest.approx([0.3, 0.4, 0.3, 0.4], abs=2e-3)
        assert np.abs(hand.state.velocity).max() < 1e-3


def test_the_chosen_gains_are_critically_damped_and_give_full_effort_at_a_tenth_of_a_radian_or_later(
    tmp_path: Path,
) -> None:
    model = mujoco.MjModel.from_xml_path(str(mjcf(tmp_path, MOTOR)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.empty((4, 4))
    mujoco.mj_fullM(model, data, inertia)
    gains = explore_hand(Path("two.xml")).card["gains"]["default"]
    assert gains["kp"] == pytest.approx(30.0**2 * np.diag(inertia), rel=1e-3)
    assert np.array(gains["kd"]) + 0.02 == pytest.approx(2 * 30.0 * np.diag(inertia), rel=1e-3)
    weak = explore_hand(mjcf(tmp_path, MOTOR.replace("-1 1", "-0.02 0.02"))).card["gains"]["default"]
    assert weak["kp"] == pytest.approx([0.2] * 4)


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        (
            '<motor name="a_{0}" joint="{0}" ctrlrange="-1 1"/>',
            "a_f1_1 takes a position and a_f2_2 takes a torque; a hand",
        ),
        (
            '<position name="a_{0}" joint="{0}" kp="-6" ctrlrange="-0.3 1.5"/>',
            "a_f2_2 is no position servo: with kp -6",
        ),
        ('<velocity name="a_{0}" joint="{0}" kv="1" ctrlrange="-1 1"/>', "a_f2_2 is no position servo: with kp 0 "),
    ],
)
def test_an_actuator_that_is_not_like_the_others_is_named(odd: str, said: str, tmp_path: Path) -> None:
    path = mjcf(tmp_path, SERVO)
    path.write_text(path.read_text().replace(SERVO.format("f2_2"), odd.format("f2_2")))
    with pytest.raises(ConfigError, match=said):
        explore_hand(path)


@pytest.mark.parametrize("name", ["allegro", "model_o"])
def test_a_hand_cannot_have_the_name_of_one_that_ships_whose_entries_would_be_taken_for_its_own(
    name: str, tmp_path: Path
) -> None:
    file = str(mjcf(tmp_path, MOTOR))
    with pytest.raises(ConfigError, match=f"{name} is a hand that ships, .* say --name my_{name}"):
        command("hand", "new", file, "--no-film", "--name", name)
    command("hand", "new", file, "--no-film", "--name", f"my_{name}")
    assert max(load_gains("default", load_spec(f"mine/my_{name}.yaml")).kp) < 2.0
    Path(f"mine/my_{name}.yaml").rename(f"mine/{name}.yaml")
    with pytest.raises(ConfigError, match=f"mine/{name}.yaml: {name} is a hand that ships"):
        load_spec(f"mine/{name}.yaml")


def test_a_card_of_torque_motors_without_gains_says_where_they_go(tmp_path: Path) -> None:
    card = explore_hand(mjcf(tmp_path, MOTOR)).card
    del card["gains"]
    write_settings(Path("two.yaml"), card, "two")
    with pytest.raises(ConfigError, match=r"two.yaml: gains: none, .*write `gains: {default: {kp: \[...\]"):
        load_gains("default", load_spec("two.yaml"))
    write_settings(Path("two.yaml"), card | {"gains": {"default": {"kp": [1], "kd": [1], "ki": [1], "clamp": [1]}}}, "")
    with pytest.raises(ConfigError, match=r"gains: default.kp has 1 values; 4 are driven"):
        load_spec("two.yaml")


@pytest.mark.parametrize("motor", [GEARED_SERVO, GEARED_MOTOR])
def test_a_gear_gives_the_torque_of_the_file_and_a_command_in_units_of_the_joint(motor: str, tmp_path: Path) -> None:
    path = mjcf(tmp_path, motor)
    write_settings(Path("two.yaml"), explore_hand(path).card, "two")
    theirs, ours = mujoco.MjModel.from_xml_path(str(path)), hand_spec(load_spec("two.yaml")).compile()
    torques = []
    for model, factor in ((theirs, 1.0), (ours, -50.0 if motor == GEARED_MOTOR else 1.0)):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = 0.2, 0.1, np.array([0.001, 0.002, -0.001, 0.003]) * factor
        mujoco.mj_forward(model, data)
        torques.append(data.qfrc_actuator.copy())
    assert torques[0] == pytest.approx(torques[1])


def test_the_stiffness_of_a_geared_servo_is_what_its_joint_feels_and_the_check_measures_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = mjcf(tmp_path, GEARED_SERVO)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.05
    mujoco.mj_forward(model, data)
    measured = -data.qfrc_actuator / 0.05
    card = explore_hand(path).card
    assert [row["stiffness"] for row in card["driven"]] == pytest.approx(measured)
    assert measured == pytest.approx(12.0)
    assert card["driven"][0]["effort"] == 2.0  # N·m at the joint, of 1 N·m before the gear.
    card["driven"][0]["stiffness"] = 3.0
    write_settings(Path("two.yaml"), card, "two")
    with pytest.raises(ConfigError, match="1 value differs"):
        command("hand", "new", str(path), "--check", "two.yaml")
    assert "driven f1_1, stiffness: 3 in the card, 12 in the file" in capsys.readouterr().out


def dynamics(damping: str, friction: str) -> tuple[str, str]:
    return "</joint>", f'<dynamics damping="{damping}" friction="{friction}"/></joint>'


def mimic(law: str) -> tuple[str, str]:
    """The first joint mimics the second."""
    return "<limit", f'<mimic joint="two_joint" {law}/><limit'


WRONG = {
    r"joint one_joint: lower 1.4 is above upper -0.3": (('lower="-0.3" upper="1.4"', 'lower="1.4" upper="-0.3"'),),
    r"joint one_joint: lower and upper are both 0: give its range, or make it fixed": (
        ('lower="-0.3" upper="1.4"', 'lower="0" upper="0"'),
    ),
    r"joint one_joint: limit: upper is inf: it must be a finite number": (('upper="1.4"', 'upper="inf"'),),
    r"joint one_joint: limit: upper is 1,4: it must be a finite number": (('upper="1.4"', 'upper="1,4"'),),
    r"joint one_joint: its range -20 … 80 goes beyond a whole turn: .* look like degrees": (
        ('lower="-0.3" upper="1.4"', 'lower="-20" upper="80"'),
    ),
    r"link palm: mass: value is nan: it must be a finite number": (('mass value="0.04"', 'mass value="nan"'),),
    r"link palm: its mass is -1 kg, below zero": (('mass value="0.04"', 'mass value="-1"'),),
    r"link palm: its inertia ixx is -1e-05 kg·m², below zero": (('ixx="1e-5"', 'ixx="-1e-5"'),),
    r"two links are called one: give each a name of its own": (('link name="two"', 'link name="one"'),),
    r"joint one_joint: limit: effort is strong: it must be a finite number": (('effort="1"', 'effort="strong"'),),
    r"joint one_joint: limit: effort is nan: it must be a finite number": (('effort="1"', 'effort="nan"'),),
    r"joint one_joint: origin: xyz is nan 0 0.03: it must be 3 finite numbers": (
        ('origin xyz="0.04 0 0.03"', 'origin xyz="nan 0 0.03"'),
    ),
    r"joint one_joint: axis: xyz is 0 -1: it must be 3 finite numbers": (('axis xyz="0 -1 0"', 'axis xyz="0 -1"'),),
    r"joint one_joint: dynamics: damping is nan: it must be a finite number": (dynamics("nan", "0"),),
    r"joint one_joint: dynamics: damping is -0.05, below zero: it would push": (dynamics("-0.05", "0"),),
    r"joint one_joint: dynamics: friction is -0.02, below zero: it would push": (dynamics("0", "-0.02"),),
    r"joint one_joint: mimic: offset is half: it must be a finite number": (mimic('offset="half"'),),
    r"joint one_joint mimics two_joint with the multiplier 0: it stands at its offset 0.5, so make it fixed": (
        mimic('multiplier="0" offset="0.5"'),
    ),
    r"link palm: cylinder: radius is thin: it must be a finite number": (('radius="0.008"', 'radius="thin"'),),
    r"joint one_joint: lower 0.2 is above upper 0, the one that is left out \(upper\) being 0": (
        ('lower="-0.3" upper="1.4"', 'lower="0.2"'),
    ),
    r"joint one_joint is planar: it moves in several directions at once, .* make it fixed": (
        ('type="revolute"', 'type="planar"'),
    ),
    r"joint one_joint is floating: it moves in several directions at once, .* make it fixed": (
        ('type="revolute"', 'type="floating"'),
    ),
}


@pytest.mark.parametrize("words", WRONG)
def test_a_urdf_with_impossible_numbers_is_refused_by_the_name_of_its_joint_or_link(words: str, tmp_path: Path) -> None:
    path = urdf(tmp_path)
    text = path.read_text()
    for old, new in WRONG[words]:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as raised:
        explore_hand(path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("limit", "span", "words"),
    [
        ('upper="1.4"', (0.0, 1.4), "one_joint: its limit has no lower, which is 0 in a URDF: 0 … 1.4"),
        ('lower="-0.3"', (-0.3, 0.0), "one_joint: its limit has no upper, which is 0 in a URDF: -0.3 … 0"),
    ],
)
def test_an_end_that_a_limit_of_a_urdf_leaves_out_is_zero_and_is_said(
    limit: str, span: tuple[float, float], words: str, tmp_path: Path
) -> None:
    found = explore_hand(urdf(tmp_path, ('lower="-0.3" upper="1.4"', limit)))
    row = found.card["driven"][0]
    assert (row["lower"], row["upper"]) == span
    assert words in found.notes
    assert not any("has no range" in note for note in found.notes)


def test_masses_that_a_urdf_does_not_have_are_listed_in_the_terminal_and_on_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = urdf(tmp_path, (LINK.format("two", INERTIAL), LINK.format("two", "")))
    command("hand", "new", str(path), "--no-film")
    words = "masses are assumed, of the shapes filled with water, for the file has none: two 10.1 g"
    assert words in capsys.readouterr().out
    assert words in Path("mine/two.md").read_text()


def test_a_hand_of_more_than_a_metre_is_refused_and_one_of_less_than_2_cm_is_asked_for_its_unit(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"it reaches 25.1 m .*: is it in mm, or in inches\? .* scale=") as raised:
        explore_hand(urdf(tmp_path, ('length="0.05"', 'length="50"')))
    assert "\n" not in str(raised.value)
    assert not any("it reaches" in note for note in explore_hand(urdf(tmp_path)).notes)
    small = mjcf(tmp_path, SERVO).read_text().replace("0.03", "0.003").replace("0.05", "0.005").replace("0.04", "0.004")
    Path("small.xml").write_text(small.replace("0.008", "0.0008").replace("0.007", "0.0007"))
    assert any("it reaches 0.0" in note and "another unit" in note for note in explore_hand(Path("small.xml")).notes)


def test_a_range_of_more_than_a_whole_turn_is_asked_whether_it_is_in_degrees(tmp_path: Path) -> None:
    found = explore_hand(urdf(tmp_path, ('lower="-0.3" upper="1.4"', 'lower="-6" upper="6"')))
    assert any("more than a whole turn, rad: one_joint -6 … 6" in note and "degrees" in note for note in found.notes)
    assert not any("turn" in note for note in explore_hand(urdf(tmp_path)).notes)


@pytest.mark.parametrize("motor", [MOTOR, SERVO])
def test_ranges_in_radians_that_are_read_as_degrees_are_asked_about(tmp_path: Path, motor: str) -> None:
    path = mjcf(tmp_path, motor)
    assert not any("hardly move" in note for note in explore_hand(path).notes)
    path.write_text(path.read_text().replace('<compiler angle="radian"/>', ""))
    (note,) = [note for note in explore_hand(path).notes if "hardly move" in note]
    assert "f1_1 -0.3 … 1.4, f1_2 0 … 1.5, f2_1" in note
    assert 'are they in radians? Without <compiler angle="radian"/> an MJCF has degrees' in note


@pytest.mark.slow
def test_a_servo_that_does_not_come_to_rest_is_said_with_how_far_its_joint_still_moves(tmp_path: Path) -> None:
    path = mjcf(tmp_path, SERVO.replace('kv="0.1"', 'kv="0"'))
    path.write_text(path.read_text().replace('damping="0.02"', ""))
    notes = [note for note in explore_hand(path).notes if "come to rest" in note]
    assert len(notes) == 1
    assert re.match(
        r"f\d_\d does not come to rest with f\d_\d at .*: after 20 s it still moves to and fro by", notes[0]
    )
    assert not any("come to rest" in note for note in explore_hand(mjcf(tmp_path, SERVO)).notes)


def test_a_file_that_is_called_left_is_asked_for_its_side(tmp_path: Path) -> None:
    path = mjcf(tmp_path, SERVO, "two_hand_left")
    assert any("`--side left`" in note for note in explore_hand(path).notes)
    assert not any("--side" in note for note in explore_hand(mjcf(tmp_path, SERVO, "cleft")).notes)


def test_links_of_an_mjcf_that_touch_at_rest_are_let_through_each_other_and_its_postures_are_taken(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = mjcf(tmp_path, SERVO)
    path.write_text(path.read_text().replace('pos="0.04 0 0.03"', 'pos="0.04 0 0.02"').replace(
        'pos="-0.04 0 0.03"', 'pos="-0.04 0 0.02"'))  # fmt: skip
    command("hand", "new", str(path), "--no-film")
    words = "2 pairs of links touch at rest and are let through each other: palm and f1_base, palm and f2_base"
    assert words in capsys.readouterr().out
    assert words in Path("mine/two.md").read_text()
    card = yaml.safe_load(Path("mine/two.yaml").read_text())
    assert card["touching"] == [["palm", "f1_base"], ["palm", "f2_base"]]
    with Hand.open("mine/sim_two.yaml") as hand:
        for name in ("home", "open", "flat"):
            hand.move_to(name, speed=2.0)
            hand.wait(0.3)
            assert hand.state.position == pytest.approx(card["postures"][name], abs=2e-2)
    card["touching"] = [["palm", "f3_base"]]
    write_settings(Path("mine/two.yaml"), card, "two")
    with pytest.raises(ConfigError, match="no body named 'f3_base'"):
        hand_spec(load_spec("mine/two.yaml"))


@pytest.mark.parametrize(
    ("wall", "words"),
    [
        ("", ""),
        (
            'pos="-0.029 0 0.064" size="0.001 0.02 0.004"',
            "has f2, f1 on a ball of 85 mm: with f2, f1 on a ball of 65 mm,",
        ),
        ('pos="0 0 0.05" size="0.005 0.02 0.03"', "is `flat`: with f2, f1 on a ball of 65 mm, f1 and palm would be 1"),
    ],
)
def test_the_guessed_home_is_one_in_which_no_links_touch_and_the_written_config_goes_there(
    wall: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = mjcf(tmp_path, SERVO)
    if wall:
        more = f'<geom type="box" {wall} mass="0.1"/><body name="f1_base"'
        path.write_text(path.read_text().replace('<body name="f1_base"', more))
    command("hand", "new", str(path), "--no-film")
    told = [line for line in capsys.readouterr().out.splitlines() if "`home`" in line]
    assert [line.startswith(f"Note: `home` {words}") for line in told] == ([True] if words else [])
    card = yaml.safe_load(Path("mine/two.yaml").read_text())
    spec = load_spec("mine/two.yaml")
    model = hand_spec(spec).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = card["postures"]["home"]
    mujoco.mj_forward(model, data)
    assert not data.ncon
    command("run", "mine/sim_two.yaml")
    said = capsys.readouterr()
    assert "not reached" not in said.out + said.err
    assert load_config("mine/sim_two.yaml").task.posture == "home"


@pytest.mark.parametrize("root", [None, "palm"])
def test_a_palm_that_floats_is_refused_before_anything_is_written(root: str | None, tmp_path: Path) -> None:
    path = mjcf(tmp_path, SERVO)
    path.write_text(path.read_text().replace('<body name="palm">', '<body name="palm"><freejoint/>'))
    with pytest.raises(ConfigError, match="palm floats, and a palm is held: remove the freejoint of palm"):
        command("hand", "new", str(path), "--no-film", *(["--root", root] if root else []))
    assert not Path("mine").exists()


def test_two_motors_of_one_joint_and_joints_without_a_name_are_called_by_the_names_of_the_file(tmp_path: Path) -> None:
    path = mjcf(tmp_path, SERVO)
    text = path.read_text()
    path.write_text(text.replace('name="a_f1_1" joint="f1_1"', 'name="a_f1_1" joint="f1_2"'))
    with pytest.raises(ConfigError, match="actuators a_f1_1 and a_f1_2 both drive joint f1_2: leave one of them"):
        explore_hand(path)
    passive = FINGER.format(name="f3", x=0).replace('joint name="f3_1"', "joint")
    path.write_text(text.replace("</body></worldbody>", f"{passive}</body></worldbody>"))
    with pytest.raises(ConfigError, match="a joint of body f3_base has no name: give it one"):
        explore_hand(path)


def test_fingers_keep_letters_of_every_alphabet(tmp_path: Path) -> None:
    path = mjcf(tmp_path, SERVO)
    path.write_text(path.read_text().replace("f1", "дaumen").replace("f2", "zeigé"), encoding="utf-8")
    assert list(explore_hand(path).card["fingers"]) == ["дaumen", "zeigé"]


def test_a_recording_of_ones_own_hand_becomes_a_bag_by_its_card_or_by_a_config(tmp_path: Path) -> None:
    command("hand", "new", str(mjcf(tmp_path, SERVO)), "--no-film")
    command("run", "mine/sim_two.yaml", "--seconds", "0.05", "--record", "it.arrow")
    assert load("it.arrow").spec.card == str(tmp_path / "mine" / "two.yaml")
    command("export", "it.arrow", "it.mcap")
    assert Path("it.mcap").stat().st_size > 1000
    Path("mine").rename("moved")
    with pytest.raises(ConfigError, match=r"its card .*mine/two.yaml is gone or has other joints: say --config"):
        command("export", "it.arrow", "again.mcap")
    command("export", "it.arrow", "bag", "--format", "rosbag2", "--config", "moved/sim_two.yaml")
    command("export", "it.arrow", "it.csv")
    with pytest.raises(ConfigError, match="it.arrow is of two_right, which has other joints"):
        command("export", "it.arrow", "again.mcap", "--config", "sim_leap")


def test_a_recording_is_not_exported_to_a_recording(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="r.arrow is a recording already: export it to .mcap"):
        command("export", "r.arrow", "r.arrow")


def test_hand_show_takes_a_card_and_says_of_a_config_how_to_show_its_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command("hand", "new", str(mjcf(tmp_path, SERVO)), "--no-film")
    command("hand", "show", "mine/two.yaml")
    assert "two_right" in capsys.readouterr().out
    with pytest.raises(ConfigError, match="mine/sim_two.yaml is a config, not a hand: --config mine/sim_two.yaml"):
        command("hand", "show", "mine/sim_two.yaml")
    assert yaml.safe_load(Path("mine/two.yaml").read_text())["root"] == "palm"
