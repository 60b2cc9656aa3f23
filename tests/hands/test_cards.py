"""`allegro-twin hand new`: from somebody's MJCF to a hand that runs, and what cannot be one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from allegro_twin import Hand
from allegro_twin.app import load_config
from allegro_twin.errors import ConfigError
from allegro_twin.files.yaml_edit import write_settings
from allegro_twin.grasping.scenario import Scenario, load_scenario
from allegro_twin.gym import HandEnv
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import Library, home_posture, load_posture, posture_names
from allegro_twin.hands.settings import HandSettings
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.recording.spec_json import spec_from_json, spec_to_json
from allegro_twin.sim.hand_import.adapt import read_mjcf
from allegro_twin.sim.hand_import.explore import explore_hand
from allegro_twin.sim.model.scene import hand_spec
from allegro_twin.spec import Side
from allegro_twin.spec.thermal import ThermalData
from allegro_twin.twin import mirror_recording
from tests.hands.models import GRIPPER, HANDS, SOFT, made
from tests.surfaces.cli.wrong import built


def command(*words: str) -> None:
    built()(list(words), standalone_mode=False)


@pytest.mark.usefixtures("short_films")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "soft" else name for name in HANDS]
)
def test_a_file_becomes_a_card_and_a_config_that_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(f"{name}.xml").write_text(HANDS[name])
    command("hand", "new", f"{name}.xml")
    command("run", f"mine/sim_{name}.yaml", "--record", "it.arrow")
    assert Path("it.arrow").is_file()
    assert f"{name}_right at" in capsys.readouterr().out.replace("\n", " ")


def test_a_card_says_what_is_driven_how_far_and_what_follows(tmp_path: Path) -> None:
    card = explore_hand(_file(tmp_path, GRIPPER)).card
    (motor,) = card["driven"]
    said = {"name": "left", "actuator": "grip", "lower": -0.02, "upper": 0.03, "effort": 20.0, "stiffness": 400.0}
    assert motor == said
    (follower,) = card["followers"]
    assert (follower["name"], follower["follows"]) == ("right", "left")
    assert follower["positions"] == pytest.approx([-0.02 + 0.005 * k for k in range(11)], abs=1e-4)
    assert sorted(card["fingers"]) == ["left_finger", "right_finger"]


def test_fingers_along_x_that_close_downwards_are_seen(tmp_path: Path) -> None:
    palm = explore_hand(_file(tmp_path, SOFT)).card["palm"]
    assert palm == {"facing": [0.0, 0.0, -1.0], "fingers": [1.0, 0.0, 0.0]}


def test_a_new_card_has_the_postures_home_open_and_flat_and_every_way_in_takes_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gripper.xml").write_text(GRIPPER)
    command("hand", "new", "gripper.xml", "--no-film")
    spec = load_spec("mine/gripper.yaml")
    assert list(spec.postures) == ["home", "open", "flat"]
    home, opened, flat = (load_posture(name, spec)[0] for name in spec.postures)
    assert flat == 0.0
    assert flat == opened  # Nothing of a gripper turns.
    assert home == pytest.approx(0.0125)  # A finger's slide is positive outwards: 65 mm less two pads.
    assert posture_names(spec) == ["flat", "home", "open"]
    assert [each.name for each in Library().list("posture", hand=spec)] == ["flat", "home", "open"]
    with Hand.open("mine/sim_gripper.yaml") as hand:
        hand.move_to("home", speed=0.05)
        hand.wait(0.2)
        assert hand.state.position == pytest.approx([home], abs=1e-3)
    assert home_posture(load_spec("allegro")) == pytest.approx(load_posture("home", load_spec("allegro")))
    assert home_posture(load_spec(str(made("soft", tmp_path / "bare")))) is None


def test_a_config_finds_the_card_beside_it_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made("gripper", tmp_path / "mine")
    config = tmp_path / "mine" / "sim.yaml"
    write_settings(config, {"hand": {"model": "gripper.yaml"}, "backend": {"kind": "sim"},
                            "controller": {"kind": "position"}}, "sim")  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert load_config("mine/sim.yaml").hand.model == "mine/gripper.yaml"
    with Hand.open(config) as opened:
        assert opened.spec.model == "gripper"


def test_one_hands_own_file_is_no_model_of_hand_and_that_is_said(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text("wire: {version: v5}\n")
    with pytest.raises(
        ConfigError, match=r"mine.yaml is one hand's own file, .* as `hand: {serial: .*, `plan` as --twin"
    ):
        load_spec(str(own))


def test_a_config_finds_a_hands_own_file_beside_it_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab/left.yaml").write_text("wire: {version: v5, side: left}\n")
    (tmp_path / "lab/mine.yaml").write_text(
        "{hand: {serial: left.yaml}, backend: {kind: sim}, controller: {kind: pd}}\n"
    )
    monkeypatch.chdir(tmp_path)
    hand = load_config("lab/mine.yaml").hand
    assert (Path(hand.serial), hand.side) == (Path("lab/left.yaml"), "left")


def test_without_scipy_a_card_has_no_postures_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(_name: str) -> None:
        raise ConfigError("metrics of contacts need SciPy")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("allegro_twin.grasping.plan.proposals.opposition.import_scipy", missing)
    Path("gripper.xml").write_text(GRIPPER)
    command("hand", "new", "gripper.xml", "--no-film")
    assert load_spec("mine/gripper.yaml").postures == {}
    assert "no postures in the card: metrics of contacts need SciPy" in capsys.readouterr().err.replace("\n", " ")


def test_a_mirror_of_a_recording_of_a_cards_hand_asks_for_the_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gripper.xml").write_text(GRIPPER)
    command("hand", "new", "gripper.xml", "--no-film")
    command("run", "mine/sim_gripper.yaml", "--record", "it.arrow")
    with pytest.raises(ConfigError, match=r"it.arrow is of the hand gripper, which a card describes: say --hand CARD"):
        mirror_recording(Path("it.arrow"), "", None)
    assert len(mirror_recording(Path("it.arrow"), "mine/gripper.yaml", None).t) > 100


def test_objects_that_are_given_are_the_disturbed_ones_whatever_the_package_has(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nothing_there.yaml"):
        HandEnv("HoldDisturbed", hand=str(made("gripper", tmp_path)), objects=("nothing_there.yaml",))


def test_a_folder_to_write_into_is_not_the_name_of_a_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gripper.xml").write_text(GRIPPER)
    with pytest.raises(ConfigError, match=r"--out mine.yaml: it is a folder, .* --name names the hand"):
        command("hand", "new", "gripper.xml", "--out", "mine.yaml")


@pytest.mark.slow
@pytest.mark.usefixtures("short_films")
def test_a_card_is_not_written_over_unless_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("gripper.xml").write_text(GRIPPER)
    command("hand", "new", "gripper.xml")
    with pytest.raises(ConfigError, match=r"mine/gripper.yaml is there already: --force"):
        command("hand", "new", "gripper.xml")
    command("hand", "new", "gripper.xml", "--force")


WRONG = {
    "has no actuators": (("<actuator>", "<!--"), ("</actuator>", "-->")),
    "repeated name 'left'": (('joint name="right"', 'joint name="left"'),),
    "actuator 0 has no name": (('position name="grip"', "position"),),
    "actuator grip is no position servo": (("position name", "velocity name"), (' kp="400"', "")),
    "actuator grip: neither it nor what it moves has a range": (
        (' ctrlrange="-0.02 0.03"', ""), ('type="slide" axis="0 1 0" range="-0.02 0.03"', 'type="slide" axis="0 1 0"'),
    ),
    "XML parse error": (("</mujoco>", ""),),
}  # fmt: skip


@pytest.mark.parametrize("words", WRONG)
def test_a_file_that_is_no_hand_says_why(words: str, tmp_path: Path) -> None:
    text = GRIPPER
    for old, new in WRONG[words]:
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(ConfigError, match=words) as raised:
        explore_hand(_file(tmp_path, text))
    assert "\n" not in str(raised.value)


def test_a_file_in_degrees_is_the_hand_that_it_is_in_radians(tmp_path: Path) -> None:
    """Ranges, references, and every way to say an orientation."""
    parts = """<body name="turned" axisangle="0 1 0 {half}"><inertial pos="0 0 0" euler="0 {third} 0" mass="1"
      diaginertia="3 2 2"/><joint name="hinge" range="{low} {high}" ref="{low}" springref="{half}" limited="true"/>
      <frame euler="{third} 0 0"><geom name="one" size="0.1" euler="0 {half} {third}"/><site euler="0 0 {low}"/>
      </frame></body>"""
    values = {"half": np.pi / 2, "third": np.pi / 3, "low": -0.4, "high": 1.3}
    texts = {"radian": parts.format(**values), "degree": parts.format(**{k: np.degrees(v) for k, v in values.items()})}
    models = []
    for angle, text in texts.items():
        body = f'<mujoco><compiler angle="{angle}"/><worldbody>{text}</worldbody></mujoco>'
        spec = read_mjcf(_file(tmp_path, body))
        assert not spec.compiler.degree
        models.append(spec.compile())
    for field in ("jnt_range", "qpos0", "qpos_spring", "body_quat", "body_iquat", "geom_quat", "site_quat"):
        np.testing.assert_allclose(getattr(models[1], field), getattr(models[0], field), atol=1e-9, err_msg=field)
    assert np.ptp(models[0].jnt_range) == pytest.approx(1.7)


def test_two_things_that_move_need_a_root(tmp_path: Path) -> None:
    ball = '<body name="ball" pos="1 0 0"><freejoint/><geom size="0.1"/></body>'
    path = _file(tmp_path, GRIPPER.replace("</worldbody>", f"{ball}</worldbody>"))
    with pytest.raises(ConfigError, match=r"2 things that move \(base, ball\): say which with --root"):
        explore_hand(path)
    assert explore_hand(path, "base").card["root"] == "base"
    with pytest.raises(ConfigError, match="--root: no body named 'bas'; did you mean 'base'"):
        explore_hand(path, "bas")


def changed(card: dict[str, Any], **blocks: Any) -> dict[str, Any]:
    return card | blocks


LIMP = "controller: {kind: position}\n"
WRIST = {"position": [0, 0, 0.1], "facing": [0, 0, -1], "fingers": [1, 0, 0], "retreat": [0, 0, 0.1]}
DRIVEN = {"name": "left", "actuator": "grip", "lower": -0.02, "upper": 0.03, "effort": 20.0}
CARDS: dict[str, dict[str, Any]] = {
    "followers: right: 'lft' is none of what is driven: left": {
        "followers": [{"name": "right", "follows": "lft", "positions": [0, 1]}]
    },
    "left is named twice": {"driven": [DRIVEN, DRIVEN]},
    "left: lower 0.03 is not below upper -0.02": {"driven": [DRIVEN | {"lower": 0.03, "upper": -0.02}]},
    "a hand that takes torques takes nothing else": {"commands": ["torque", "position"]},
    "fingers.left_finger: 'lift' is none of what is driven": {
        "fingers": {"left_finger": {"joints": ["lift"], "tip": ["left_finger", [0, 0, 0]]}}
    },
    "postures: home has 2 values; 1 are driven": {"postures": {"home": [0.0, 0.0]}},
    "postures: open: left is 0.1, outside -0.02 … 0.03": {"postures": {"open": [0.1]}},
    "thermal.rise: input should be greater than 0": {"thermal": {"rise": 0, "time_constant": 20.0, "source": "x"}},
    "must not be parallel": {"palm": {"facing": [1, 0, 0], "fingers": [2, 0, 0]}},
    "driven.0.actuatr: unknown key; did you mean 'actuator'": {"driven": [DRIVEN | {"actuatr": "x"}]},
}


@pytest.mark.parametrize("words", CARDS)
def test_a_card_that_does_not_fit_together_says_where(words: str, tmp_path: Path) -> None:
    path = made("gripper", tmp_path)
    write_settings(path, changed(yaml.safe_load(path.read_text()), **CARDS[words]), "gripper")
    with pytest.raises(ConfigError, match=words):
        load_spec(str(path))


def test_a_card_that_names_what_its_file_does_not_have_says_the_nearest(tmp_path: Path) -> None:
    path = made("gripper", tmp_path)
    content = yaml.safe_load(path.read_text())
    for block, words in (
        ({"driven": [DRIVEN | {"actuator": "gripp"}]}, "did you mean 'grip'"),
        ({"root": "bass"}, "did you mean 'base'"),
        ({"followers": [{"name": "rigt", "follows": "left", "positions": [0, 1]}]}, "did you mean 'right'"),
    ):
        write_settings(path, content | block, "gripper")
        with pytest.raises(ConfigError, match=words):
            hand_spec(load_spec(str(path)))


def test_a_cards_thermal_data_are_the_hands_and_stay_in_its_recordings(tmp_path: Path) -> None:
    path = made("gripper", tmp_path)
    assert load_spec(str(path)).thermal is None
    block = {"rise": 40.0, "time_constant": 20.0, "source": "data sheet"}
    write_settings(path, changed(yaml.safe_load(path.read_text()), thermal=block), "gripper")
    spec = load_spec(str(path))
    assert spec.thermal == ThermalData(40.0, 20.0, "data sheet")
    assert spec_from_json(spec_to_json(spec)).thermal == spec.thermal
    assert load_spec("leap").thermal is None


def test_a_card_of_a_left_hand_is_a_left_hand_wherever_no_side_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made("gripper", tmp_path / "mine")
    write_settings(path, changed(yaml.safe_load(path.read_text()), side="left"), "gripper")
    name = str(path)
    scenario = {"objects": [{"name": "lemon"}], "grasp": "g", "hand": name, "wrist": WRIST}
    read = HandSettings(model=name), EnvSettings(hand=name), Scenario.model_validate(scenario)
    assert {load_spec(name).side, *(each.side for each in read)} == {"left"}
    assert {load_spec().side, HandSettings().side, HandSettings(model="leap").side, EnvSettings().side} == {"right"}
    (tmp_path / "mine" / "config.yaml").write_text("hand: {model: gripper.yaml}\nbackend: {kind: sim}\n" + LIMP)
    assert load_config(tmp_path / "mine" / "config.yaml").hand.side == "left"
    write_settings(tmp_path / "mine" / "lemon.yaml", scenario | {"hand": "gripper.yaml"}, "lemon")
    assert load_scenario(tmp_path / "mine" / "lemon.yaml")[0].side == "left"
    monkeypatch.chdir(tmp_path)
    command("hand", "show", "mine/gripper.yaml")
    assert "gripper_left" in capsys.readouterr().out


def test_the_other_side_of_a_card_is_an_error(tmp_path: Path) -> None:
    path = str(made("gripper", tmp_path))
    sides: tuple[Side, ...] = ("left", HandSettings(model=path, side="left").side)
    for side in sides:
        with pytest.raises(ConfigError, match="is a right hand; hand.side is left"):
            load_spec(path, side)


def _file(folder: Path, text: str) -> Path:
    path = folder / "hand.xml"
    path.write_text(text)
    return path
