"""Trials of many grasps: run them with progress, print the table, write results, pictures, recordings and the page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from allegro_twin.errors import ConfigError, HandError, HandFault, RecordingError, unknown
from allegro_twin.files.schema import parse_settings
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.surfaces.cli import console
from allegro_twin.surfaces.cli.options import Recordings

if TYPE_CHECKING:
    from rich.table import Table

    from allegro_twin.grasping.evaluation.campaign import EvaluationTarget, SamplingSettings
    from allegro_twin.sweep.jobs import Sweep
    from allegro_twin.sweep.local import SweepEngine

UNIT = 32
"""Most trials in a unit. More in one batch gain little, and an interruption would repeat more."""
STORED = 4
"""Units for each process at least, where finished ones are stored."""
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
TRIALS, REPORT, RESULTS = "trials", "report.html", "results.parquet"
"""What an evaluation writes into its folder."""
GONE_MARGIN = 10.0
"""Times a limit: beyond them the object is gone, and the number means nothing."""


_UNITS = {"position": 1e-3, "yaw": 1.0, "size": 1e-2, "mass": 1e-2, "torque": 1e-2}
"""From mm, degrees and per cent."""


class TrialTable(NamedTuple):
    """A sweep of trials and its results."""

    sweep: Sweep
    table: Any
    """A pyarrow.Table, one row for each trial."""
    rows: list[dict[str, Any]]


class Compute(NamedTuple):
    """An engine, and the number of units it computes at once."""

    engine: SweepEngine
    at_once: int


def engine_of(name: str, address: str | None, count: int | None) -> Compute:
    """The engine `local` or `ray`. Raises ConfigError without Ray, or for an address without it;
    LinkError if no cluster answers."""
    from allegro_twin.sweep.local import Local
    from allegro_twin.sweep.processors import core_count

    if address is not None and name != "ray":
        raise ConfigError("--address is of a Ray cluster: say --engine ray, too")
    at_once = count or core_count()
    if name == "ray":
        from allegro_twin.sweep.cluster import RayCluster

        return Compute(RayCluster(address), at_once)
    return Compute(Local(0 if at_once == 1 else at_once), at_once)


def run_trials(
    targets: Sequence[EvaluationTarget], noise: SamplingSettings, compute: Compute, out: Path | None = None
) -> TrialTable:
    """Run the trials; with `out` also their metrics, and finished ones are not repeated. Raises HandError; finished
    trials stay."""
    from allegro_twin.grasping.evaluation.campaign import JUDGE, make_campaign
    from allegro_twin.sweep.jobs import Sweep
    from allegro_twin.sweep.runner import run
    from allegro_twin.sweep.store import Store

    if out is not None and not (out / TRIALS).exists():
        foreign = next((out / name for name in (REPORT, RESULTS) if (out / name).exists()), None)
        if foreign is not None:
            said = "is of no evaluation, and is not replaced by one: move it away, or give another folder"
            raise RecordingError(f"{foreign}: {said}")
    items, shared, stamps, inputs = make_campaign(targets, noise, metrics=out is not None and _scipy())
    parts = compute.at_once if out is None else STORED * compute.at_once
    sweep = Sweep(JUDGE, items, shared, max(1, min(UNIT, -(-len(items) // parts))), stamps, inputs)
    store = None if out is None else Store(out / TRIALS, console.warn)
    ended = (0, len(sweep.items))
    with console.progress() as bar:
        task = bar.add_task("trials", total=len(sweep.items))

        def tell(done: int, total: int) -> None:
            nonlocal ended
            ended = (done, total)
            bar.update(task, completed=done, total=total)

        try:
            table = run(sweep, store, compute.engine, tell)
        except KeyboardInterrupt:
            kept = "none of them is kept" if out is None else f"they are in {out}, and the same command goes on"
            console.warn(f"interrupted: {ended[0]} of {ended[1]} trials had ended; {kept}")
            raise
    return TrialTable(sweep, table, table.to_pylist())


def report_trials(
    targets: Sequence[EvaluationTarget],
    noise: SamplingSettings,
    trials: TrialTable,
    out: Path | None,
    rrd: Recordings | None = None,
) -> list[dict[str, Any]]:
    """Print the table and write the files. Returns one row for each target. Raises HandError."""
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
        if column == "object" and (unlike := _unlike_objects(targets)):
            console.warn(f"no rates by object: {unlike} differs in mass or size between scenarios; see the rows")
        elif len(groups) < len(rows):
            said = "; ".join(f"{each.name} {each}" for each in groups)
            console.say(f"by {column}: {said}")
    if out is not None:
        (out / REPORT).unlink(missing_ok=True)  # No stale page while the new one is made.
        samples = sample_columns(targets, trials.sweep.items)
        write_results(out / RESULTS, trials.table, trials.sweep.all_stamps(), samples)
        if rrd is not None:
            _write_recordings(targets, rows, rrd, out / "recordings")
        _report(targets, rows, trials.sweep, out)
        console.say(f"In {out}/: {REPORT}, {RESULTS} with a row a trial")
    return rows


def _report(targets: Sequence[EvaluationTarget], rows: list[dict[str, Any]], sweep: Sweep, out: Path) -> None:
    from allegro_twin.app.portraits import worth_showing
    from allegro_twin.grasping.evaluation.html_report import write_html_report

    chosen, lost = worth_showing(rows), list[RecordingError]()
    with console.progress() as bar:
        task = bar.add_task("pictures", total=len(chosen))
        for number in chosen:
            path = out / "pictures" / f"{number}_{targets[number].name}.png"
            lost += _pictured(targets[number], rows[number], path)
            bar.advance(task)
    stamps = sweep.all_stamps()
    write_html_report(out / REPORT, rows, about={k: stamps[k] for k in stamps if k not in ("function", "shared")})
    if lost:
        raise lost[0]


def _pictured(target: EvaluationTarget, row: dict[str, Any], path: Path) -> list[RecordingError]:
    """Make a picture of a grasp. One that cannot be made is a note; returns the error of one that cannot be written."""
    from allegro_twin.app.portraits import portrait

    try:
        portrait(target, path)
        row["picture"] = str(path.resolve())
    except ImportError as error:
        console.warn(f"no pictures: {error}; pip install 'allegro-twin[view]'")
    except RecordingError as error:
        return [error]
    except HandError as error:
        console.warn(f"{target.name}: no picture: {error}")
    return []


def _table(rows: Sequence[dict[str, Any]], noise: SamplingSettings) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Table

    held = sum(row["held"] for row in rows)
    drawn = f"; draws: {noise.n}, seed {noise.seed}" if noise.n else ""
    figures = _figures(rows[0])
    close: dict[str, Any] = (
        {"box": SIMPLE_HEAD, "padding": 0} if "strength_n" in figures else {}
    )  # Else the table is too wide.
    title = f"{held} of {len(rows)} held under {rows[0]['protocol']}{drawn}"
    table = Table(title=title, title_style="bold", **close)
    two = len({row["side"] for row in rows}) > 1
    alike = _alike(rows)
    for name in (
        *(("scenario",) if alike else ()),
        "object",
        "grasp",
        *(("hand",) if two else ()),
        "held",
        *(("in draws",) if noise.n else ()),
    ):
        table.add_column(name, overflow="fold")
    for head in figures.values():
        table.add_column(head, justify="right", no_wrap=True)
    for row in rows:
        cells = [
            *([row["target"]] if alike else []),
            row["object"],
            row["grasp"],
            *([row["side"]] if two else []),
            *_held(row, drawn=noise.n > 0),
        ]
        table.add_row(*cells, *(_number(row.get(name), head) for name, head in figures.items()))
    failed = [
        f"{row['target'] + ': ' if alike else ''}{row['object']}, {row['grasp']}, {row['side']}: {row['reason']}"
        for row in rows
        if not row["held"]
    ]
    table.caption, table.caption_justify = escape("\n".join(failed)), "left"
    return table


def _alike(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether rows of different scenarios have the same object, grasp and hand, so that these do not tell them
    apart."""
    return len({(row["object"], row["grasp"], row["side"]) for row in rows}) < len(rows)


