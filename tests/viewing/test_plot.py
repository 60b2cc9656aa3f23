"""Lines over time are where their scales say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from allegro_twin.types import Array
from allegro_twin.viewing.plot import Line, plot

Image = pytest.importorskip("PIL.Image", reason="needs the extra view")

Places = NDArray[np.int_]
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
T = np.linspace(2.0, 12.0, 101)
LEFT, RIGHT, TOP, FOOT = 64, 1088, 48, 236
"""Of the first panel's frame, pixels."""


def drawn(path: Path, panels: dict[str, list[Line]], mark: float = 4.5) -> Array:
    plot(path, T, panels, mark=mark, title="Off")
    return np.asarray(Image.open(path)).astype(float)


def of(picture: Array, color: tuple[float, float, float]) -> tuple[Places, Places]:
    """Columns and rows of what has a colour inside the first panel's frame."""
    rows, columns = np.nonzero((np.abs(picture - 255 * np.array(color)) < 1).all(axis=2))
    inside = (rows > TOP) & (rows < FOOT + 1)
    return columns[inside], rows[inside]


def test_a_line_goes_through_its_values_and_a_mark_stands_at_its_moment(tmp_path: Path) -> None:
    picture = drawn(tmp_path / "plot.png", {"joint": [Line("rise", (T - 2.0) / 10.0, RED)]})
    assert picture.shape == (24 + 220, 1100, 3)
    columns, rows = of(picture, RED)
    assert abs(columns.min() - LEFT) <= 1
    assert abs(columns.max() - RIGHT) <= 1
    for column in (LEFT + 200, LEFT + 900):
        value = (column - LEFT) / (RIGHT - LEFT)
        row = FOOT - (value + 0.05) / 1.1 * (FOOT - TOP)  # A twentieth of the range is left free at either end.
        assert rows[columns == column].mean() == pytest.approx(row, abs=1.5)
    ink = (picture == 40.0).all(axis=2)
    mark = np.flatnonzero(ink[TOP + 2 : FOOT - 1].mean(axis=0) > 0.9)  # The line crosses it.
    assert mark.tolist() == [LEFT + 256]  # A quarter of the way from 2 to 12 s.
    frame = (picture == 190.0).all(axis=2)
    assert frame[TOP, LEFT:RIGHT].mean() > 0.9
    assert frame[FOOT, LEFT:RIGHT].mean() > 0.9
    assert frame[TOP:FOOT, LEFT].mean() > 0.9
    assert frame[TOP:FOOT, RIGHT].mean() > 0.9
    dark = np.asarray((picture < 150.0).all(axis=2))
    for top, left in ((6, LEFT), (30, LEFT), (TOP, 6), (FOOT - 11, 6)):  # Title, heading, and both ends of the scale.
        rows, columns = np.nonzero(dark[top : top + 11, left : left + 50])
        assert rows.min() <= 4, (top, left)
        assert columns.min() <= 2, (top, left)
        assert not dark[top - 3 : top, left : left + 20].any(), (top, left)


def test_panels_stand_below_one_another_and_a_line_may_begin_later_and_be_wider(tmp_path: Path) -> None:
    late = Line("late", np.ones(40), BLUE, width=5, first=50)
    picture = drawn(tmp_path / "plot.png", {"one": [Line("flat", np.zeros(101), RED), late], "two": [late]})
    assert picture.shape == (24 + 440, 1100, 3)
    columns, rows = of(picture, BLUE)
    body = columns[np.abs(rows - np.median(rows)) <= 2]
    line = body[(body > 400)]
    assert line.min() == pytest.approx(LEFT + 50 * 10.24, abs=3)
    assert line.max() == pytest.approx(LEFT + 89 * 10.24, abs=3)
    assert np.ptp(rows[columns == 700]) + 1 == 5
    flat = of(picture, RED)
    assert np.ptp(flat[1][flat[0] == 700]) + 1 == 2
    assert flat[1][flat[0] == 700].mean() > rows[columns == 700].mean()
    second = picture[24 + 220 :]
    assert (np.abs(second - [0.0, 0.0, 255.0]) < 1).all(axis=2).any()


def test_names_stand_beside_the_heading_each_in_its_lines_colour(tmp_path: Path) -> None:
    lines = [Line("first", np.zeros(101), RED), Line("second", np.ones(101), BLUE)]
    picture = drawn(tmp_path / "plot.png", {"joint": lines})
    above = picture[24:TOP]
    red = np.nonzero(above[..., 0] > above[..., 2] + 60)[1]
    blue = np.nonzero(above[..., 2] > above[..., 0] + 60)[1]
    assert red.min() == pytest.approx(LEFT + 260, abs=3)
    assert blue.min() == pytest.approx(LEFT + 260 + 9 * len("first") + 8, abs=3)


def test_a_line_that_is_flat_has_a_millimetre_of_room_and_a_long_one_is_thinned(tmp_path: Path) -> None:
    picture = drawn(tmp_path / "plot.png", {"flat": [Line("flat", np.full(101, 0.5), RED)]})
    _, rows = of(picture, RED)
    assert np.median(rows) == pytest.approx((TOP + FOOT) / 2, abs=2)
    long = np.linspace(0.0, 1.0, 6001)
    values = np.zeros(6001)
    values[1::3] = 1.0  # Every third is drawn, of which each is 0; the range is of all.
    plot(tmp_path / "long.png", long, {"long": [Line("long", values, RED)]}, mark=0.0, title="")
    _, rows = of(np.asarray(Image.open(tmp_path / "long.png")).astype(float), RED)
    assert rows.min() > TOP + 150
