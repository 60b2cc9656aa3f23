"""The command line. Exit codes: 0 done, 2 config, file or usage, 3 link, 4 fault or a motion that met something, 5 the
grasp failed, 130 interrupted."""

from __future__ import annotations

import logging
import sys
from contextlib import closing
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allegro_twin.cli import (
    bus,
    complete,
    ends,
    evaluating,
    exchange,
    live,
    looking,
    options,
    planning,
    shipped,
    training,
    twin,
)
from allegro_twin.cli.options import OtherHand
from allegro_twin.errors import ConfigError, HandError, LinkError
from allegro_twin.version import __version__

if TYPE_CHECKING:
    from allegro_twin.evaluate.held import Report

app = typer.Typer(
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="A digital twin of the Wonik Allegro Hand. A config (conf/*.yaml) says which hand and controller, a scenario "
    "(scenarios/**/*.yaml) what to grasp.",
)


class Sides(StrEnum):
    right = "right"
    left = "left"
    both = "both"


Targets = Annotated[
    list[str],
    typer.Argument(
        help="Configs, scenarios, or folders of scenarios; a name will do.", autocompletion=complete.targets
    ),
]


def _version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"allegro-twin {__version__}\n")
        raise typer.Exit


@app.callback()
def _all(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say which version this is.")
    ] = False,
) -> None:
    """What stands before any command."""


@app.command()
def run(
    targets: Targets,
    side: Annotated[Sides | None, typer.Option(help="The right hand, the left one, or one after the other.")] = None,
    hand: OtherHand = None,
    config: Annotated[
        str | None,
        typer.Option(
            "--config", "-c", help="The config of the hand that performs scenarios.", autocompletion=complete.configs
        ),
    ] = None,
    grasp: Annotated[
        str | None, typer.Option(help="Another grasp than the scenario's.", autocompletion=complete.grasps)
    ] = None,
    thing: Annotated[
        str | None,
        typer.Option(
            "--object",
            help="Another object than the scenario's first: of the catalogue, or an .obj or .stl.",
            autocompletion=complete.objects,
        ),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(help="A policy file (.onnx, .zip) that decides instead.", autocompletion=complete.policies),
    ] = None,
    goal: Annotated[
        str | None, typer.Option(help="For a policy that reaches goals: a posture.", autocompletion=complete.postures)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for a recording, a picture and a report of each run.", callback=options.folder),
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Record to this .arrow file.", callback=options.file(".arrow"))
    ] = None,
    image: Annotated[Path | None, typer.Option(help="Render to this .png.", callback=options.file(".png"))] = None,
    video: Annotated[Path | None, typer.Option(help="Render to this .mp4.", callback=options.file(".mp4"))] = None,
    rrd: Annotated[
        Path | None, typer.Option(help="Write a Rerun recording to this .rrd.", callback=options.file(".rrd"))
    ] = None,
    wire_log: Annotated[
        Path | None,
        typer.Option(
            help="Log every frame of the hand's bus to this .blf, .log or .asc.",
            callback=options.file(".blf", ".log", ".asc"),
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Of pictures and films: WIDTHxHEIGHT in pixels.")] = "480x480",
    camera: looking.Camera = "side",
    view: Annotated[bool, typer.Option(help="Watch live in Rerun's own window.")] = False,
    web: Annotated[bool, typer.Option(help="Watch live in the browser.")] = False,
    seconds: Annotated[
        float | None, typer.Option(help="Stop after this time on the hand's clock.", callback=options.positive)
    ] = None,
    partial: Annotated[bool, typer.Option(help="Replay what is readable of a recording that was cut short.")] = False,
    count: Annotated[
        int | None,
        typer.Option("--jobs", min=1, help="How many simulated runs at once; by default as many as there are cores."),
    ] = None,
) -> None:
    """Run a hand: a config with its controller, or scenarios with a verdict on each."""
    from allegro_twin.look import views
    from allegro_twin.session import Outputs

    if view and web:
        raise ConfigError("--view and --web are two ways to watch one run: choose one")
    outputs = Outputs(record, image, video, rrd, "web" if web else "native" if view else None, wire_log,
                      views.size(size), views.checked(camera))  # fmt: skip
    from allegro_twin.cli.runs import Options, configs_of
    from allegro_twin.cli.several import Wanted
    from allegro_twin.sweep.local import cores

    options = Options(side and side.value, hand, config, grasp, thing, policy, goal, seconds, partial)
    jobs = configs_of(targets, options)
    if len(jobs) > 1 and any((record, image, video, rrd, wire_log, view, web)):
        raise ConfigError(f"{len(jobs)} runs cannot share one output; use --out FOLDER")
    reports = _run_all(jobs, Wanted(outputs, out), count or cores())
    if not all(report.held for report in reports.values()):
        raise typer.Exit(5)


def _run_all(jobs: list[Any], wanted: Any, count: int) -> dict[tuple[str, str], Report]:
    from rich.markup import escape

    from allegro_twin.cli import console
    from allegro_twin.cli.several import run_all

    reports: dict[tuple[str, str], Report] = {}
    grasps: dict[str, str] = {}
    told: set[str] = set()

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
            else:
                reports[job.name, ran.spec.side], grasps[job.name] = ran.outcome.report, ran.grasp
    _tell(reports, grasps, wanted.folder)
    return reports


def _tell(reports: dict[tuple[str, str], Report], grasps: dict[str, str], out: Path | None) -> None:
    """The table at the end, and the files."""
    from allegro_twin.cli import console
    from allegro_twin.evaluate.written import write_reports

    if len(reports) == 1:
        (((name, side), report),) = reports.items()
        console.console.print(console.phases(f"{name}, {side} hand", report))
    elif reports:
        from allegro_twin.sim.backend import ENGINE

        console.console.print(console.summary(reports, grasps, ENGINE))
    if out is not None and reports:
        from allegro_twin.look.strips import picture_all

        names = {f"{name}_{side}": report for (name, side), report in reports.items()}
        write_reports(out / "report.json", names)
        shown = picture_all(out, names)
        console.console.print(
            f"In {out}/: a recording of each run, report.json{', pictures, overview.png' if shown else ''}"
        )
        console.console.print(f"Look at one in the browser: allegro-twin view {out}/{next(iter(names))}.arrow --web")


shipped.register(app)
live.register(app)
looking.register(app)
planning.register(app)
exchange.register(app)
bus.register(app)
training.register(app)
evaluating.register(app)
twin.register(app)


def main() -> None:
    """Run the command line; every HandError, and every slip of the pen, is one line on standard error."""
    ends.stop_on_signals()
    logging.getLogger("can").addHandler(logging.NullHandler())  # What python-can logs, it raises too.
    try:
        sys.exit(app(sys.argv[1:] or ["--help"], prog_name="allegro-twin", standalone_mode=False) or 0)
    except HandError as error:
        sys.stderr.write(f"allegro-twin: {error}\n")
        sys.exit(ends.exit_code(error))
    except ends.USAGE as error:
        sys.stderr.write(f"{ends.usage(error)}\n")
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