def _unlike_objects(targets: Sequence[EvaluationTarget]) -> str:
    """The names, with commas, of objects that are not the same in all targets that have one so named."""
    found: dict[str, set[str]] = {}
    for target in targets:
        scenario_object = target.case.scenario.objects[0]
        body = scenario_object.model_dump(mode="json", exclude={"file", "at", "yaw", "up"})
        file = None if scenario_object.file is None else str((target.case.folder / scenario_object.file).resolve())
        found.setdefault(scenario_object.name, set()).add(json.dumps([body, file]))
    return ", ".join(name for name, bodies in found.items() if len(bodies) > 1)


def _figures(row: dict[str, Any]) -> dict[str, str]:
    """Numeric columns and their heads; those of six directions only for protocols with them."""
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
        return "gone" if value < -GONE_MARGIN else f"{100 * value:.0f}"
    return console.millimetres(value / 1000.0) if head.endswith("mm") else f"{value:.1f}"


def _scipy() -> bool:
    from allegro_twin.grasping.metrics.quality import import_scipy

    try:
        import_scipy("optimize")
    except ConfigError as error:
        console.warn(str(error))  # The report has no metrics then.
        return False
    return True


def parse_variation(text: str) -> Uncertainty:
    """Parse `position=5,torque=0,friction=0.5-0.9`: half-widths in mm, degrees and per cent; friction as smallest and
    largest value, 0 for the scenario's own. Other keys keep their defaults. Raises ConfigError."""
    content: dict[str, object] = {}
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        key, _, value = (piece.strip() for piece in part.partition("="))
        if key not in (*_UNITS, "friction"):
            raise ConfigError("--vary: " + unknown("variation", key, (*_UNITS, "friction")))
        if key in content:
            raise ConfigError(f"--vary: {key} is given twice")
        try:
            content[key] = _friction(value) if key == "friction" else _UNITS[key] * float(value)
        except ValueError as error:
            way = "a number, or two as 0.5-0.9" if key == "friction" else "a number"
            raise ConfigError(f"--vary: {key}={value}: must be {way}") from error
    return parse_settings(Uncertainty, content, "--vary")


