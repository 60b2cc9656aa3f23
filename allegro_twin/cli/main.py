"""The command line. Exit codes: 0 done, 2 config, 3 link, 4 fault or collision, 5 the grasp failed."""

from __future__ import annotations

import logging
import signal
import sys
from enum import StrEnum
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allegro_twin.cli import bus, exchange, live, looking, training
from allegro_twin.cli.options import OtherHand
from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, MotionStalled, unknown

if TYPE_CHECKING:
    from allegro_twin.evaluate.held import Report
    from allegro_twin.session import Outputs

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, help="""A digital twin of
the Wonik Allegro Hand. A config (conf/*.yaml) says which hand and controller, a scenario (scenarios/**/*.yaml) what to
grasp.""")  # fmt: skip


_ENDS = [
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
]  # Windows has the first.


class Sides(StrEnum):
    right = "right"
    left = "left"
    both = "both"


Targets = Annotated[list[str], typer.Argument(help="Configs, scenarios, or folders of scenarios; a name will do.")]


@app.command()
def run(
    targets: Targets,
    side: Annotated[Sides | None, typer.Option(help="The right hand, the left one, or one after the other.")] = None,
    hand: OtherHand = None,
    config: Annotated[
        str | None, typer.Option("--config", "-c", help="The config of the hand that performs scenarios.")
    ] = None,
    grasp: Annotated[str | None, typer.Option(help="Another grasp than the scenario's.")] = None,
    thing: Annotated[str | None, typer.Option("--object", help="Another object than the scenario's first.")] = None,
    policy: Annotated[str | None, typer.Option(help="A policy file (.onnx, .zip) that decides instead.")] = None,
    goal: Annotated[str | None, typer.Option(help="For a policy that reaches goals: a posture.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for a recording, a picture and a report of each run.")
    ] = None,
    record: Annotated[Path | None, typer.Option(help="Record to this .arrow file.")] = None,
    image: Annotated[Path | None, typer.Option(help="Render to this .png.")] = None,
    video: Annotated[Path | None, typer.Option(help="Render to this .mp4.")] = None,
    rrd: Annotated[Path | None, typer.Option(help="Write a Rerun recording to this .rrd.")] = None,
    wire_log: Annotated[
        Path | None, typer.Option(help="Log every frame of the hand's bus to this .blf, .log or .asc.")
    ] = None,
    size: Annotated[str, typer.Option(help="Of pictures and films: WIDTHxHEIGHT in pixels.")] = "480x480",
    camera: looking.Camera = "side",
    view: Annotated[bool, typer.Option(help="Watch live in Rerun's own window.")] = False,
    web: Annotated[bool, typer.Option(help="Watch live in the browser.")] = False,
    seconds: Annotated[float | None, typer.Option(help="Stop after this time on the hand's clock.")] = None,
    partial: Annotated[bool, typer.Option(help="Replay what is readable of a recording that was cut short.")] = False,
) -> None:
    """Run a hand: a config with its controller, or scenarios with a verdict on each."""
    from allegro_twin.look import views
    from allegro_twin.session import Outputs

    outputs = Outputs(record, image, video, rrd, "web" if web else "native" if view else None, wire_log,
                      views.size(size), views.checked(camera))  # fmt: skip
    from allegro_twin.cli.runs import Options, configs_of

    options = Options(side and side.value, hand, config, grasp, thing, policy, goal, seconds, partial)
    jobs = configs_of(targets, options)
    if len(jobs) > 1 and any((record, image, video, rrd, wire_log, view, web)):
        raise ConfigError(f"{len(jobs)} runs cannot share one output; use --out FOLDER")
    reports = _run_all(jobs, outputs, out)
    if not all(report.held for report in reports.values()):
        raise typer.Exit(5)


def _run_all(jobs: list[Any], outputs: Outputs, out: Path | None) -> dict[tuple[str, str], Report]:
    from rich.markup import escape

    from allegro_twin.build import assemble
    from allegro_twin.cli import console
    from allegro_twin.cli.runs import outputs_in
    from allegro_twin.session import perform

    reports: dict[tuple[str, str], Report] = {}
    grasps: dict[str, str] = {}
    told: set[str] = set()
    with console.progress() as bar:
        whole = bar.add_task("", total=len(jobs), visible=len(jobs) > 1)
        for job in jobs:
            rig = assemble(job.config)
            bar.update(whole, description=f"{len(reports)} of {len(jobs)}")
            task = bar.add_task(f"{job.name} {rig.spec.side}", total=rig.seconds)
            where = outputs if out is None else outputs_in(out, job, rig, outputs)
            outcome = perform(
                rig,
                job.config,
                where,
                lambda t, task=task: bar.update(task, completed=t),  # type: ignore[misc]  # Bound now.
                lambda line: console.errors.print(line, soft_wrap=True),
            )
            bar.remove_task(task)
            bar.advance(whole)
            for note in outcome.notes:
                if note not in told:
                    console.errors.print(f"[yellow]{job.name} {rig.spec.side}: {escape(note)}[/]")
                told.add(note)
            if outcome.unconfirmed:
                raise LinkError(outcome.unconfirmed)
            if outcome.report is None:
                console.console.print(console.final_state(rig.spec, outcome.last))
            else:
                assert rig.trial is not None
                reports[job.name, rig.spec.side], grasps[job.name] = outcome.report, rig.trial.grasp.name
    _tell(reports, grasps, out)
    return reports


def _tell(reports: dict[tuple[str, str], Report], grasps: dict[str, str], out: Path | None) -> None:
    """The table at the end, and the files."""
    from allegro_twin.cli import console
    from allegro_twin.session import write_reports

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


@app.command("list")
def list_(
    what: Annotated[str, typer.Argument(help="objects, postures, grasps, scenarios, configs or hands")] = "",
) -> None:
    """List what ships with the package."""
    from allegro_twin.cli import catalogue, console

    kinds = catalogue.KINDS
    if what and what not in kinds:
        raise ConfigError(unknown("list", what, kinds))
    for kind in [what] if what else kinds:
        console.console.print(kinds[kind]())


@app.command()
def envs(
    task: Annotated[str, typer.Argument(help="One task, with the spaces of its observations and actions.")] = "",
) -> None:
    """List the Gymnasium environments: their ids, their spaces, and what they are for."""
    from allegro_twin.cli import console, environments

    console.console.print(environments.listed(task))


live.register(app)
looking.register(app)
exchange.register(app)
bus.register(app)
training.register(app)


def main() -> None:
    """Run the command line; every HandError is one line on standard error."""
    for number in _ENDS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # As nohup sets it.
            signal.signal(number, _stop)
    logging.getLogger("can").addHandler(logging.NullHandler())  # What python-can logs, it raises too.
    try:
        app()
    except HandError as error:
        sys.stderr.write(f"allegro-twin: {error}\n")
        sys.exit(_exit_code(error))
    except KeyboardInterrupt:
        sys.exit(130)


def _stop(number: int, frame: FrameType | None) -> None:
    """End as Ctrl-C does, so that the hand is left limp; a second signal does not interrupt that."""
    for each in (*_ENDS, signal.SIGINT):
        signal.signal(each, signal.SIG_IGN)
    raise KeyboardInterrupt


def _exit_code(error: HandError) -> int:
    if isinstance(error, LinkError):
        return 3
    return 4 if isinstance(error, (HandFault, MotionStalled)) else 2
