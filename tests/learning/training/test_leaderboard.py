"""The leaderboard is made of what stands in the policies' pages and in the tables of what needs no learning."""

from __future__ import annotations

from pathlib import Path

import pytest

from allegro_twin.files.assets import data_root
from benchmarks import leaderboard

pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")


def test_the_leaderboard_is_current() -> None:
    assert leaderboard.PAGE.read_text() == leaderboard.page(), "python -m benchmarks.leaderboard makes it anew"


def test_every_policy_and_every_baseline_has_a_row() -> None:
    lines = leaderboard.page().splitlines()
    for path in (data_root() / "conf" / "policies").glob("*.onnx"):
        assert any(f"[`{path.stem}`](" in line for line in lines), path.stem
    cells = [cell for row in leaderboard.table(leaderboard.RESULTS, "baselines") for cell in row[2:5] if cell != "—"]
    assert sum("500,000,000, 3 ms" in line for line in lines) == len(cells)
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1


def test_a_page_without_results_is_named(tmp_path: Path) -> None:
    (tmp_path / "mine_right.md").write_text("# mine_right.onnx\n")
    with pytest.raises(ValueError, match="mine_right.md has no table between <!-- results --> and <!-- /results -->"):
        next(leaderboard.table(tmp_path / "mine_right.md", "results"))