def _friction(text: str) -> tuple[float, float] | None:
    number: Callable[[str], float] = float
    low, _, high = text.partition("-")
    values = number(low), number(high or low)
    return None if values == (0.0, 0.0) else (min(values), max(values))


def check_recordings(out: Path | None) -> None:
    """Raise ConfigError if recordings have no folder or Rerun is not installed."""
    from allegro_twin.app.session import rerun_stage

    if out is None:
        raise ConfigError("--rrd is kept beside the report: say --out FOLDER, too")
    rerun_stage()


def _write_recordings(
    targets: Sequence[EvaluationTarget], rows: Sequence[dict[str, Any]], which: Recordings, folder: Path
) -> None:
    """Write a `.rrd` of each trial without a draw, and name it in its row; existing files stay. Raises HandError."""
    from allegro_twin.app.portraits import ends_of_objects

    chosen = list(range(len(rows))) if which is Recordings.all else ends_of_objects(rows)
    paths = []
    with console.progress() as bar:
        for number in bar.track(chosen, description="recordings"):
            path = folder / f"{number}_{targets[number].name}.rrd"
            if path.is_file() or _write_recording(targets[number], rows[number], path):
                rows[number]["rrd"] = str(path.resolve())
                paths.append(path)
        seconds = bar.tasks[0].elapsed or 0.0
    size = sum(path.stat().st_size for path in paths) / 1e6
    said = f"{len(paths)} recordings, {size:.1f} MB, in {seconds:.0f} s: rerun {folder}/NAME.rrd"
    console.console.print(said, soft_wrap=True, highlight=False)


def _write_recording(target: EvaluationTarget, row: Mapping[str, Any], path: Path) -> bool:
    """Write one recording. Returns whether there is one: if the guard stops the hand there is none."""
    from allegro_twin.app.config import RunConfig
    from allegro_twin.app.portraits import staged
    from allegro_twin.app.session import Outputs, perform
    from allegro_twin.app.simulated import following
    from allegro_twin.hands.settings import HandSettings

    hand = HandSettings(model=target.spec.model, side=target.side)
    config = RunConfig.model_validate(
        {"hand": hand.model_dump(), "backend": {"kind": "sim"}, "controller": following(hand)}
    )
    try:
        outcome = perform(staged(target, row), config, Outputs(rrd=path))
    except HandFault as error:
        console.warn(f"{target.name}: no recording: {error}")
        return False
    if outcome.unwritten:
        raise RecordingError(outcome.unwritten)
    return True
