"""The report of an evaluation as one HTML file: no script, style, font or picture from anywhere else."""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Protocol, TypeAlias
from urllib.parse import quote

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.grasping.evaluation.outcomes import make_rate
from allegro_twin.grasping.statistics import wilson
from allegro_twin.types import Array
from allegro_twin.viewing.report import html_page, rate_chart, scatter_chart, strip_chart

Row: TypeAlias = Mapping[str, Any]
METRICS = {
    "epsilon": True, "volume": True, "lp": True, "qp": False, "carry": False, "least_torque": False,
    "torque_share": False,
    "penetration_mm": False, "drift_mm": False, "rotation_deg": False, "contacts": True,
}  # fmt: skip
"""Columns that are held against the outcome, and whether more is better."""
FLOWN = {"drift_mm": 100.0}
"""Where a chart ends: beyond, the object is gone, and by how far says nothing. Margins end at -1."""
SHOWN_PICTURES, SHOWN_ROWS = 6, 2000
"""Pictures on either side, and rows of the table, at most."""


def write_html_report(
    path: Path,
    results: Sequence[Row] | Columnar,
    *,
    title: str = "Grasp evaluation",
    about: Mapping[str, str] | None = None,
) -> None:
    """Write the report of some results, a row a grasp, with at least `object` and `held`.

    What else it knows: grasp, type, reason, `margin_…`, the metrics of `trial_metrics`, drift_mm, rotation_deg,
    success and n (under uncertainty), `picture` (a PNG, which goes into the page) and `rrd` (which is linked), both
    from here or from the page's folder; any other column is in the table. `about`: what the results depend on, such as
    engine, model, protocol and seeds. Raises ConfigError for a table that cannot be shown, RecordingError where the
    disk refuses.
    """
    text = html_report(results, path.parent, title=title, about=about)
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def html_report(
    results: Sequence[Row] | Columnar, folder: Path, *, title: str, about: Mapping[str, str] | None = None
) -> str:
    """Report of some results as text, a row a grasp; `folder` is where it will lie."""
    table = ResultTable(results)
    facts = " · ".join(f"{key} {value}" for key, value in (about or {}).items())
    parts = (_numbers(table), _success(table), _margins(table), _metrics(table), _pictures(table, folder),
             _all_results(table, folder))  # fmt: skip
    return html_page(title, facts, parts)


class Columnar(Protocol):
    """A table that can be had as rows: one of PyArrow, say."""

    def to_pylist(self) -> list[dict[str, Any]]: ...


class ResultTable:
    """Results, a row a grasp. Raises ConfigError without any, and where a row says nothing of its object or outcome."""

    def __init__(self, given: Sequence[Row] | Columnar) -> None:
        self.all: list[Row] = [*(given if isinstance(given, Sequence) else given.to_pylist())]
        if not self.all:
            raise ConfigError("a report needs at least one result")
        self.columns = list(dict.fromkeys(key for row in self.all for key in row))
        for needed in ("object", "held"):
            bare = [number for number, row in enumerate(self.all) if row.get(needed) is None]
            if bare:
                raise ConfigError(f"result {bare[0]} has no `{needed}`; a report needs it in every row")
        self.held: Array = np.array([float(bool(row["held"])) for row in self.all])

    def __len__(self) -> int:
        return len(self.all)

    def numbers(self, column: str) -> Array:
        """(k,); NaN where a row has no number there."""
        return np.array([_number(row.get(column)) for row in self.all])

    def starting(self, prefix: str) -> list[str]:
        """Columns by how their name begins, in their order."""
        return [column for column in self.columns if column.startswith(prefix)]

    def groups(self, column: str) -> Iterator[tuple[str, list[int]]]:
        """The rows of each value of a column, in the order in which the values first come."""
        found: dict[str, list[int]] = {}
        for number, row in enumerate(self.all):
            if row.get(column) is not None:
                found.setdefault(str(row[column]), []).append(number)
        yield from found.items()

    def tried(self) -> tuple[Array, Array] | None:
        """Successes and draws of each row under uncertainty; None where the table has none."""
        share, draws = self.numbers("success"), self.numbers("n")
        if np.isnan(share * draws).all():
            return None
        known = ~np.isnan(share * draws)
        return np.where(known, np.rint(share * draws), 0.0), np.where(known, draws, 0.0)

    def goodness(self) -> Array:
        """What rows are ranked by, (k,): the rate under uncertainty, or held; then the least margin; then ε."""
        first = np.nan_to_num(self.numbers("success"), nan=-1.0) + self.held
        margins = [self.numbers(column) for column in self.starting("margin_")]
        least = np.nan_to_num(np.min(margins, axis=0), nan=-1e3) if margins else np.zeros(len(self))
        ball = np.nan_to_num(self.numbers("epsilon"), nan=0.0)
        place = np.empty(len(self))
        place[np.lexsort((ball, least, first))] = np.arange(len(self))
        return place


