"""The leaderboard is made of what stands in the policies' pages and in the tables of what needs no learning."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from allegro_twin.errors import ConfigError
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
    with pytest.raises(ConfigError, match="mine_right.md has no table between one line <!-- results --> and one line"):
        next(leaderboard.table(tmp_path / "mine_right.md", "results"))


PAGE = """# mine_right.onnx

<!-- results -->
| who | episodes | success | counted, mean | of | seeds from, physics |
|---|---|---|---|---|---|
{}
<!-- /results -->
"""
GOOD = "| `mine_right` | the objects trained on | 73.0 % (67.7 %–77.7 %) |  | 300 | 3,000,000,000, 1 ms |"
WRONG = {
    "an interval that is not Wilson's": (
        GOOD.replace("73.0 % (67.7 %–77.7 %)", "99.9 % (1.0 %–2.0 %)"),
        'success "99.9 % (1.0 %–2.0 %)": no count of 300 episodes is 99.9 %; near are 99.7 % and 100.0 %: cor',
    ),
    "an interval of other episodes": (
        GOOD.replace("300", "200"),
        'success "73.0 % (67.7 %–77.7 %)": 73.0 % of 200 episodes has the Wilson interval (66.5 %–78.7 %): write it',
    ),
    "more than all": (GOOD.replace("73.0 % (67.7 %–77.7 %)", "250 %"), 'success "250 %": write a share of 0 to 100 %'),
    "a word for a share": (GOOD.replace("73.0 % (67.7 %–77.7 %)", "most"), 'success "most": write a share'),
    "a share that no count has": (
        GOOD.replace("73.0 % (67.7 %–77.7 %)", "73.1 %"),
        "no count of 300 episodes is 73.1 %",
    ),
    "fewer than no episodes": (GOOD.replace("| 300 |", "| -4 |"), 'of "-4": write how many episodes these were'),
    "no episodes": (GOOD.replace("| 300 |", "| 0 |"), 'of "0": write how many episodes these were'),
    "a physics that is no time": (
        GOOD.replace("1 ms", "banana"),
        'physics "3,000,000,000, banana": write the first seed',
    ),
    "a step of no time": (GOOD.replace("1 ms", "0 ms"), 'physics "3,000,000,000, 0 ms": write the first seed'),
    "another policy": (GOOD.replace("mine", "lift"), 'who "`lift_right`": write `mine_right`, whose page this is'),
    "a cell too few": (GOOD.replace("|  | 300", "| 300"), "5 cells, | `mine_right` | the objects trained on |"),
    "a cell too many": (GOOD + " x |", "7 cells, | `mine_right` | the objects trained on |"),
    "no figure": (GOOD.replace("73.0 % (67.7 %–77.7 %)", ""), '"`mine_right`" has neither success nor a count'),
    "a count of nothing": (GOOD.replace("|  |", "| many |"), 'counted "many": write a number and rad or goals'),
    "no words for the episodes": (GOOD.replace("the objects trained on", ""), "episodes is empty"),
    "the same episodes twice": (f"{GOOD}\n{GOOD}", "mine_right.md:6 already: leave one of the two"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_row_that_cannot_be_is_refused_with_its_file_line_and_value(wrong: str, tmp_path: Path) -> None:
    row, said = WRONG[wrong]
    path = tmp_path / "mine_right.md"
    path.write_text(PAGE.format(row))
    with pytest.raises(ConfigError) as refused:
        leaderboard.results(path)
    assert str(refused.value).startswith(f"{path}:{7 if row.count(chr(10)) else 6}: ")
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("who", ["`mine_right`", "nothing", "random", "+0.10 rad on the proximal joints"])
def test_a_page_has_rows_of_its_own_policy_and_of_baselines(who: str, tmp_path: Path) -> None:
    path = tmp_path / "mine_right.md"
    path.write_text(PAGE.format(GOOD + "\n" + GOOD.replace("`mine_right`", who).replace("1 ms", "3 ms")))
    assert [row[0] for row in leaderboard.results(path)] == ["`mine_right`", who]


def test_a_page_that_says_nothing_of_its_policy_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine_right.md"
    path.write_text(PAGE.format(GOOD.replace("`mine_right`", "nothing")))
    with pytest.raises(ConfigError, match="mine_right.md has no row of `mine_right` in its results"):
        leaderboard.results(path)


@pytest.mark.parametrize("mark", ["<!-- results -->", "<!-- /results -->"])
def test_a_table_needs_both_of_its_marks(mark: str, tmp_path: Path) -> None:
    path = tmp_path / "mine_right.md"
    path.write_text(PAGE.format(GOOD).replace(mark, ""))
    with pytest.raises(ConfigError, match="mine_right.md has no table between one line <!-- results --> and one line"):
        leaderboard.results(path)


def test_a_table_has_the_columns_of_all_pages(tmp_path: Path) -> None:
    path = tmp_path / "mine_right.md"
    path.write_text(PAGE.format(GOOD).replace("counted, mean | of", "of | counted, mean"))
    with pytest.raises(ConfigError, match=r"mine_right.md:4: after <!-- results --> come the head \| who \| episodes"):
        leaderboard.results(path)


def test_a_network_under_two_names_is_refused(tmp_path: Path) -> None:
    shipped = data_root() / "conf" / "policies" / "lift_right.onnx"
    for name in ("mine_right", "yours_right"):
        shutil.copy(shipped, tmp_path / f"{name}.onnx")
        (tmp_path / f"{name}.md").write_text(PAGE.format(GOOD.replace("mine_right", name)))
    with pytest.raises(ConfigError, match="yours_right.onnx is the network of mine_right.onnx, byte for byte"):
        list(leaderboard.policies(tmp_path))
    (tmp_path / "yours_right.onnx").unlink()
    with pytest.raises(ConfigError, match=r"yours_right.md has no yours_right.onnx beside it"):
        list(leaderboard.policies(tmp_path))
    (tmp_path / "yours_right.md").unlink()
    assert [row.success for row in leaderboard.policies(tmp_path)] == ["73.0 % (67.7 %–77.7 %)"]
