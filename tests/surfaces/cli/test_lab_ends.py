"""The exit code of `allegro-twin lab` is 0 for what is held or a table that is cleared, and for nothing else."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from allegro_twin.cell import run
from allegro_twin.cell.run import LabReport
from allegro_twin.cell.states import CellOutcome, OutcomeKind
from allegro_twin.errors import HandFault, LinkError
from allegro_twin.surfaces.cli.cell import lab
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
    (CellOutcome("missed", "", "it is not there"), 5),
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


def test_every_word_that_a_run_can_end_with_has_a_code() -> None:
    assert set(lab._CODES) == set(get_args(OutcomeKind))
    assert [word for word, code in lab._CODES.items() if code == 0] == ["held", "cleared"]


def test_what_is_wrong_before_anything_moves_ends_with_2(command: Run) -> None:
    assert command(*CONFIG, "--object", "no_such_thing")[0] == 2
    assert command("lab", "conf/no_such_cell.yaml")[0] == 2
    assert command(*CONFIG, "--follow")[0] == 2