def auc(values: Array, outcome: Array) -> float:
    """The area under the ROC curve: how often a success has the larger value than a failure, a tie counting half.

    From ranks, (R₊ − n₊(n₊ + 1)/2) / (n₊ n₋), where equal values share their mean rank (Hanley and McNeil, Radiology
    143, 1982). `values`: (k,), NaN where there is none, which is left out; `outcome`: (k,), true where it succeeded.
    NaN where all that is left had the same outcome.
    """
    known = ~np.isnan(values)
    figures, good = values[known], outcome[known].astype(bool)
    above, below = int(good.sum()), int((~good).sum())
    if not above or not below:
        return math.nan
    _, place, count = np.unique(figures, return_inverse=True, return_counts=True)
    rank = (np.cumsum(count) - (count - 1) / 2.0)[place]
    return float((rank[good].sum() - above * (above + 1) / 2.0) / (above * below))


def _numbers(rows: ResultTable) -> str:
    """The whole in a few figures."""
    held, low, high = int(rows.held.sum()), *wilson(int(rows.held.sum()), len(rows))
    objects = list(rows.groups("object"))
    any_held = sum(bool(rows.held[chosen].any()) for _, chosen in objects)
    items = [
        (f"{held} of {len(rows)}", f"held: {100 * held / len(rows):.0f} % ({100 * low:.0f}–{100 * high:.0f} %)"),
        (f"{any_held} of {len(objects)}", "objects with a grasp that held"),
    ]
    tried = rows.tried()
    if tried is not None:
        won, draws = int(tried[0].sum()), int(tried[1].sum())
        part = wilson(won, draws)
        items.append((f"{100 * won / draws:.0f} %", f"of {draws} draws under uncertainty ({_percent(part)})"))
    figures = "".join(f"<li><b>{escape(value)}</b>{escape(said)}</li>" for value, said in items)
    return f'<ul class="numbers">{figures}</ul>'


def _success(rows: ResultTable) -> str:
    """Rates by object and by type, with Wilson intervals; nominal, and under uncertainty."""
    found = []
    for column in ("object", "type"):
        groups = list(rows.groups(column))
        if not groups:
            continue
        chart = [make_rate(label, int(rows.held[k].sum()), len(k)) for label, k in groups]
        found.append(f"<h2>Held, by {column}</h2><p class='soft'>A dot is the share of grasps that held, the line its "
                     f"95 % Wilson interval.</p>{rate_chart(chart, f'Held by {column}')}")  # fmt: skip
        tried = rows.tried()
        if tried is not None:
            drawn = [make_rate(label, int(tried[0][k].sum()), int(tried[1][k].sum())) for label, k in groups]
            found.append(f"<h3>Under uncertainty</h3><p class='soft'>All draws of all grasps of one {column} together."
                         f"</p>{rate_chart(drawn, f'Success under uncertainty by {column}')}")  # fmt: skip
    return "".join(found)


def _margins(rows: ResultTable) -> str:
    """How much of what is allowed was left, direction by direction."""
    names = rows.starting("margin_")
    if not names:
        return ""
    chart = [(name.removeprefix("margin_"), np.maximum(rows.numbers(name), -1.0)) for name in names]
    return (
        "<h2>Margins</h2><p class='soft'>What was left of each limit: 0 is the limit itself, -1 twice as far or gone. "
        f"Dots held, crosses did not; the upright line is the median.</p>{strip_chart(chart, rows.held, 'Margins')}"
    )


def _metrics(rows: ResultTable) -> str:
    """Each figure of the contacts against what came of the grasp."""
    tried, cards = rows.numbers("success"), []
    outcome, said = (rows.held, "held") if np.isnan(tried).all() else (tried, "success rate")
    for name, more in METRICS.items():
        values = rows.numbers(name)
        if np.isnan(values).all():
            continue
        area = auc(values if more else -values, rows.held)
        chart = scatter_chart(np.minimum(values, FLOWN.get(name, np.inf)), outcome, rows.held, name, name)
        figure = "–" if math.isnan(area) else f"{area:.2f}"
        cards.append(f"<figure><h3>{escape(name)}: AUC {figure}</h3><figcaption class='soft'>"
                     f"{'more' if more else 'less'} is taken as better</figcaption>{chart}</figure>")  # fmt: skip
    if not cards:
        return ""
    return (
        f"<h2>Metrics against outcome</h2><p class='soft'>Upwards: {said}. AUC: how often a grasp that held has the "
        f"better figure than one that did not, from ranks; 0.5 says nothing.</p>"
        f"<div class='cards'>{''.join(cards)}</div>"
    )


