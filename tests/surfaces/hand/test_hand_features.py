"""docs/reference/features.md promises nothing that does not run: every call in it is executed as it stands, on both
hands."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.hands.library.entries import posture_entry, trajectory_entry
from allegro_twin.hands.library.library import Library, load_posture
from allegro_twin.kinematics import hand_kinematics
from allegro_twin.spec import Side
from allegro_twin.surfaces.hand import Hand
from allegro_twin.twin.identify.motions.limits import FoundLimits, centring_offsets
from tests.surfaces.cli.conftest import Run, command

__all__ = ["command"]  # The command line in this process, as a fixture.
ROOT = Path(__file__).resolve().parents[3]
ON_A_HAND = ("posture", "grasp", "play", "teach", "calibrate")


class Row(NamedTuple):
    """A row of the table."""

    paper: str
    here: str
    test: str

    @property
    def calls(self) -> list[str]:
        return re.findall(r"`([^`]+)`", self.here)


def rows() -> list[Row]:
    lines = [line for line in (ROOT / "docs/reference/features.md").read_text().splitlines() if line.startswith("|")]
    table = [Row(*(cell.strip() for cell in line.strip("|").split("|"))) for line in lines[2:]]
    return [row for row in table if not row.paper.startswith("**")]


def executed() -> list[Any]:
    """Each row that is here, for each side; with the left hand every other one, and none that takes seconds, before
    each push, and the others in `make test-all`."""

    def marks(k: int, row: Row, side: Side) -> list[pytest.MarkDecorator]:
        if "calibrate" in row.here or "another make" in row.paper:
            return [pytest.mark.slow if side == "right" else pytest.mark.long]
        return [pytest.mark.long] if side == "left" and k % 2 else []

    here = [row for row in rows() if row.here != "not yet"]
    sides: tuple[Side, ...] = ("right", "left")
    return [
        pytest.param(row, side, id=f"{side}-{row.paper[:40]}", marks=marks(k, row, side))
        for k, row in enumerate(here)
        for side in sides
    ]


def names_for(hand: Hand) -> dict[str, Any]:
    """What the calls may name."""
    here = load_posture("ready", hand.spec)
    tools = (Library, FoundLimits, centring_offsets, posture_entry, trajectory_entry)
    return {tool.__name__: tool for tool in (*tools, load_config)} | {
        "hand": hand, "spec": hand.spec, "library": Library(), "here": here, "kinematics": hand_kinematics(hand.spec),
    }  # fmt: skip


@contextmanager
def somebody_bends_the_index(hand: Hand) -> Iterator[None]:
    assert hand.sim is not None
    hand.sim.push(np.where(np.arange(16) == 1, 0.1, 0.0))
    yield
    hand.sim.push(np.zeros(16))


def do(call: str, names: dict[str, Any], hand: Hand, side: Side, command: Run) -> None:
    """Execute a call, a command or a statement; a path must be there, and a comparison true."""
    if call.startswith("allegro-twin"):
        words = shlex.split(call)[1:]
        chosen = ["--config", f"sim_{side}"] if words[0] in ON_A_HAND else []
        code, _, errors = command(*words, *chosen)
        assert code == 0, errors
    elif call.endswith("/"):
        assert (ROOT / call).is_dir()
    elif call.startswith("with "):
        with somebody_bends_the_index(hand):
            exec(call, names)
    else:
        try:
            value = compile(call, "docs/reference/features.md", "eval")
        except SyntaxError:
            exec(call, names)
        else:
            assert eval(value, names) is not False


@pytest.mark.parametrize(("row", "side"), executed())
def test_every_call_of_the_table_runs_as_it_stands_on_either_hand(
    row: Row, side: Side, command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(
        yaml.safe_dump({"angles": {f: [0.3] * 4 for f in ("index", "middle", "ring", "thumb")}})
    )
    config = {"hand": {"side": side}, "backend": {"kind": "sim", "start": "ready"}, "controller": {"kind": "pid"}}
    assert row.calls, f"{row.paper}: a row names its call, or says: not yet"
    with Hand.open(RunConfig.model_validate(config)) as hand:
        names = names_for(hand)
        for call in row.calls:
            do(call, names, hand, side, command)


@cache
def written() -> str:
    """All the tests that there are."""
    return "".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.paper[:40])
def test_every_row_names_a_test_that_exists_or_says_not_yet(row: Row) -> None:
    if row.here == "not yet":
        assert row.test == ""
        return
    (named,) = re.findall(r"`([^`]+)`", row.test)
    if named.startswith("tests/"):
        assert (ROOT / named).is_file()
    else:
        beginning = named.removesuffix("…") if named.endswith("…") else f"{named}("
        assert f"\ndef {beginning}" in written(), named


def test_what_is_not_there_is_said_to_be_not_there() -> None:
    missing = [row.paper for row in rows() if row.here == "not yet"]
    assert [paper for paper in missing if "ROS" in paper]
    assert len(rows()) > 30
