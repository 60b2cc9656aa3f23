"""CSV tables that people give, as editors and spreadsheets write them."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from allegro_twin.errors import ConfigError


class CsvRow(NamedTuple):
    """A row of a table."""

    line: int
    """In the file, counted from 1."""
    values: list[str]
    """One for each name of the first line, without spaces around."""


class CsvTable(NamedTuple):
    """A table with a first line of names."""

    names: list[str]
    rows: list[CsvRow]


def parse_csv(content: bytes, path: Path) -> CsvTable:
    """A file's table in UTF-8, with or without the mark that Excel puts in front; lines without a value are left out.

    Raises ConfigError, one line, for what is no such text, a name twice, and a row with another number of values than
    there are names.
    """
    try:
        reader = csv.reader(StringIO(content.decode("utf-8-sig"), newline=""))
        found = [CsvRow(reader.line_num, [value.strip() for value in row]) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read as a table: {error}") from error
    found = [row for row in found if any(row.values)]
    names = found[0].values if found else []
    if twice := [name for k, name in enumerate(names) if name and name in names[:k]]:
        raise ConfigError(f"{path}: has the column {twice[0]!r} twice")
    rows = []
    for line, values in found[1:]:
        if len(values) < len(names) or any(values[len(names) :]):
            raise ConfigError(f"{path}:{line}: has {len(values)} values; the first line has {len(names)} names")
        rows.append(CsvRow(line, values[: len(names)]))
    return CsvTable(names, rows)
