"""A registration covers protocol, models, grasps, objects and code, and is refused when any of them no longer fits."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.assets import data_root
from studies.preemption import registration
from studies.preemption.arm import grasps
from studies.preemption.jobs import sweep_of
from studies.preemption.protocol import ArmStudy, SpringStudy, Study, load_study
from studies.preemption.registration import (
    CODE,
    EXPLORATORY,
    contents_of,
    differences,
    place_of,
    register,
    registered,
    stamp_of,
    status_of,
)
from tests.snapshots import assert_snapshot, settings_text
from tests.studies import small


@pytest.fixture
def protocol(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(small.content(pairs={"train": 2, "test": 2}, controls={})))
    return path


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    for name in ("conf", "models", "scenarios"):
        shutil.copytree(data_root() / name, tmp_path / "copy" / name)
    return tmp_path / "copy"


CHANGES: list[tuple[str, str, str, list[str]]] = [
    ("conf/hands/model_o.yaml", "effort: 2.45", "effort: 2.4", ["model of model_o"]),
    ("models/tendons/model_o.yaml", "stiffness: 0.15", "stiffness: 0.16", ["model of model_o"]),
    ("models/mjcf/model_o_right.xml", 'mass="0.375"', 'mass="0.376"', ["model of model_o"]),
    ("models/urdf/model_o_right.urdf", "mass value", "mass  value", ["model of model_o"]),
    ("conf/grasps/model_o_foam_brick.yaml", "close:", "unread: 1\nclose:", ["grasps of model_o (foam_brick)"]),
    ("conf/grasps/model_o_foam_brick.yaml", "description: ", "description: Now, ", []),
    ("conf/grasps/model_o_apple.yaml", "close:", "unread: 1\nclose:", []),  # No object of this study.
    ("scenarios/model_o/model_o_gelatin_box.yaml", "friction: 0.8", "friction: 0.7",
     ["scenarios of model_o (gelatin_box)"]),
    ("conf/objects/ycb.yaml", "mass: 28}", "mass: 29}", ["object foam_brick"]),
    ("conf/hands/sih.yaml", "effort: 1.0", "effort: 1.1", []),  # No hand of this study.
    ("conf/hands/model_o.yaml", "# The", "# A", []),
]  # fmt: skip


ARM_CHANGES: list[tuple[str, str, str, list[str]]] = [
    ("conf/lab_allegro.yaml", "stiffness: 1000.0", "stiffness: 900.0", ["arm of allegro"]),
    ("conf/mounts/allegro.yaml", "position: [", "position:  [0, ", ["arm of allegro"]),
    ("models/mjcf/fer.xml", 'name="fer_link1"', 'name="fer_link1" gravcomp="0"', ["arm of allegro"]),
    ("conf/lab_allegro.yaml", "retries: 1", "retries: 2", []),  # No trial decides by it.
    ("conf/lab_leap.yaml", "stiffness: 1000.0", "stiffness: 900.0", []),  # No hand of this study.
]


@pytest.mark.parametrize(
    ("study", "name", "old", "new", "named"),
    [(small.study(), *change) for change in CHANGES] + [(small.arm_study(), *change) for change in ARM_CHANGES],
)
def test_what_differs_is_named_and_what_no_trial_reads_does_not_count(
    copied: Path, study: Study, name: str, old: str, new: str, named: list[str]
) -> None:
    made = registration.Registration(study.digest, "before", contents_of(study, copied))
    text = (copied / name).read_text()
    assert old in text
    (copied / name).write_text(text.replace(old, new, 1))
    assert differences(made, study, contents_of(study, copied)) == named


@pytest.mark.slow
def test_a_planned_grasp_that_differs_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    study = small.arm_study()
    made = registration.Registration(study.digest, "before", contents_of(study))
    kept = grasps.read_prepared("allegro")
    monkeypatch.setattr(grasps, "FOLDER", tmp_path)
    ball = kept["small_ball"]
    grasps.write_prepared(tmp_path, "allegro", kept | {"small_ball": ball._replace(close=ball.close + 1e-6)})
    assert differences(made, study, contents_of(study)) == ["grasps of allegro (small_ball)"]


@pytest.mark.slow
def test_another_protocol_and_other_code_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    study = small.study()
    made = registration.Registration(study.digest, "before", contents_of(study))
    assert differences(made, study, contents_of(study)) == []
    assert differences(made, small.study(seed=5), contents_of(study)) == ["the protocol"]
    monkeypatch.setattr(registration, "source_fingerprint", lambda module: "0")
    monkeypatch.setattr(registration, "version", lambda name: "3.9.0")
    assert differences(made, study, contents_of(study)) == ["engine", *CODE]


@pytest.mark.slow
def test_trials_are_stamped_with_the_registration_in_force_or_as_exploratory(protocol: Path) -> None:
    study = load_study(str(protocol))
    assert stamp_of(study, str(protocol), exploratory=False) == EXPLORATORY
    made = register(study, place_of(str(protocol)), "today")
    assert registered(place_of(str(protocol))) == made
    assert stamp_of(study, str(protocol), exploratory=False) == made.digest
    assert stamp_of(study, str(protocol), exploratory=True) == EXPLORATORY
    assert sweep_of(study, tuple(study.hands), registration=made.digest).question()["registration"] == made.digest
    with pytest.raises(ConfigError, match=r"a study is registered once; a changed one is a protocol of another name"):
        register(study, place_of(str(protocol)), "tomorrow")


def test_the_shipped_study_no_longer_fits_what_was_there_when_its_protocol_was_registered() -> None:
    """Not mended by registering it anew: its test trials have been seen."""
    study = load_study("preemption")
    made = registered(place_of("preemption"))
    assert made is not None
    assert made.protocol == study.digest
    with pytest.raises(ConfigError) as raised:
        stamp_of(study, "preemption", exploratory=False)
    said = str(raised.value)
    assert "no longer fits: " in said
    assert "\n" not in said
    # Of the Allegro Hand its gains have had one more set since, which no trial uses.
    mended = ["model of allegro", "model of model_o", "model of qb_softhand", "grasps of model_o (", "code of trials"]
    for part in [*mended, "grasps of qb_softhand (tomato_soup_can, tennis_ball, lemon and 8 more)"]:
        assert part in said
    assert "leap" not in said.partition("no longer fits")[2]


def test_a_registration_that_cannot_be_read_is_a_line(protocol: Path) -> None:
    place_of(str(protocol)).write_text("{}")
    with pytest.raises(RecordingError, match=r"mine\.registration\.json: no registration can be read"):
        stamp_of(load_study(str(protocol)), str(protocol), exploratory=False)


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        ({}, "Exploratory: of these trials the protocol alone was registered"),
        ({"registration": EXPLORATORY}, "Exploratory: no registration"),
        ({"registration": "0123"}, "Registered: protocol, models, grasps, objects and code as in registration 0123"),
    ],
)
def test_a_report_says_what_its_trials_can_show(stamps: dict[str, str], said: str) -> None:
    assert status_of(stamps).startswith(said)


def test_a_protocol_has_the_keys_defaults_and_bounds_that_it_had() -> None:
    folder = Path(__file__).with_name("snapshots")
    assert_snapshot(settings_text(SpringStudy), folder / "protocol.txt")
    assert_snapshot(settings_text(ArmStudy), folder / "protocol_arm.txt")
