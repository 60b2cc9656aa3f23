"""Lines in a frame are where the frame's numbers say."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.twin.identify.report import figure_card
from allegro_twin.viewing.report.charts import ChartLine, line_chart
from tests.snapshots import assert_snapshot

SNAPSHOTS = Path(__file__).with_name("snapshots")


def points(text: str) -> list[list[tuple[float, float]]]:
    """Of every line, pixels."""
    ways = re.findall(r'points="([^"]+)"', text)
    return [[(float(x), float(y)) for x, y in (pair.split(",") for pair in way.split())] for way in ways]


def test_all_lines_are_in_one_frame_that_holds_them() -> None:
    one = ChartLine(np.array([0.0, 1.0, 2.0]), np.array([-1.0, 0.0, 1.0]), "ink", "measured")
    other = ChartLine(np.array([0.5, 1.5]), np.array([3.0, 3.0]), "bad", "<off>")
    text = line_chart([one, other], "s", "rad")
    first, second = points(text)
    # From 52 to 326 px across for 0 to 2 s, and from 170 up to 12 for -1 to 3 rad.
    np.testing.assert_allclose(first, [(52.0, 170.0), (189.0, 130.5), (326.0, 91.0)], atol=0.051)
    np.testing.assert_allclose(second, [(120.5, 12.0), (257.5, 12.0)], atol=0.051)
    assert_snapshot(text, SNAPSHOTS / "lines.svg")
    assert_snapshot(figure_card("A <joint>", "black & white", text), SNAPSHOTS / "card.html")


def test_a_line_that_is_flat_stands_in_the_middle_of_two_units() -> None:
    text = line_chart([ChartLine(np.array([1.0, 1.0]), np.array([5.0, 5.0]), "ink", "")], "s", "rad")
    (way,) = points(text)
    assert way == [(189.0, 91.0), (189.0, 91.0)]
    for tick in ("4", "6", "0", "2"):
        assert f">{tick}</text>" in text


def test_a_long_line_is_drawn_with_three_hundred_points_its_ends_among_them() -> None:
    x = np.linspace(0.0, 1.0, 1001)
    (way,) = points(line_chart([ChartLine(x, x, "good", "")], "s", "rad"))
    assert len(way) == 300
    assert (way[0], way[-1]) == ((52.0, 170.0), (326.0, 12.0))
    assert np.diff([a for a, _ in way]).max() == pytest.approx(274.0 / 299, abs=0.3)
