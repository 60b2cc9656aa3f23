"""The command that runs a hand: a config with its controller, or scenarios with a verdict on each."""

from __future__ import annotations

from contextlib import closing
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allegro_twin.errors import ConfigError, LinkError
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.options import OtherHand
from allegro_twin.surfaces.cli.run import looking

if TYPE_CHECKING:
    from allegro_twin.app.session import Outputs
    from allegro_twin.grasping.verdict import TrialReport
    from allegro_twin.surfaces.cli.run.runs import Options


REPORT = "report.json"
"""Of the trials in a folder."""


class Sides(StrEnum):
    right = "right"
    left = "left"
    both = "both"


def _file(text: str, *suffixes: str) -> Any:
    return typer.Option(help=text, callback=options.file(*suffixes))


Targets = Annotated[
    list[str],
    typer.Argument(
        help="Configs, scenarios, or folders of scenarios; a name will do.", autocompletion=complete.targets
    ),
]
Side = Annotated[Sides | None, typer.Option(help="The right hand, the left one, or one after the other.")]
Performer = Annotated[
    str | None,
    typer.Option(
        "--config", "-c", help="The config of the hand that performs scenarios.", autocompletion=complete.configs
    ),
]
OtherGrasp = Annotated[
    str | None, typer.Option(help="Another grasp than the scenario's.", autocompletion=complete.grasps)
]
OtherObject = Annotated[
    str | None,
    typer.Option(
        "--object",
        help="Another object than the scenario's first: of the catalogue, or an .obj or .stl.",
        autocompletion=complete.objects,
    ),
]
Policy = Annotated[
    str | None,
    typer.Option(help="A policy file (.onnx, .zip) that decides instead.", autocompletion=complete.policies),
]
Goal = Annotated[
    str | None, typer.Option(help="For a policy that reaches goals: a posture.", autocompletion=complete.postures)
]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder for a recording, a picture and a report of each run; takes the place of the run before.",
        callback=options.folder,
    ),
]
Record = Annotated[Path | None, _file("Record to this .arrow file.", ".arrow")]
Image = Annotated[Path | None, _file("Render to this .png.", ".png")]
Video = Annotated[Path | None, _file("Render to this .mp4.", ".mp4")]
Rrd = Annotated[Path | None, _file("Write a Rerun recording to this .rrd.", ".rrd")]
WireLog = Annotated[
    Path | None,
    _file("Log every frame of the hand's bus to this .blf, .log or .asc.", ".blf", ".log", ".asc"),
]
Size = Annotated[str, typer.Option(help="Of pictures and films: WIDTHxHEIGHT in pixels.")]
View = Annotated[bool, typer.Option(help="Watch live in Rerun's own window.")]
Web = Annotated[bool, typer.Option(help="Watch live in the browser.")]
Seconds = Annotated[
    float | None, typer.Option(help="Stop after this time on the hand's clock.", callback=options.positive)
]
Partial = Annotated[bool, typer.Option(help="Replay what is readable of a recording that was cut short.")]
Count = Annotated[
    int | None,
    typer.Option("--jobs", min=1, help="How many simulated runs at once; by default as many as there are cores."),
]


def register(app: typer.Typer) -> None:
    """Add this command to the command line."""
    app.command()(run)


def run(
    targets: Targets,
    side: Side = None,
    hand: OtherHand = None,
    config: Performer = None,
    grasp: OtherGrasp = None,
    thing: OtherObject = None,
    policy: Policy = None,
    goal: Goal = None,
    out: Out = None,
    record: Record = None,
    image: Image = None,
    video: Video = None,
    rrd: Rrd = None,
    wire_log: WireLog = None,
    size: Size = "480x480",
    camera: looking.Camera = "side",
    view: View = False,
    web: Web = False,
    seconds: Seconds = None,
    partial: Partial = False,
    count: Count = None,
) -> None:
    """Run a hand: a config with its controller, or scenarios with a verdict on each."""
    from allegro_twin.app.session import Outputs
    from allegro_twin.surfaces.cli.run.runs import Options
    from allegro_twin.viewing import views

    if view and web:
        raise ConfigError("--view and --web are two ways to watch one run: choose one")
    live = "web" if web else "native" if view else None
    outputs = Outputs(record, image, video, rrd, live, wire_log, views.size(size), views.checked(camera))
    chosen = Options(side and side.value, hand, config, grasp, thing, policy, goal, seconds, partial)
    if not _reports(targets, chosen, outputs, out, count):
        raise typer.Exit(5)