def _pictures(rows: ResultTable, folder: Path) -> str:
    """The best and the worst that have a picture. Raises ConfigError for a picture that is not there."""
    order = np.argsort(-rows.goodness(), kind="stable")
    seen = [int(k) for k in order if rows.all[k].get("picture")]
    if not seen:
        return ""
    best = [k for k in seen[: max(SHOWN_PICTURES, len(seen) // 2)] if rows.held[k]][:SHOWN_PICTURES]
    worst = [k for k in reversed(seen) if k not in best][:SHOWN_PICTURES]
    return "".join(
        f"<h2>{name}</h2><div class='cards'>{''.join(_picture(rows.all[k], folder) for k in chosen)}</div>"
        for name, chosen in (("Best", best), ("Worst", worst))
        if chosen
    )


def _all_results(rows: ResultTable, folder: Path) -> str:
    """Every row, to be sorted by any column; recordings as links."""
    columns = [column for column in rows.columns if column != "picture"]
    heads = "".join(f'<th scope="col"><button type="button">{escape(c)}</button></th>' for c in columns)
    lines = ("".join(_cell(c, row.get(c), folder) for c in columns) for row in rows.all[:SHOWN_ROWS])
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    films = " A recording opens with <code>rerun FILE</code>." if "rrd" in columns else ""
    rest = f" The first {SHOWN_ROWS} of {len(rows)}; the table's own file has all." if len(rows) > SHOWN_ROWS else ""
    return (
        "<h2>All results</h2><div class='wide' tabindex='0' role='region' aria-label='All results'>"
        f"<table class='sortable'><caption class='soft'>A column's name sorts by it.{films}{rest}</caption>"
        f"<thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _percent(part: tuple[float, float]) -> str:
    return f"{100 * part[0]:.0f}–{100 * part[1]:.0f} %"


def _picture(row: Row, folder: Path) -> str:
    path = Path(str(row["picture"]))
    try:
        content = (path if path.is_absolute() or path.is_file() else folder / path).read_bytes()
    except OSError as error:
        raise ConfigError(f"picture {path} of a result cannot be read: {error.strerror or error}") from error
    if not content.startswith(b"\x89PNG"):
        raise ConfigError(f"picture {path} of a result is no PNG")
    name = " · ".join(str(row[key]) for key in ("grasp", "object") if row.get(key) is not None)
    facts = [] if row.get("success") is None else [_in_draws(float(row["success"]), row.get("n"))]
    facts.append("held" if row["held"] else f"not held: {row.get('reason') or 'no reason given'}")
    return (
        f'<figure><img alt="{escape(name)}" src="data:image/png;base64,{base64.b64encode(content).decode()}">'
        f"<figcaption><b>{escape(name)}</b><br>{escape(', '.join(facts))}"
        f"{_link(row.get('rrd'), folder, ', ')}</figcaption></figure>"
    )


def _in_draws(success: float, n: int | None) -> str:
    if not n:
        return f"{shown(success)} success"
    won = round(success * n)
    return f"{won} of {n} draws ({_percent(wilson(won, n))})"


def _cell(column: str, value: object, folder: Path) -> str:
    if column == "rrd":
        return f"<td data-v='{escape(str(value or ''))}'>{_link(value, folder)}</td>"
    said = escape(shown(value))
    if isinstance(value, bool | np.bool_):
        return f"<td class='{said}' data-v='{int(value)}'>{said}</td>"
    if isinstance(value, int | float | np.number):
        sortable = "" if said == "–" else repr(float(value))
        return f"<td class='n' data-v='{sortable.replace('inf', 'Infinity')}'>{said}</td>"
    return f"<td data-v='{'' if value is None else said}'>{said}</td>"


def _link(value: object, folder: Path, before: str = "") -> str:
    """To a recording, from where the page is."""
    if not value:
        return ""
    path = Path(str(value))
    place = Path(os.path.relpath(path, folder)) if path.is_absolute() or path.is_file() else path
    size = f", {path.stat().st_size / 1e6:.1f} MB" if path.is_file() else ""
    return f'{before}<a href="{quote(place.as_posix())}">recording{size}</a>'


def shown(value: object) -> str:
    """A value as a person wants to read it."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if value is None or (isinstance(value, float | np.floating) and math.isnan(value)):
        return "–"
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    return str(value)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float | np.number | np.bool_) else math.nan
