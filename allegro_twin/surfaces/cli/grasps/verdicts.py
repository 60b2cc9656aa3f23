"""Many trials on the command line: progress while they are made, then a table, files, pictures and the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from allegro_twin.errors import ConfigError, HandError
from allegro_twin.surfaces.cli import console
from allegro_twin.surfaces.cli.recorded.recordings import Recorded, record

if TYPE_CHECKING:
    from rich.table import Table

    from allegro_twin.grasping.evaluation.campaign import EvaluationTarget, SamplingSettings
    from allegro_twin.sweep.jobs import Sweep
    from allegro_twin.sweep.local import SweepEngine

UNIT = 32
"""Trials in a unit at most: more side by side gain little, and more would be made again after an interruption."""
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
FLOWN = 10.0
"""Times a limit, and FAR mm: beyond, the object is gone, and by how far says nothing."""
FAR = 1000.0


class Tried(NamedTuple):
    """Trials that were made."""

    sweep: Sweep
    table: Any
    """A pyarrow.Table, a row a trial."""
    rows: list[dict[str, Any]]


class Chosen(NamedTuple):
    """What computes, and how much of it at once."""

    engine: SweepEngine
    at_once: int


def engine_of(name: str, address: str | None, count: int | None) -> Chosen:
    """`local` or `ray`. Raises ConfigError where Ray is not installed, or for an address without it; LinkError where no
    cluster answers."""
    from allegro_twin.sweep.local import Local, core_count

    if address is not None and name != "ray":
        raise ConfigError("--address is of a Ray cluster: say --engine ray, too")
    at_once = count or core_count()
    if name == "ray":
        from allegro_twin.sweep.cluster import RayCluster

        return Chosen(RayCluster(address), at_once)
    return Chosen(Local(0 if at_once == 1 else at_once), at_once)


def tried(
    targets: Sequence[EvaluationTarget], noise: SamplingSettings, chosen: Chosen, out: Path | None = None
) -> Tried:
    """Make the trials, with metrics where something is to be kept; those that are kept already are not made again.
    Raises HandError; what was finished stays."""
    from allegro_twin.grasping.evaluation.campaign import JUDGE, make_campaign
    from allegro_twin.sweep.jobs import Sweep
    from allegro_twin.sweep.runner import run
    from allegro_twin.sweep.store import Store

    items, shared, stamps, inputs = make_campaign(targets, noise, metrics=out is not None and _scipy())
    sweep = Sweep(JUDGE, items, shared, max(1, min(UNIT, -(-len(items) // chosen.at_once))), stamps, inputs)
    store = None if out is None else Store(out / "trials", console.warn)
    with console.progress() as bar:
        task = bar.add_task("trials", total=len(sweep.items))
        table = run(sweep, store, chosen.engine, lambda done, total: bar.update(task, completed=done, total=total))
    return Tried(sweep, table, table.to_pylist())


def told(
    targets: Sequence[EvaluationTarget],
    noise: SamplingSettings,
    trials: Tried,
    out: Path | None,
    rrd: Recorded | None = None,
) -> list[dict[str, Any]]:
    """Show the table and write the files; the rows, one a target. Raises HandError."""

    from allegro_twin.grasping.evaluation.outcomes import rates, sample_columns, summarise
    from allegro_twin.sweep.table import write_results

    rows = summarise(targets, trials.rows)
    console.console.print(_table(rows, noise))
    errors = [row["error"] for row in trials.rows if row["error"] is not None]
    if errors:
        said = f"{len(errors)} of {len(trials.rows)} trials could not be made; the first: {errors[0]}"
        console.warn(said)
    for column in ("object", "grasp", "hand"):
        groups = rates(rows, column)
        if len(groups) < len(rows):
            said = "; ".join(f"{each.name} {each}" for each in groups)
            console.console.print(f"by {column}: {said}", soft_wrap=True, highlight=False)
    if out is not None:
        (out / "report.html").unlink(missing_ok=True)  # Until the new one is there, none says what other trials were.
        write_results(out / "results.parquet", trials.table, trials.sweep.all_stamps(),
                      sample_columns(targets, trials.sweep.items))  # fmt: skip
        if rrd is not None:
            record(targets, rows, rrd, out / "recordings")
        _report(targets, rows, trials.sweep, out)
        console.console.print(f"In {out}/: report.html, results.parquet with a row a trial", soft_wrap=True)
    return rows


def _report(targets: Sequence[EvaluationTarget], rows: list[dict[str, Any]], sweep: Sweep, out: Path) -> None:
    from allegro_twin.app.portraits import worth_showing
    from allegro_twin.grasping.evaluation.html_report import write_html_report

    chosen = worth_showing(rows)
    with console.progress() as bar:
        task = bar.add_task("pictures", total=len(chosen))
        for number in chosen:
            _pictured(targets[number], rows[number], out / "pictures" / f"{number}_{targets[number].name}.png")
            bar.advance(task)
    stamps = sweep.all_stamps()
    write_html_report(
        out / "report.html", rows, about={k: stamps[k] for k in stamps if k not in ("function", "shared")}
    )


def _pictured(target: EvaluationTarget, row: dict[str, Any], path: Path) -> None:
    """A picture that cannot be made is a note: it is not what the trial is for."""
    from allegro_twin.app.portraits import portrait

    try:
        portrait(target, path)
        row["picture"] = str(path.resolve())
    except ImportError as error:
        console.errors.print(f"[yellow]no pictures: {error}; pip install 'allegro-twin[view]'[/]")
    except HandError as error:
        console.errors.print(f"[yellow]{target.name}: no picture: {error}[/]")


def _table(rows: Sequence[dict[str, Any]], noise: SamplingSettings) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Table

    held = sum(row["held"] for row in rows)
    drawn = f"; draws: {noise.n}, seed {noise.seed}" if noise.n else ""
    figures = _figures(rows[0])
    close: dict[str, Any] = {"box": SIMPLE_HEAD, "padding": 0} if "strength_n" in figures else {}  # Else too wide.
    title = f"{held} of {len(rows)} held under {rows[0]['protocol']}{drawn}"
    table = Table(title=title, title_style="bold", **close)
    two = len({row["side"] for row in rows}) > 1
    for name in ("object", "grasp", *(("hand",) if two else ()), "held", *(("in draws",) if noise.n else ())):
        table.add_column(name, overflow="fold")
    for head in figures.values():
        table.add_column(head, justify="right", no_wrap=True)
    for row in rows:
        cells = [row["object"], row["grasp"], *([row["side"]] if two else []), *_held(row, drawn=noise.n > 0)]
        table.add_row(*cells, *(_number(row.get(name), head) for name, head in figures.items()))
    failed = [f"{row['object']}, {row['grasp']}, {row['side']}: {row['reason']}" for row in rows if not row["held"]]
    table.caption, table.caption_justify = escape("\n".join(failed)), "left"
    return table


def _figures(row: dict[str, Any]) -> dict[str, str]:
    """Columns with numbers, and their heads: those of six directions only where there are any."""
    ways = {f"margin_{axis}": f"{axis}\n%" for axis in AXES} | {"strength_n": "holds\nN"}
    always = {"margin": "margin\n%", "drift_mm": "drift\nmm", "penetration_mm": "inside\nmm", "contacts": "con-\ntacts",
              "stall": "stall\n%"}  # fmt: skip
    return always | (ways if "strength_n" in row else {})


def _held(row: dict[str, Any], *, drawn: bool) -> list[str]:
    from allegro_twin.grasping.evaluation.outcomes import row_rate

    return ["[green]yes[/]" if row["held"] else "[red]no[/]", *([str(row_rate(row))] if drawn else [])]


def _number(value: float | None, head: str) -> str:
    if value is None or value != value:
        return "–"
    if head.endswith("%"):
        return "gone" if value < -FLOWN else f"{100 * value:.0f}"
    return "gone" if value > FAR else f"{value:.1f}"


def _scipy() -> bool:
    from allegro_twin.grasping.metrics.quality import import_scipy

    try:
        import_scipy("optimize")
    except ConfigError as error:
        console.errors.print(f"[yellow]{error}[/]")  # The rest of the report is there without them.
        return False
    return True
