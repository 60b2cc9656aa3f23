"""Tables that people give are read as spreadsheets write them, and what is wrong is one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.csv_table import parse_csv

PATH = Path("a.csv")


def test_a_table_is_read_with_excels_mark_spaces_and_lines_without_a_value() -> None:
    names, rows = parse_csv(b"\xef\xbb\xbfname, x\r\n\r\na, 1,\r\n,\r\nb,2\r\n", PATH)
    assert names == ["name", "x"]
    assert rows == [(3, ["a", "1"]), (5, ["b", "2"])]
    assert parse_csv(b"", PATH) == ([], [])


def test_a_value_has_whatever_signs_it_has_and_lines_end_as_on_any_computer() -> None:
    table = parse_csv('name,x\r"left\u2028hand\nof mine",1\rb\x0bc,2\r'.encode(), PATH)
    assert [row.values for row in table.rows] == [["left\u2028hand\nof mine", "1"], ["b\x0bc", "2"]]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"name,x\na\n", r"a\.csv:2: has 1 values; the first line has 2 names"),
        (b"name,x\na,1,5\n", r"a\.csv:2: has 3 values; the first line has 2 names"),
        (b"name,x,x\na,1,5\n", r"a\.csv: has the column 'x' twice"),
        ("name,x\n".encode("utf-16"), r"a\.csv: cannot be read as a table: 'utf-8' codec"),
    ],
)
def test_what_is_wrong_with_a_table_is_one_line(content: bytes, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as error:
        parse_csv(content, PATH)
    assert "\n" not in str(error.value)
