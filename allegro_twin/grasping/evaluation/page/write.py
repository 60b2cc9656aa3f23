"""From a table of results to one HTML file: no script, style, font or picture from anywhere else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.grasping.evaluation.page import sections
from allegro_twin.grasping.evaluation.page.rows import Columnar, Row, Rows
from allegro_twin.grasping.evaluation.page.style import SCRIPT, STYLE


def write_page(
    path: Path,
    results: Sequence[Row] | Columnar,
    *,
    title: str = "Grasp evaluation",
    about: Mapping[str, str] | None = None,
) -> None:
    """Write the report of some results, a row a grasp, with at least `object` and `held`.

    What else it knows: grasp, type, reason, `margin_…`, the metrics of `metrics.measure`, drift_mm, rotation_deg,
    success and n (under uncertainty), `picture` (a PNG, which goes into the page) and `rrd` (which is linked), both
    from here or from the page's folder; any other column is in the table. `about`: what the results depend on, such as
    engine, model, protocol and seeds. Raises ConfigError for a table that cannot be shown, RecordingError where the
    disk refuses.
    """
    text = page(results, path.parent, title=title, about=about)
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(results: Sequence[Row] | Columnar, folder: Path, *, title: str, about: Mapping[str, str] | None = None) -> str:
    """The same as text; `folder` is where it will lie."""
    rows = Rows(results)
    facts = " · ".join(f"{escape(key)} {escape(value)}" for key, value in (about or {}).items())
    parts = [
        f"<header><h1>{escape(title)}</h1><p class='soft'>{facts}</p></header>",
        sections.numbers(rows),
        sections.success(rows),
        sections.margins(rows),
        sections.metrics(rows),
        sections.pictures(rows, folder),
        sections.table(rows, folder),
    ]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>"
        f"<body><main>{''.join(parts)}</main><script>{SCRIPT}</script></body></html>\n"
    )
