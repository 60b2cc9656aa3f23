"""The page says what the table says, alone, safely, and in order."""

from __future__ import annotations

import math
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from scipy.stats import mannwhitneyu  # type: ignore[import-untyped]  # Its types are a package of their own.

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.grasping.evaluation.html_report import (
    SHOWN_ROWS,
    ResultTable,
    auc,
    html_report,
    shown,
    write_html_report,
)
from allegro_twin.viewing.report import rate_chart, round_ticks, scatter_chart, strip_chart
from tests.grasping.report_samples import png, results

EMPTY_TAGS = {"meta", "img", "br"}


class ParsedPage(HTMLParser):
    """Tags that are closed in order, what refers elsewhere, and the cells of the table."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]
        if tag not in EMPTY_TAGS:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def made(folder: Path, count: int = 30) -> str:
    return html_report(results(folder, count), folder, title="Trial <1> & more", about={"engine": "mujoco 4.0.0"})


def test_the_page_is_whole_and_needs_nothing_from_anywhere(tmp_path: Path) -> None:
    text = made(tmp_path)
    seen = ParsedPage(text)
    assert not seen.open
    assert all(link.startswith(("data:image/png;base64,", "runs/")) for link in seen.links)
    assert not re.search(r"https?:|@import|url\(", text)
    assert {"svg", "table", "figure", "h1", "h2"} <= set(seen.tags)
    assert seen.tags.count("tr") == 31


def test_what_the_table_says_cannot_become_code(tmp_path: Path) -> None:
    rows = results(tmp_path, 4)
    rows[1] |= {"grasp": "<script>alert(1)</script>", "object": "\"'><img src=x>", "rrd": "a' onclick='x.rrd"}
    text = html_report(rows, tmp_path, title="<b>")
    assert text.count("<script>") == 1
    assert "<img src=x>" not in text
    assert "<b></title>" not in text
    assert "onclick='x" not in text
    assert not ParsedPage(text).open


def test_rates_stand_with_their_counts_and_intervals(tmp_path: Path) -> None:
    rows = [{"object": "mug", "held": k < 12, "grasp": str(k)} for k in range(20)]
    text = html_report(rows, tmp_path, title="t")
    assert "12 of 20" in text
    assert "held: 60 % (39–78 %)" in text
    assert "Under uncertainty" not in text
    assert "Margins" not in text
    drawn = [row | {"success": 0.5, "n": 10} for row in rows]
    assert "100 of 200" in html_report(drawn, tmp_path, title="t")
    assert "of 200 draws under uncertainty (43–57 %)" in html_report(drawn, tmp_path, title="t")


def test_a_table_of_pyarrow_is_the_same_page(tmp_path: Path) -> None:
    rows = [{key: value for key, value in row.items() if key not in ("picture", "rrd")} for row in results(tmp_path, 8)]
    assert html_report(pa.Table.from_pylist(rows), tmp_path, title="t") == html_report(rows, tmp_path, title="t")


def test_best_pictures_held_and_are_in_order(tmp_path: Path) -> None:
    text = made(tmp_path)
    best, worst = (re.findall(r'alt="(g\d+) ', part) for part in re.split("<h2>Worst</h2>", text))
    by_name = {row["grasp"]: row for row in results(tmp_path, 30)}
    assert all(by_name[name]["held"] for name in best)
    assert [by_name[n]["success"] for n in best] == sorted((by_name[n]["success"] for n in best), reverse=True)
    assert len(best) + len(worst) == 9
    assert "not held: dropped by the end of &lt;+z&gt; &amp; gone" in text


def test_recordings_are_linked_from_where_the_page_lies(tmp_path: Path) -> None:
    write_html_report(tmp_path / "report" / "page.html", results(tmp_path, 10), title="t")
    assert 'href="../runs/g0%20a.rrd"' in (tmp_path / "report" / "page.html").read_text()


def test_what_flew_away_does_not_hide_the_rest_of_a_chart(tmp_path: Path) -> None:
    rows = [{"object": "mug", "held": k > 0, "margin_+x": [-300.0, 0.2, 0.6][k], "drift_mm": [2e4, 3.0, 9.0][k]}
            for k in range(3)]  # fmt: skip
    charts = html_report(rows, tmp_path, title="t").split("<h2>All results")[0]
    assert ">-1<" in charts
    assert "-300" not in charts
    assert ">100<" in charts
    assert "20000" not in charts


def test_a_picture_says_in_how_many_draws_it_held_with_the_interval(tmp_path: Path) -> None:
    row = {"object": "mug", "held": True, "picture": str(png(tmp_path / "a.png", (9, 9, 9))), "success": 0.5, "n": 4}
    assert "2 of 4 draws (15–85 %), held" in html_report([row], tmp_path, title="t")


def test_metrics_are_held_against_the_outcome(tmp_path: Path) -> None:
    rows = [{"object": "mug", "held": k >= 5, "epsilon": float(k), "torque_share": float(k)} for k in range(10)]
    text = html_report(rows, tmp_path, title="t")
    assert "epsilon: AUC 1.00" in text
    assert "torque_share: AUC 0.00" in text  # The less the better, and here it is more.
    assert "less is taken as better" in text
    assert "epsilon: AUC –" in html_report([row | {"held": True} for row in rows], tmp_path, title="t")


@pytest.mark.parametrize("seed", range(5))
def test_auc_is_that_of_the_ranks_with_ties(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, outcome = rng.integers(0, 6, 40).astype(float), (rng.uniform(size=40) > 0.4).astype(float)
    good = outcome > 0.5
    pairs = [(a > b) + 0.5 * (a == b) for a in values[good] for b in values[~good]]
    assert auc(values, outcome) == pytest.approx(np.mean(pairs))
    u = mannwhitneyu(values[good], values[~good]).statistic
    assert auc(values, outcome) == pytest.approx(u / (good.sum() * (~good).sum()))


def test_auc_leaves_out_what_is_unknown_and_ranks_infinity() -> None:
    values, outcome = np.array([math.inf, 1.0, math.nan, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
    assert auc(values, outcome) == 1.0
    assert math.isnan(auc(values, np.ones(4)))


def test_ticks_are_round_numbers_within() -> None:
    assert round_ticks(-0.318, 1.0) == [0.0, 0.5, 1.0]
    assert round_ticks(0.0, 0.43) == [0.0, 0.2, 0.4]
    assert round_ticks(3.0, 11.0) == [4.0, 6.0, 8.0, 10.0]
    assert round_ticks(2.0, 2.0) == [2.0]


def test_charts_of_nothing_and_of_one_value_are_drawn() -> None:
    nothing = np.full(3, math.nan)
    for chart in (
        strip_chart([("+x", nothing)], np.ones(3), "Margins"),
        scatter_chart(nothing, np.ones(3), np.ones(3), "e", "e"),
        scatter_chart(np.ones(3), np.ones(3), np.zeros(3), "e", "e"),
        rate_chart([("mug", 0, 0, 0.0, 1.0)], "Held"),
    ):
        assert chart.startswith("<svg")
        assert not re.search("nan|inf", chart)
        assert not ParsedPage(chart).open


def test_many_results_are_thinned_in_charts_and_cut_in_the_table(tmp_path: Path) -> None:
    rows = [{"object": "mug", "held": k % 3 > 0, "margin_+x": k / 5000, "epsilon": k / 7} for k in range(5000)]
    text = html_report(rows, tmp_path, title="t")
    assert f"The first {SHOWN_ROWS} of 5000" in text
    assert text.count("<tr>") == 1 + SHOWN_ROWS
    assert text.count('class="good faint"') + text.count('class="bad"') == 2 * 400  # Of the margin and of ε.


def test_values_are_written_as_people_read_them() -> None:
    assert [shown(value) for value in (True, np.False_, None, math.nan, 0.123456, np.float32(2), 7, "a", math.inf)] == [
        "yes", "no", "–", "–", "0.1235", "2", "7", "a", "inf",
    ]  # fmt: skip


def test_goodness_is_success_then_margin_then_epsilon() -> None:
    common = {"object": "mug"}
    rows = [
        {"held": True, "margin_+x": 0.1, "margin_-x": 0.5, "epsilon": 0.3},
        {"held": True, "margin_+x": 0.2, "margin_-x": 0.2, "epsilon": 0.1},
        {"held": False, "margin_+x": 0.9, "margin_-x": 0.9, "epsilon": 0.9},
        {"held": True, "margin_+x": 0.2, "margin_-x": 0.2, "epsilon": 0.2},
    ]
    np.testing.assert_array_equal(ResultTable([common | row for row in rows]).goodness(), [1, 2, 0, 3])


def test_what_cannot_be_shown_is_answered_in_a_line(tmp_path: Path) -> None:
    row = {"object": "mug", "held": True}
    with pytest.raises(ConfigError, match="a report needs at least one result"):
        html_report([], tmp_path, title="t")
    with pytest.raises(ConfigError, match="result 1 has no `held`; a report needs it in every row"):
        html_report([row, {"object": "mug"}], tmp_path, title="t")
    with pytest.raises(ConfigError, match=r"picture none\.png of a result cannot be read: No such file"):
        html_report([row | {"picture": "none.png"}], tmp_path, title="t")
    (tmp_path / "a.png").write_text("no picture")
    with pytest.raises(ConfigError, match=r"picture .*a\.png of a result is no PNG"):
        html_report([row | {"picture": str(tmp_path / "a.png")}], tmp_path, title="t")
    png(tmp_path / "b.png", (0, 0, 0))
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(RecordingError, match=r"folder\.html: it is a folder"):
        write_html_report(tmp_path / "folder.html", [row | {"picture": "b.png"}])
