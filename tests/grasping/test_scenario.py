"""A scenario that is wrong says where, what and the nearest right thing, in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from allegro_twin.app.config import load_config
from allegro_twin.app.controller_settings import PositionSettings
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.grasping.batch.trials import load_case
from allegro_twin.grasping.scenario import Wrist, load_protocol, load_scenario, skew_warning, with_object
from allegro_twin.grasping.timeline import make_stage, make_timeline, place_object
from allegro_twin.grasping.trial import make_trial
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import grasp_names, load_grasp, load_posture, posture_names
from allegro_twin.sim.objects.catalogue import load_object
from allegro_twin.spec import HandSpec, Side

GOOD = """
objects: [{name: rubiks_cube}]
grasp: quadpod
wrist: {position: [0, 0, 0.1], facing: [0, 0, -1], fingers: [1, 0, 0], retreat: [0, 0, 0.1]}
"""


def fails(tmp_path: Path, text: str) -> str:
    path = tmp_path / "it.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        make_trial(str(path), load_spec())
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(str(path), "it.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("grasp:", "grsp:"), "it.yaml: grsp: unknown key; did you mean 'grasp'?; grasp: missing"),
        (
            ("retreat:", "retret:"),
            "it.yaml: wrist.retret: unknown key; did you mean 'retreat'?; wrist.retreat: missing",
        ),
        (("objects: [{name: rubiks_cube}]", "objects: []"), "it.yaml: objects: tuple should have at least 1 item"),
        (("[0, 0, 0.1]", "[0, 0]"), "it.yaml: wrist.position.2: missing"),
        (("[0, 0, 0.1]", "high"), "it.yaml: wrist.position: input should be a valid tuple, not 'high'"),
        (("0.1]", ".nan]"), "it.yaml: wrist.position.2: input should be a finite number, not nan"),
        (("grasp: quadpod", "grasp: quadpot"), "it.yaml: grasp: no grasp named 'quadpot'; did you mean 'quadpod'"),
        (
            ("{name: rubiks_cube}", "{name: thing, shape: mesh, file: gone.stl}"),
            "it.yaml: objects.0.file: no file at ",
        ),
        (
            ("rubiks_cube", "rubik_cube"),
            "it.yaml: objects.0: no object named 'rubik_cube'; did you mean 'rubiks_cube'",
        ),
        (
            ("grasp: quadpod", "grasp: quadpod\nfriction: 1.5"),
            "it.yaml: friction: input should be less than or equal to 1",
        ),
        (
            ("grasp: quadpod", "grasp: quadpod\nprotocol: table_pik"),
            "it.yaml: protocol: no protocol named 'table_pik'; did you mean 'table_pick'",
        ),
        (("name: rubiks_cube", "name: rubiks_cube, up: w"), "it.yaml: objects.0.up: input should be 'x', 'y' or 'z'"),
        (("grasp: quadpod", "grasp: quadpod\ngrasp: quadpod"), "it.yaml:4: not valid YAML: key 'grasp' is given twice"),
        (("[{name", "[{name: ["), "it.yaml:"),
        (
            ("facing: [0, 0, -1]", "facing: [1, 0, 0]"),
            "it.yaml: wrist: fingers [1.0, 0.0, 0.0] must not be parallel to facing",
        ),
        (
            ("facing: [0, 0, -1]", "facing: [0, 0, 0]"),
            "it.yaml: wrist: facing [0.0, 0.0, 0.0] is zero; it is a direction",
        ),
        (
            ("fingers: [1, 0, 0]", "fingers: [0, 0, 0]"),
            "it.yaml: wrist: fingers [0.0, 0.0, 0.0] is zero; it is a direction",
        ),
        (("name: rubiks_cube", "name: rubiks_cube, mass: 93"), "185 cm³ is 502,179 kg/m³, denser than any metal"),
        (
            ("name: rubiks_cube", "name: rubiks_cube, mass: 0.000093"),
            "9.3e-05 kg in 185 cm³ is 0.5 kg/m³, lighter than any foam: masses are in kg; if this is in t, say 0.093",
        ),
        (("name: rubiks_cube", "name: rubiks_cube, size: [1]"), "objects.0: rubiks_cube: `size` without `shape`"),
        (("name: rubiks_cube", "name: rubiks_cube, scale: 2"), "objects.0: rubiks_cube: `scale` without `shape`"),
        (
            ("name: rubiks_cube", "name: b, shape: sphere, scale: 2, size: [0.05], mass: 0.1"),
            "objects.0: b: a sphere has no `scale`; its keys are size, mass, up, yaw, at",
        ),
        (
            ("[{name: rubiks_cube}]", "[{name: rubiks_cube}, {name: rubiks_cube, at: [0.2, 0]}]"),
            "two objects are named rubiks_cube: objects have different names; give the second one",
        ),
        (("[0, 0, 0.1]", "[0, 0, 90]"), "wrist.position: lengths are in m, here at most 2 (if these are mm, divide"),
        (
            ("name: rubiks_cube", "name: b, shape: box, size: [57, 57, 57], mass: 0.1"),
            "objects.0.size: lengths are in m, here at most 2 (if these are mm, divide them by 1000)",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_place_and_the_way_out(
    change: tuple[str, str], message: str, tmp_path: Path
) -> None:
    assert message in fails(tmp_path, GOOD.replace(*change, 1))


def test_an_object_of_the_catalogue_has_the_mass_that_the_scenario_gives_it(tmp_path: Path) -> None:
    path = tmp_path / "it.yaml"
    path.write_text(GOOD.replace("name: rubiks_cube", "name: rubiks_cube, mass: 0.3"))
    scenario, _ = load_scenario(path)
    stage = make_stage(scenario, load_protocol("table_pick"), "right", tmp_path)
    assert stage.objects[0].grasp_object.mass == 0.3


def test_fingers_that_are_not_square_to_the_palms_direction_are_told_with_their_angle() -> None:
    square = {"position": (0, 0, 0.1), "facing": (0, 0, -1), "fingers": (1, 0, 0.01), "retreat": (0, 0, 0.1)}
    assert skew_warning(Wrist.model_validate(square)) is None
    skew = Wrist.model_validate(square | {"fingers": (1, 0, 0.5)})
    assert "26.6° off square to facing" in str(skew_warning(skew))


def test_one_wrong_value_in_a_list_is_one_mistake(tmp_path: Path) -> None:
    wrong = fails(tmp_path, GOOD.replace("name: rubiks_cube", "name: b, shape: sphere, size: [0.05], mass: 0"))
    assert wrong == "it.yaml: objects.0.mass: input should be greater than 0, not 0"


def test_a_file_that_is_missing_empty_or_no_mapping_is_named(tmp_path: Path) -> None:
    assert "it.yaml: is empty; it must hold a mapping of keys to values" in fails(tmp_path, "")
    assert "not list" in fails(tmp_path, "- 1")
    with pytest.raises(ConfigError, match="no/such.yaml: no such scenario file"):
        load_scenario("no/such.yaml")
    with pytest.raises(ConfigError, match="no scenario named 'lemmon'; did you mean 'lemon'"):
        load_scenario("lemmon")


def test_a_protocol_names_its_phases_once_and_its_reference(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text("version: 1\nphases: [{name: a, seconds: 1}, {name: a, seconds: 1}]\nreference: a\n")
    with pytest.raises(ConfigError, match="phases must have different names: a, a"):
        load_protocol(str(path))
    path.write_text("version: 1\nphases: [{name: a, seconds: 1}]\nreference: b\n")
    with pytest.raises(ConfigError, match="reference 'b' names no phase; there are: a"):
        load_protocol(str(path))
    path.write_text("version: 1\nphases: [{name: a}]\nreference: a\n")
    with pytest.raises(ConfigError, match="a phase without a hand motion needs `seconds`"):
        load_protocol(str(path))


@pytest.mark.parametrize("name", ["mug", "potted_meat_can"])
def test_fingers_close_as_slowly_in_the_draws_of_a_search_as_in_the_whole_trial(name: str) -> None:
    spec = load_spec()
    scenario, _ = load_scenario(name)
    grasp = load_grasp(scenario.grasp, spec)
    timelines = [
        make_timeline(load_protocol(rules), grasp, scenario, grasp.preshape, spec, 0.003)
        for rules in ("quick", "table_pick")
    ]
    draw, whole = (next(w.end - w.begin for w in each.windows if w.name == "close") for each in timelines)
    assert draw == pytest.approx(whole)


def test_a_config_that_is_wrong_names_the_key_in_the_right_kind_of_backend(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    base = "backend: {kind: sim}\ncontroller: {kind: pd}\n"
    for text, message in (
        (
            "backend: {kind: sim, facin: x}\ncontroller: {kind: pd}\n",
            "backend.facin: unknown key; did you mean 'facing'",
        ),
        (
            "backend: {kind: simm}\ncontroller: {kind: pd}\n",
            "no backend kind named 'simm'; did you mean 'sim'; there are sim, can, dynamixel, qb, schunk, replay;",
        ),
        ("controller: {kind: pd}\n", "backend: missing"),
        (base + "period: -1\n", "period: input should be greater than 0, not -1"),
        (base + "hand: {side: middle}\n", "hand.side: input should be 'right' or 'left', not 'middle'"),
    ):
        path.write_text(text)
        with pytest.raises(ConfigError) as caught:
            load_config(path)
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)


def test_the_config_of_a_real_hand_begins_with_the_manufacturers_gains() -> None:
    paths = sorted((data_root() / "conf").glob("*.yaml"))
    configs = [load_config(path) for path in paths if not path.stem.startswith("lab_")]
    real = [c for c in configs if isinstance(c.backend, CanSettings) and c.backend.interface == "socketcan"]
    assert real
    for config in real:
        assert isinstance(config.controller, PositionSettings)
        assert config.controller.gains == "v4"


@pytest.mark.parametrize("name", grasp_names())
def test_every_grasp_that_ships_fits_both_hands(name: str, side: Side) -> None:
    grasp = load_grasp(name, load_spec(side=side))
    assert grasp.speed > 0


@pytest.mark.parametrize("name", posture_names())
def test_every_posture_that_ships_fits_both_hands(name: str, side: Side) -> None:
    spec = load_spec(side=side)
    assert load_posture(name, spec).shape == (spec.n_joints,)


def test_a_grasp_outside_the_limits_names_file_joint_and_excess(tmp_path: Path, spec: HandSpec) -> None:
    text = (data_root() / "conf" / "grasps" / "quadpod.yaml").read_text()
    path = tmp_path / "wide.yaml"
    start = text.index("close: {index: [") + len("close: {index: [")
    path.write_text(text[:start] + "0.97" + text[text.index(",", start) :])
    with pytest.raises(
        ConfigError, match=r"wide\.yaml: close: index_0 = 0\.9700 rad is 0\.5000 rad outside its limits"
    ):
        load_grasp(path, spec)


def test_a_grasp_with_a_finger_too_few_or_too_short_says_so(tmp_path: Path, spec: HandSpec) -> None:
    text = (data_root() / "conf" / "grasps" / "quadpod.yaml").read_text()
    path = tmp_path / "short.yaml"
    path.write_text(text.replace("close: {index: [", "close: {index: [0.1, "))
    with pytest.raises(ConfigError, match="close: index has 4 joints, not 5"):
        load_grasp(path, spec)
    path.write_text(text.replace("close: {index:", "close: {pinky:"))
    with pytest.raises(ConfigError, match="no finger named 'pinky'"):
        load_grasp(path, spec)


def test_another_object_stands_where_the_scenarios_own_does(tmp_path: Path) -> None:
    path = tmp_path / "it.yaml"
    path.write_text(GOOD.replace("{name: rubiks_cube}", "{name: rubiks_cube, at: [0.02, -0.01], yaw: 30}"))
    scenario, _ = load_scenario(path)
    asked = with_object(scenario, "apple").objects[0]
    assert (asked.name, asked.at, asked.yaw) == ("apple", (0.02, -0.01), 30.0)
    spec = load_spec()
    for made in (
        load_case({"scenario": str(path), "object": "apple"}, spec).scenario,
        make_trial(str(path), spec, object_name="apple").scenario,
    ):
        assert made.objects == (asked,)


def test_another_object_than_an_mjcf_stands_on_the_table_whatever_that_ones_height_is(tmp_path: Path) -> None:
    (tmp_path / "thing.xml").write_text("<mujoco><worldbody><body><geom size='0.03'/></body></worldbody></mujoco>")
    path = tmp_path / "it.yaml"
    own = "{name: thing, shape: mjcf, file: thing.xml, at: [0.1, 0, 0.03]}"
    path.write_text(GOOD.replace("{name: rubiks_cube}", own))
    scenario, _ = load_scenario(path)
    asked = with_object(scenario, "cracker_box").objects[0]
    height = place_object(asked).position[2]
    assert place_object(asked).position[:2] == (0.1, 0.0)
    assert height == pytest.approx(load_object("cracker_box").half_extents()[2], abs=2e-4)


def test_another_object_has_a_name_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "it.yaml"
    path.write_text(GOOD.replace("{name: rubiks_cube}", "{name: rubiks_cube}, {name: apple, at: [0.2, 0]}"))
    with pytest.raises(ConfigError, match="two objects are named apple"):
        make_trial(str(path), load_spec(), object_name="apple")


def test_a_protocols_mass_is_refused_for_an_object_that_brings_its_own(tmp_path: Path) -> None:
    (tmp_path / "thing.xml").write_text(
        "<mujoco><worldbody><body><freejoint/><geom size='0.03'/></body></worldbody></mujoco>"
    )
    text = GOOD.replace("{name: rubiks_cube}", "{name: thing, shape: mjcf, file: thing.xml, at: [0, 0, 0.03]}")
    assert fails(tmp_path, text + "protocol: fc\n") == (
        "object thing: an MJCF brings its own mass, and the protocol asks for 0.1 kg: give the file that mass and take "
        "a protocol without `mass`"
    )


def test_two_objects_that_stand_in_each_other_are_refused_by_name(tmp_path: Path) -> None:
    both = GOOD.replace("[{name: rubiks_cube}]", "[{name: rubiks_cube}, {name: golf_ball, at: [0.01, 0.0]}]")
    said = fails(tmp_path, both)
    assert "objects rubiks_cube and golf_ball stand" in said
    assert "mm in each other where the scene begins: move one of them by its `at`" in said


def test_a_protocol_beside_a_scenario_is_the_scenarios_own_as_its_grasp_and_hand_are(tmp_path: Path) -> None:
    protocol = (data_root() / "conf" / "protocols" / "table_pick.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(protocol.replace("version: ", "version: 7", 1))
    (tmp_path / "it.yaml").write_text(GOOD + "protocol: mine.yaml\n")
    scenario, _ = load_scenario(tmp_path / "it.yaml")
    assert load_protocol(scenario.protocol).version > 7


def test_what_is_replaced_by_another_object_or_protocol_need_not_be_there(tmp_path: Path, spec: HandSpec) -> None:
    path = tmp_path / "it.yaml"
    path.write_text(
        GOOD.replace("{name: rubiks_cube}", "{name: thing, shape: mesh, file: gone.stl}") + "protocol: gone\n"
    )
    case = {"scenario": str(path), "object": "rubiks_cube", "protocol": "quick"}
    assert load_case(case, spec).scenario.objects[0].name == "rubiks_cube"
    with pytest.raises(ConfigError, match=r"it\.yaml: protocol: no protocol named 'gone'"):
        load_case(case | {"protocol": None}, spec)
    with pytest.raises(ConfigError, match=r"it\.yaml: objects\.0\.file: no file at"):
        load_case(case | {"object": None}, spec)


def test_a_mesh_that_was_named_in_the_place_of_an_object_and_is_missing_is_not_told_of_the_scenario(
    tmp_path: Path, spec: HandSpec
) -> None:
    path = tmp_path / "it.yaml"
    path.write_text(GOOD)
    with pytest.raises(ConfigError, match="object no: no file at") as refused:
        make_trial(str(path), spec, object_name=str(tmp_path / "no.obj"))
    assert "it.yaml" not in str(refused.value)


def test_a_name_that_no_file_can_have_is_one_that_is_missing(tmp_path: Path, spec: HandSpec) -> None:
    long = "a" * 300
    assert f"no protocol named '{long}'" in fails(tmp_path, GOOD + f"protocol: {long}\n")
    assert "objects.0.file: no file at" in fails(
        tmp_path, GOOD.replace("{name: rubiks_cube}", f"{{name: thing, shape: mesh, file: {long}}}")
    )