def _reports(targets: list[str], chosen: Options, outputs: Outputs, out: Path | None, count: int | None) -> bool:
    """Do it all; whether every run did what it was for."""
    from allegro_twin.surfaces.cli.run.runs import configs_of
    from allegro_twin.surfaces.cli.run.several import Wanted
    from allegro_twin.sweep.local import core_count

    jobs = configs_of(targets, chosen)
    single = (outputs.record, outputs.image, outputs.video, outputs.rrd, outputs.wire_log, outputs.live)
    if len(jobs) > 1 and any(single):
        raise ConfigError(f"{len(jobs)} runs cannot share one output; use --out FOLDER")
    if out is None:
        return _run_all(jobs, Wanted(outputs, None), count or core_count())[1]
    with options.run_folder(out, REPORT) as staging:
        reports, done = _run_all(jobs, Wanted(outputs, staging), count or core_count())
        shown = _written(reports, staging)
    _tell_folder(reports, out, shown=shown)
    return done


def _run_all(jobs: list[Any], wanted: Any, count: int) -> tuple[dict[tuple[str, str], TrialReport], bool]:
    """The verdicts, and whether every run did what it was for."""
    from rich.markup import escape

    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.run.several import run_all

    reports: dict[tuple[str, str], TrialReport] = {}
    grasps: dict[str, str] = {}
    told: set[str] = set()
    done = True

    def tell(line: str) -> None:
        console.errors.print(line, soft_wrap=True)

    with console.progress() as bar, closing(run_all(jobs, wanted, count, bar, tell)) as runs:
        for job, ran in runs:
            for note in ran.outcome.notes:
                if note not in told:
                    console.errors.print(f"[yellow]{job.name} {ran.spec.side}: {escape(note)}[/]")
                told.add(note)
            if ran.outcome.unconfirmed:
                raise LinkError(ran.outcome.unconfirmed)
            if ran.outcome.report is None:
                console.console.print(console.final_state(ran.spec, ran.outcome.last))
                cut = job.cut and ran.outcome.last.t < ran.outcome.motion  # Then it was not asked to arrive.
                if ran.outcome.missed and not cut:
                    done = False
                    console.warn(f"{job.name}, {ran.spec.side} hand: {ran.outcome.missed}")
            else:
                reports[job.name, ran.spec.side], grasps[job.name] = ran.outcome.report, ran.grasp
    _tell(reports, grasps)
    return reports, done and all(report.held for report in reports.values())


def _tell(reports: dict[tuple[str, str], TrialReport], grasps: dict[str, str]) -> None:
    """The table at the end."""
    from allegro_twin.surfaces.cli import console

    if len(reports) == 1:
        (((name, side), report),) = reports.items()
        console.console.print(console.phases(f"{name}, {side} hand", report))
    elif reports:
        from allegro_twin.sim.engine.backend import ENGINE

        console.console.print(console.summary(reports, grasps, ENGINE))


def _written(reports: dict[tuple[str, str], TrialReport], folder: Path) -> bool:
    """Write the verdicts and an overview of the pictures; whether there are any."""
    from allegro_twin.grasping.evaluation.rejudge import write_reports
    from allegro_twin.viewing.stills import picture_all

    if not reports:
        return False
    names = {f"{name}_{side}": report for (name, side), report in reports.items()}
    write_reports(folder / REPORT, names)
    return picture_all(folder, names) is not None


def _tell_folder(reports: dict[tuple[str, str], TrialReport], out: Path, *, shown: bool) -> None:
    from allegro_twin.surfaces.cli import console

    if not reports:
        return
    what = f"a recording of each run, {REPORT}{', pictures, overview.png' if shown else ''}"
    console.console.print(f"In {out}/: {what}", soft_wrap=True)
    name, side = next(iter(reports))
    console.console.print(f"Look at one in the browser: allegro-twin view {out}/{name}_{side}.arrow --web")
