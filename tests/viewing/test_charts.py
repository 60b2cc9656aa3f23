"""Charts show the numbers that they are given, at places that are looked at once and kept."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from allegro_twin.viewing.report.charts import rate_chart, round_ticks, scatter_chart, strip_chart
from tests.snapshots import assert_snapshot

SNAPSHOTS = Path(__file__).with_name("snapshots")
GOOD = np.array([True, False, True, True, False])
VALUES = np.array([-0.25, 0.1, 0.75, 0.4, np.nan])


def places(chart: str, kind: str, name: str) -> list[float]:
    """A number of every shape of a class."""
    shapes = ElementTree.fromstring(chart).iter()
    return [
        float(shape.attrib[name])
        for shape in shapes
        if shape.get("class", "").startswith(kind) and name in shape.attrib
    ]


def test_a_chart_of_rates_has_its_dots_where_its_scale_says() -> None:
    chart = rate_chart([("mug", 3, 4, 0.3, 0.95), ("<can>", 0, 10, 0.0, 0.28), ("none", 0, 0, 0.0, 1.0)], "Held")
    grid = places(chart, "grid", "x1")
    assert np.diff(grid) == pytest.approx([95.0] * 4)  # 0, 25, 50, 75 and 100 %.
    span = grid[-1] - grid[0]
    assert places(chart, "good", "cx") == pytest.approx([grid[0] + 0.75 * span, grid[0]])
    assert places(chart, "whisker", "x2") == pytest.approx([grid[0] + part * span for part in (0.95, 0.28, 1.0)])
    assert np.diff(places(chart, "whisker", "y1")) == pytest.approx([26.0, 26.0])
    assert_snapshot(chart, SNAPSHOTS / "rates.svg")


def test_a_strip_has_a_mark_for_each_value_a_line_at_nought_and_one_at_the_median() -> None:
    chart = strip_chart([("+x", VALUES), ("-x", np.array([0.5, 0.25, 1.0, 0.0, 0.5]))], GOOD, "Margins")
    zero = places(chart, "zero", "x1")[0]
    unit = (places(chart, "median", "x1")[1] - zero) / 0.5  # The median of the second row is 0.5.
    assert places(chart, "median", "x1")[0] == pytest.approx(zero + 0.25 * unit, abs=0.1)
    assert places(chart, "good", "cx")[:3] == pytest.approx(
        [zero + value * unit for value in (-0.25, 0.75, 0.4)], abs=0.1
    )
    assert chart.count('class="bad"') == 3
    assert_snapshot(chart, SNAPSHOTS / "strips.svg")
    assert_snapshot(strip_chart([("one", np.array([2.0, 2.0]))], GOOD, "All above"), SNAPSHOTS / "strips_above.svg")


def test_a_scatter_has_its_values_to_the_right_and_its_outcomes_upwards() -> None:
    chart = scatter_chart(
        np.array([1.0, 2.0, 5.0, 3.0, np.nan]), np.array([0.0, 0.5, 1.0, 0.9, 0.4]), GOOD, "ε", "size, m"
    )
    good = places(chart, "good", "cx")
    assert np.diff(good) == pytest.approx([280.0, -140.0])  # From 1 to 5 and back to 3 of 280 px.
    assert "4 results" in chart
    heights = [float(y) for y in re.findall(r'class="bad" d="M[\d.]+ ([\d.]+)', chart)]
    assert len(heights) == 1
    assert_snapshot(chart, SNAPSHOTS / "scatter.svg")


@pytest.mark.parametrize(
    ("low", "high", "step"),
    [
        (0.0, 1.0, 0.5),
        (0.0, 0.9, 0.5),
        (-0.3, 0.3, 0.2),
        (0.0, 4.0, 1.0),
        (0.0, 8.0, 2.0),
        (0.0, 19.9, 5.0),
        (0.0, 4e-3, 1e-3),
    ],
)
def test_ticks_are_multiples_of_one_two_or_five_and_the_finest_that_are_at_most_a_quarter_more(
    low: float, high: float, step: float
) -> None:
    ticks = round_ticks(low, high)
    assert ticks == pytest.approx(
        [k * step for k in range(round(np.ceil(low / step - 1e-9)), int(high / step + 1e-9) + 1)]
    )
