"""The exit code of `allegro-twin lab` is 0 for what is held or a table that is cleared, and for nothing else."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from allegro_twin.cell import run
from allegro_twin.cell.checks.grasp_check import GraspCheck
from allegro_twin.cell.journal import observers
from allegro_twin.cell.journal.observers import Observers
from allegro_twin.cell.run import LabReport
from allegro_twin.cell.states import CellOutcome, OutcomeKind
from allegro_twin.errors import HandFault, LinkError, RecordingError
from allegro_twin.files.assets import data_root
from allegro_twin.surfaces.cli.cell import lab
from tests.full_disk import full_disk
from tests.sim.dirty_meshes import cracker, obj
from tests.surfaces.cli.conftest import Run

CONFIG = ("lab", "conf/lab_allegro.yaml")


def ends(monkeypatch: pytest.MonkeyPatch, end: CellOutcome | BaseException) -> None:
    """The cell comes to this end, whatever it does."""

    def perform(*cell: Any, **stages: Any) -> LabReport:
        if isinstance(end, BaseException):
            raise end
        return LabReport(end, (), 1, None, None, None, float("nan"), 0.15, "mug")

    monkeypatch.setattr(run, "perform", perform)


@pytest.mark.parametrize(("end", "code"), [
    (CellOutcome("held"), 0), (CellOutcome("held", "", "the force sensor is suspect"), 0),
    (CellOutcome("cleared", "", "3 put away"), 0), (CellOutcome("missed", "left", "2 put away; left: a box"), 5),
    (CellOutcome("missed", "", "it is not there"), 5), (CellOutcome("missed", "another object", "held a cup"), 5),
    (CellOutcome("refused", "no_object", "nothing"), 5), (CellOutcome("refused", "no_grasp", "too large"), 5),
    (CellOutcome("fault", "hand without torque", "thumb_1"), 4), (CellOutcome("fault", "not confirmed", "light"), 4),
    (CellOutcome("fault", "dropped", "gone"), 4), (CellOutcome("fault", "timeout in Approach", "late"), 4),
    (LinkError("no answer"), 3), (HandFault("it stopped"), 4), (KeyboardInterrupt(), 130),
])  # fmt: skip
def test_only_what_is_held_or_cleared_ends_with_0(
    end: CellOutcome | BaseException, code: int, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends(monkeypatch, end)
    ended, out, error = command(*CONFIG)
    assert ended == code
    assert str(end).split(":")[0] in out + error or isinstance(end, KeyboardInterrupt)


@pytest.mark.parametrize(("end", "code"), [
    (CellOutcome("held"), 2), (CellOutcome("missed", "", "it is not there"), 5), (CellOutcome("fault", "dropped"), 4),
])  # fmt: skip
def test_a_film_that_the_disk_does_not_take_costs_no_verdict(
    end: CellOutcome, code: int, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def full(cell: Any, path: Path, stage: Any) -> Iterator[Any]:
        yield stage
        raise RecordingError(f"cannot write {path}: no space")

    ends(monkeypatch, end)
    monkeypatch.setattr(observers, "film_stage", full)
    ended, out, error = command(*CONFIG, "--film", "a.mp4")
    assert (ended, error.count("\n")) == (code, 1)
    assert out.splitlines()[-1].startswith(str(end))
    assert error.endswith("cannot write a.mp4: no space\n")


def test_a_recording_that_the_disk_does_not_take_stops_no_arm_and_costs_no_verdict(
    command: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    heard: list[int] = []

    def perform(cell: Any, on_prepare: Any, **stages: Any) -> LabReport:
        looking: Observers = on_prepare.__self__
        for count in range(500):
            looking.on_refusal(0.003 * count, "out of reach")
            heard.append(count)
        return LabReport(CellOutcome("held"), (), 1, None, None, None, float("nan"), 0.15, "mug")

    monkeypatch.setattr(run, "perform", perform)
    with full_disk(120_000):
        ended, out, error = command(*CONFIG, "--out", tmp_path / "run")
    assert (ended, error.count("\n"), len(heard)) == (2, 1, 500)
    assert "held\n" in out
    assert "cannot go on recording to" in error
    assert f"what was written until then is in {tmp_path}/run/unfinished" in error


def test_what_the_option_names_is_what_the_cell_is_asked_for(command: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def perform(cell: Any, **stages: Any) -> LabReport:
        asked.append(None if cell.wanted is None else cell.wanted.name)
        return LabReport(CellOutcome("held"), (), 1, None, None, None, float("nan"), 0.15, "mug")

    monkeypatch.setattr(run, "perform", perform)
    assert command(*CONFIG)[0] == command(*CONFIG, "--object", "lemon")[0] == 0
    assert asked == [None, "lemon"]


def test_every_word_that_a_run_can_end_with_has_a_code() -> None:
    assert set(lab._CODES) == set(get_args(OutcomeKind))
    assert [word for word, code in lab._CODES.items() if code == 0] == ["held", "cleared"]


@pytest.mark.parametrize(("given", "other"), [(("--namespace", "/left"), "--ros"), (("--port", "9000"), "--panel")])
def test_an_option_of_a_way_in_that_is_not_opened_is_refused(given: tuple[str, str], other: str, command: Run) -> None:
    code, _, errors = command(*CONFIG, *given)
    assert (code, errors) == (2, f"allegro-twin: {given[0]} is of {other}: say {other} as well\n")


def test_what_is_wrong_before_anything_moves_ends_with_2(command: Run) -> None:
    assert command(*CONFIG, "--object", "no_such_thing")[0] == 2
    assert command("lab", "conf/no_such_cell.yaml")[0] == 2
    assert command(*CONFIG, "--follow")[0] == 2


def test_an_object_that_nobody_knows_is_named_with_the_cells_file_and_its_key(tmp_path: Path, command: Run) -> None:
    config = tmp_path / "cell.yaml"
    config.write_text((data_root() / "conf" / "lab_allegro.yaml").read_text().replace("{name: apple", "{name: aple"))
    code, _, errors = command("lab", config)
    assert (code, "cell.yaml: objects.0: no object named 'aple'; did you mean 'apple'" in errors) == (2, True)


def test_a_mesh_is_taken_by_the_unit_that_is_said(
    command: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    heard: list[Any] = []

    def perform(cell: Any, **stages: Any) -> LabReport:
        heard.append(cell.wanted)
        return LabReport(CellOutcome("held"), (), 1, None, None, None, float("nan"), 0.15, "mug")

    monkeypatch.setattr(run, "perform", perform)
    solid = cracker()
    file = obj(tmp_path / "thing.obj", solid.vertices * 0.4, solid.faces.tolist(), 0.005)
    edges = 0.4 * np.ptp(solid.vertices, axis=0)
    assert command(*CONFIG, "--object", file, "--scale", 0.005)[0] == 0
    np.testing.assert_allclose(2.0 * heard[0].half_extents(), edges, rtol=1e-4)


@pytest.mark.parametrize(("words", "said"), [
    (["--film", "run.gif"], "--film run.gif: must end in .mp4 or .mkv or .mov"),
    (["--object", "lemon", "--scale", "0.001"], "--scale is for the mesh of --object; lemon is none"),
    (["--scale", "0.001"], "--scale is for the mesh of --object; apple is none"),
    (["--panel", "--film", "a.mp4"], "--film is of a cell that picks by itself, and with --panel somebody leads it"),
    (["--follow", "--panel", "--clear"], "--clear is of a cell that picks by itself, and with --follow somebody leads"),
])  # fmt: skip
def test_a_wrong_option_is_one_line_before_anything_moves(words: list[str], said: str, command: Run) -> None:
    code, _, errors = command(*CONFIG, *words)
    assert (code, errors.count("\n")) == (2, 1)
    assert said in errors


def two_on_the_table(folder: Path) -> Path:
    text = (data_root() / "conf/lab_allegro.yaml").read_text()
    config = folder / "two.yaml"
    slab = "{name: slab, shape: box, size: [0.03, 0.06, 0.09], mass: 0.1, at: [0.1, 0.1]}"
    config.write_text(re.sub("(?m)^objects:.*", f"objects: [{{name: apple}}, {slab}]", text))
    return config


def test_an_object_that_stands_on_the_table_is_chosen_by_its_name_and_nothing_is_replaced(
    command: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    heard: list[Any] = []

    def perform(cell: Any, **stages: Any) -> LabReport:
        heard.append((cell.wanted.name, [each.name for each in cell.settings.objects]))
        return LabReport(CellOutcome("held"), (), 1, None, None, None, float("nan"), 0.15, "slab")

    monkeypatch.setattr(run, "perform", perform)
    config = two_on_the_table(tmp_path)
    for name in ("slab", "apple"):
        assert command("lab", config, "--object", name)[0] == 0
    assert heard == [("slab", ["apple", "slab"]), ("apple", ["apple", "slab"])]


def test_a_mesh_of_the_name_of_another_object_on_the_table_is_refused_with_both_ways_out(
    command: Run, tmp_path: Path
) -> None:
    solid = cracker()
    file = obj(tmp_path / "slab.obj", solid.vertices, solid.faces.tolist())
    code, _, errors = command("lab", two_on_the_table(tmp_path), "--object", file)
    assert (code, errors.count("\n")) == (2, 1)
    assert "another slab is on the table; rename one" in errors
    assert "--object slab takes that one" in errors


def test_another_object_that_the_hand_carries_too_was_not_moved_but_is_in_the_hand() -> None:
    both = LabReport(
        CellOutcome("held"), (), 1, None, None, None, 0.0, 0.15, "right", (("left", 0.144), ("pea", 0.02)),
        in_hand=("left", "right"),
    )  # fmt: skip
    assert lab.outcome_lines(both)[:2] == [
        "another object, left, is in the hand, too", "another object, pea, was moved by 20 mm"
    ]  # fmt: skip


def test_what_is_put_away_and_is_not_in_the_tray_in_truth_is_named_with_where_it_is() -> None:
    end = CellOutcome("missed", "left", "2 objects put away, so the cell takes it for cleared; in truth tall neither …")
    report = LabReport(end, (), 1, None, None, None, float("nan"), 0.0, "cube", (), 2, ("cube",), ("pea",), ("tall",))
    said, last = lab.outcome_lines(report)
    assert (
        said == "2 put into the tray, as the cell counts; in truth in it: cube; on the table: pea; off the table: tall"
    )
    assert last.startswith("missed: left; 2 objects put away")


def test_an_object_that_is_off_the_table_is_said_to_be_and_not_how_far_it_fell() -> None:
    checked = GraspCheck(0.0, 0.053, 0.0, 0.0, None, False, False, None, False)
    end = CellOutcome("missed", "", "the thing is not in the hand")
    off = LabReport(end, (), 1, None, None, checked, 0.0, float("nan"), "mug", off_table=("mug", "pea"))
    seen, other, _ = lab.outcome_lines(off)
    assert seen.endswith("camera: cannot tell; in truth mug is off the table")
    assert other == "another object, pea, fell off the table"
    low = LabReport(end, (), 1, None, None, checked, 0.0, -0.046, "mug")
    assert lab.outcome_lines(low)[0].endswith("in truth mug is 46 mm lower than where it stood")


def test_while_a_grasp_is_searched_the_terminal_says_for_what_and_how_far(
    command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def perform(cell: Any, on_planning: Any, **stages: Any) -> LabReport:
        on_planning("round 1 of 3: 0 adapted grasps close on it")
        return LabReport(CellOutcome("held"), (), 1, None, None, None, float("nan"), 0.15, "mug")

    monkeypatch.setattr(run, "perform", perform)
    assert "  round 1 of 3: 0 adapted grasps close on it\n" in command(*CONFIG)[1]


def test_a_mesh_whose_file_has_the_name_of_a_part_of_the_hand_is_refused_with_both_ways_out(
    command: Run, tmp_path: Path
) -> None:
    solid = cracker()
    file = obj(tmp_path / "fer_link3.obj", solid.vertices, solid.faces.tolist())
    code, _, errors = command(*CONFIG, "--object", file)
    assert (code, errors.count("\n")) == (2, 1)
    assert "give the object another one by its `name`, or rename its file where it is named after that" in errors
