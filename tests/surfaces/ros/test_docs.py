"""The table in docs/reference/topics.md is the bridge's."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.surfaces.ros import cell_topics as cell
from allegro_twin.surfaces.ros.hand_topics import PUBLISHED, SUBSCRIBED

DOCS = Path(__file__).resolve().parents[3] / "docs" / "reference" / "topics.md"


def test_the_table_of_topics_is_the_one_that_is_used() -> None:
    rows = [line for line in DOCS.read_text().splitlines() if line.startswith("| `")]
    every = [("out", PUBLISHED), ("in", SUBSCRIBED), ("out", cell.PUBLISHED), ("in", cell.SUBSCRIBED)]
    every.append(("out", (cell.PLANNING,)))
    for direction, entries in every:
        for name, kind, quality, what in entries:
            latched = "yes" if quality.latched else ""
            row = f"| `{name}` | `{kind}` | {quality.depth} | {latched} | {direction} | {what} |".replace("|  |", "| |")
            assert row in rows
    assert len(rows) == sum(len(entries) for _, entries in every)
