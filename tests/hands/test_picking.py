"""Other hands pick things off a table by the very definition by which the Allegro Hand does, and on either side."""

from __future__ import annotations

from pathlib import Path

import pytest

from allegro_twin.app import assemble, scenario_config
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.grasping.trial import make_trial
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.loop import run, until
from tests.surfaces.cli.wrong import built

OTHERS = ("leap", "model_o", "qb_softhand", "sih")
SCENARIOS = [path for hand in OTHERS for path in sorted((data_root() / "scenarios" / hand).glob("*.yaml"))]
ON_ARM = sorted((data_root() / "scenarios/on_arm").glob("*.yaml"))
QUICK = [next(path for path in SCENARIOS if path.parent.name == "model_o")]
"""A leap hand of either side picks a cube up below; what the others do before each push they do through their wires:
tests/serial."""


def held(path: Path, side: str = "right") -> bool:
    rig = assemble(scenario_config(path, side))
    assert rig.trial is not None
    for _ in rig.trial.watched(until(rig.trial.seconds, run(rig.backend, rig.controller))):
        pass
    return rig.trial.report().held


@pytest.mark.slow
@pytest.mark.parametrize("path", QUICK, ids=lambda path: path.stem)
def test_an_object_is_lifted_turned_and_shaken(path: Path) -> None:
    assert held(path)


@pytest.mark.long
@pytest.mark.parametrize("path", [*SCENARIOS, *ON_ARM], ids=lambda path: path.stem)
def test_every_object_of_each_hand_is_lifted_turned_and_shaken(path: Path) -> None:
    assert held(path)


@pytest.mark.slow
def test_a_left_leap_hand_does_what_the_right_one_does() -> None:
    assert held(data_root() / "scenarios/leap/leap_rubiks_cube.yaml", "left")


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_a_scenario_says_whose_it_is_and_is_of_a_demo_object(path: Path) -> None:
    scenario, _ = load_scenario(path)
    demo, _ = load_scenario(data_root() / f"scenarios/demo/{path.stem.removeprefix(path.parent.name + '_')}.yaml")
    assert scenario.hand == path.parent.name
    assert (scenario.objects, scenario.friction, scenario.protocol) == (demo.objects, demo.friction, demo.protocol)


@pytest.mark.parametrize("path", ON_ARM, ids=lambda path: path.stem)
def test_a_scenario_that_leaves_room_for_an_arm_is_of_a_hand_and_a_thing_that_it_is_named_after(path: Path) -> None:
    scenario, _ = load_scenario(path)
    assert path.stem == scenario.grasp == f"{scenario.hand}_{scenario.objects[0].name}_on_arm"


def test_a_scenario_of_another_hand_is_refused_by_name(tmp_path: Path) -> None:
    path = data_root() / "scenarios/leap/leap_rubiks_cube.yaml"
    with pytest.raises(ConfigError, match=r"leap_rubiks_cube.yaml is for the hand leap; this one is allegro"):
        make_trial(str(path), load_spec())
    with pytest.raises(ConfigError, match="is for the hand leap; sim_model_o has model_o: --config leap_usb or "):
        built()(["run", str(path), "--config", "sim_model_o", "--out", str(tmp_path)], standalone_mode=False)


@pytest.mark.slow
def test_the_demo_with_another_hand_is_what_that_hand_has_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "some"
    folder.mkdir()
    for name in ("rubiks_cube", "mug_of_mine"):
        text = (data_root() / "scenarios/demo/rubiks_cube.yaml").read_text()
        (folder / f"{name}.yaml").write_text(text)
    built()(["run", str(folder), "--hand", "leap", "--out", str(tmp_path / "out")], standalone_mode=False)
    out = " ".join(capsys.readouterr().out.split())
    assert "leap has no grasp of its own for mug_of_mine" in out
    assert "leap_rubiks_cube, right hand: held" in out
    assert (tmp_path / "out/leap_rubiks_cube_right.arrow").is_file()


def test_a_hand_without_any_of_them_says_so(tmp_path: Path) -> None:
    path = tmp_path / "cube_of_mine.yaml"
    path.write_text((data_root() / "scenarios/demo/rubiks_cube.yaml").read_text())
    with pytest.raises(ConfigError, match="the hand leap has no scenario of its own for cube_of_mine: give one"):
        built()(["run", str(path), "--hand", "leap"], standalone_mode=False)
