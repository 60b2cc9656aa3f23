"""The learning curve as a CSV file, a row an update, that a killed and continued training leaves without a seam."""

from __future__ import annotations

import csv
from pathlib import Path

from allegro_twin.files.atomic_write import whole_file

COLUMNS = ("steps", "seconds", "episodes", "return", "length", "success", "evaluated")
"""Actions in all; s of training; episodes that ended since the last row; their mean return and length and the share
that went well; and the success rate without noise on the actions, once a round. Empty: nothing to tell."""


class Curve:
    """Goes on after the rows up to `steps`; what a killed training wrote behind them is done again."""

    def __init__(self, path: Path, steps: int) -> None:
        kept: list[dict[str, str]] = []
        if steps and path.is_file():
            with path.open(newline="") as file:
                rows = [row for row in csv.DictReader(file) if None not in row.values()]  # The last may be cut.
                kept = [row for row in rows if int(row["steps"]) <= steps]
        self._path = path
        with whole_file(path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(kept)

    def add(self, **values: float | int | None) -> None:
        row = {name: value if isinstance(value, int) else f"{value:.6g}" for name, value in values.items()
               if value is not None}  # fmt: skip
        with self._path.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(row)
