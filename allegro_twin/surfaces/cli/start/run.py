"""The command `run`: a config with its controller, or scenarios with a verdict on each."""

from __future__ import annotations

import shlex
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allegro_twin.errors import ConfigError, HandError, LinkError, RecordingError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.options import OtherHand
from allegro_twin.surfaces.cli.start import view as viewing

if TYPE_CHECKING:
    from allegro_twin.app.session import Outputs
    from allegro_twin.grasping.verdict import TrialReport
    from allegro_twin.spec.thermal import ThermalData
    from allegro_twin.surfaces.cli.start.jobs import RunJob, RunOptions
    from allegro_twin.surfaces.cli.start.parallel import RunOutputs, RunResult

REPORT = "report.json"
"""The verdicts of the trials, in the folder of --out."""


def _file(text: str, *suffixes: str) -> Any:
    return typer.Option(help=text, callback=options.file(*suffixes), rich_help_panel=options.OUTPUT)


Targets = Annotated[
    list[str],
    typer.Argument(
        help="Configs, scenarios, or folders of scenarios, by path or name.", autocompletion=completion.targets
    ),
]
Side = Annotated[options.Sides | None, typer.Option(help="Right hand, left hand, or both in turn.")]
Performer = Annotated[
    str | None,
    typer.Option(
        "--config", "-c", help="Config of the hand that performs scenarios.", autocompletion=completion.configs
    ),
]
Policy = Annotated[
    str | None,
    typer.Option(
        help="Let this policy file (.onnx, .zip) control the hand.",
        autocompletion=completion.policies,
        rich_help_panel=options.POLICY,
    ),
]
Goal = Annotated[
    str | None,
    typer.Option(
        help="Goal of a policy that reaches goals: a posture.",
        autocompletion=completion.postures,
        rich_help_panel=options.POLICY,
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder for a recording, a picture and a report of each run. Replaces the run before.",
        callback=options.folder,
        rich_help_panel=options.OUTPUT,
    ),
]
Record = Annotated[Path | None, _file("Record to this .arrow; replaces what is there.", ".arrow")]
Image = Annotated[Path | None, _file("Render to this .png; replaces what is there.", ".png")]
Video = Annotated[Path | None, _file("Film to this .mp4; replaces what is there.", ".mp4")]
Rrd = Annotated[Path | None, _file("Write a Rerun file to this .rrd; replaces what is there.", ".rrd")]
WireLog = Annotated[
    Path | None,
    _file("Log the hand's bus to this .blf, .log or .asc; replaces it.", ".blf", ".log", ".asc"),
]
Size = Annotated[
    str, typer.Option(help="Size of pictures and films, WIDTHxHEIGHT in pixels.", rich_help_panel=options.OUTPUT)
]
View = Annotated[bool, typer.Option(help="Watch live in Rerun's own window.", rich_help_panel=options.OUTPUT)]
Web = Annotated[bool, typer.Option(help="Watch live in the browser.", rich_help_panel=options.OUTPUT)]
Seconds = Annotated[
    float | None, typer.Option(help="Stop after this time on the hand's clock, s.", callback=options.positive)
]
Partial = Annotated[bool, typer.Option(help="Replay as much as possible of a recording that was cut short.")]
Count = Annotated[
    int | None,
    typer.Option(
        "--jobs", min=1, help="Simulated runs at once; default: one for each core.", rich_help_panel=options.COMPUTE
    ),
]


def run(
    targets: Targets,
    side: Side = None,
    hand: OtherHand = None,
    config: Performer = None,
    grasp: options.OtherGrasp = None,
    object_name: options.OtherObject = None,
    policy: Policy = None,
    goal: Goal = None,
    out: Out = None,
    record: Record = None,
    image: Image = None,
    video: Video = None,
    rrd: Rrd = None,
    wire_log: WireLog = None,
    size: Size = "480x480",
    camera: viewing.Camera = "auto",
    view: View = False,
    web: Web = False,
    seconds: Seconds = None,
    partial: Partial = False,
    count: Count = None,
) -> None:
    """Run a config, or scenarios with a verdict on each."""
    from allegro_twin.app.session import Outputs
    from allegro_twin.surfaces.cli.start.jobs import RunOptions
    from allegro_twin.viewing import views

    if view and web:
        raise ConfigError("--view and --web are two ways to watch one run: choose one")
    live = "web" if web else "native" if view else None
    outputs = Outputs(record, image, video, rrd, live, wire_log, views.size(size), views.checked(camera))
    chosen = RunOptions(side and side.value, hand, config, grasp, object_name, policy, goal, seconds, partial)
    if not _run(targets, chosen, outputs, out, count):
        raise typer.Exit(5)


def _run(targets: list[str], chosen: RunOptions, outputs: Outputs, out: Path | None, count: int | None) -> bool:
    """Run everything and write the outputs. Returns whether every run reached its goal."""
    from allegro_twin.app.session import check_outputs
    from allegro_twin.surfaces.cli.start.jobs import check_folder_outputs, configs_of
    from allegro_twin.surfaces.cli.start.parallel import RunOutputs
    from allegro_twin.sweep.processors import core_count

    if out is not None:
        check_folder_outputs(outputs)
    jobs = configs_of(targets, chosen)
    for job in jobs:
        check_outputs(job.config, outputs)
    single = (outputs.record, outputs.image, outputs.video, outputs.rrd, outputs.wire_log, outputs.live)
    if len(jobs) > 1 and any(single):
        raise ConfigError(f"{len(jobs)} runs cannot share one output; use --out FOLDER")
    if out is None:
        with options.interruptible(outputs.record, outputs.image, outputs.video, outputs.rrd, outputs.wire_log):
            verdicts = _run_jobs(jobs, RunOutputs(outputs, None), count or core_count())
        if verdicts.reports and not any(single):
            from allegro_twin.surfaces.cli import console

            console.hint("Next: --out FOLDER keeps a recording, a picture and a report of each; --view shows it live")
        return verdicts.done
    with options.run_folder(out, REPORT) as staging:
        verdicts = _run_jobs(jobs, RunOutputs(outputs, staging), count or core_count())
        pictures = _write_reports(verdicts.reports, staging)
    _print_folder(verdicts.reports, out, pictures=pictures)
    return verdicts.done


@dataclass(slots=True)
class _Verdicts:
    """Verdicts of the runs that have ended."""

    reports: dict[tuple[str, str], TrialReport] = field(default_factory=dict)
    grasps: dict[str, str] = field(default_factory=dict)
    thermal: ThermalData | None = None
    printed: set[str] = field(default_factory=set)
    """Notes."""
    ended: set[int] = field(default_factory=set)
    """Numbers of the jobs."""
    done: bool = True
    """Every run reached its goal."""
    unwritten: str = ""

    def add(self, number: int, job: RunJob, ran: RunResult) -> None:
        """Add a run, and print what there is to say of it alone. Raises LinkError for one that is not confirmed."""
        from allegro_twin.surfaces.cli import console

        self.ended.add(number)
        for note in ran.outcome.notes:
            if note not in self.printed:
                console.warn(f"{job.name} {ran.spec.side}: {note}")
            self.printed.add(note)
        self.unwritten = self.unwritten or ran.outcome.unwritten
        if ran.outcome.unconfirmed:
            raise LinkError(ran.outcome.unconfirmed)
        if ran.outcome.report is not None:
            self.reports[job.name, ran.spec.side], self.grasps[job.name] = ran.outcome.report, ran.grasp
            self.thermal = ran.spec.thermal
            self.done = self.done and ran.outcome.report.held
            return
        console.console.print(console.final_state(ran.spec, ran.outcome.last))
        self.done = self.done and not ran.outcome.failed  # A note has said so.
        cut = job.cut and ran.outcome.last.t < ran.outcome.motion  # --seconds ended the motion early.
        if ran.outcome.missed and not cut:
            self.done = False
            console.warn(f"{job.name}, {ran.spec.side} hand: {ran.outcome.missed}")
        elif ran.outcome.missed:
            console.warn(
                f"{job.name}, {ran.spec.side} hand: --seconds ended the motion at {ran.outcome.last.t:.1f} s; "
                f"it takes {ran.outcome.motion:.1f} s"
            )


def _run_jobs(jobs: list[RunJob], files: RunOutputs, count: int) -> _Verdicts:
    """Run the jobs and print the outcomes. Where Ctrl-C or an error ends them, what had ended is printed, and its
    report is in the folder of `files`."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.start.parallel import run_all

    found, ahead = _Verdicts(), dict[int, Any]()

    def report(line: str) -> None:
        console.errors.print(line, soft_wrap=True)

    try:
        with console.progress() as bar, closing(run_all(jobs, files, count, bar, report, ahead)) as runs:
            for number, (job, ran) in enumerate(runs):
                found.add(number, job, ran)
    except KeyboardInterrupt:
        for number in sorted(number for number, ran in ahead.items() if not isinstance(ran, HandError)):
            found.add(number, jobs[number], ahead[number])
        _print_ended(found, files.folder)
        if len(jobs) > 1:
            console.warn(f"interrupted: {len(found.ended)} of {len(jobs)} runs had ended")
        raise
    except HandError as error:
        if found.reports:
            _print_ended(found, files.folder)
            error.args = (f"{error}; {len(found.ended)} of {len(jobs)} runs had ended",)
        raise
    _print_verdicts(found.reports, found.grasps, found.thermal)
    if found.unwritten:
        options.end_unwritten(found.unwritten, 0 if found.done else 5)
    return found


def _print_ended(found: _Verdicts, folder: Path | None) -> None:
    """Print, and write, the verdicts of runs that had ended when something ended all."""
    from allegro_twin.surfaces.cli import console

    _print_verdicts(found.reports, found.grasps, found.thermal)
    if folder is not None:
        try:
            _write_reports(found.reports, folder, pictures=False)
        except RecordingError as error:
            console.warn(str(error))


def _print_verdicts(
    reports: dict[tuple[str, str], TrialReport], grasps: dict[str, str], thermal: ThermalData | None
) -> None:
    """The phases of one trial, with what its hand's `thermal` data say, or one row for each of several."""
    from allegro_twin.surfaces.cli import console

    if len(reports) == 1:
        (((name, side), report),) = reports.items()
        if report.phases:
            console.console.print(console.phases(f"{name}, {side} hand", report, thermal))
        else:  # A fault ended it before there was one.
            console.say(f"{name}, {side} hand: not held: {report.reason}")
    elif reports:
        from allegro_twin.sim.engine.backend import ENGINE

        console.console.print(console.summary(reports, grasps, ENGINE))


def _write_reports(reports: dict[tuple[str, str], TrialReport], folder: Path, *, pictures: bool = True) -> bool:
    """Write the verdicts and, with `pictures`, an overview of the pictures. Returns whether there are pictures."""
    from allegro_twin.grasping.evaluation.rejudge import write_reports
    from allegro_twin.viewing.stills import picture_all

    if not reports:
        return False
    names = {f"{name}_{side}": report for (name, side), report in reports.items()}
    write_reports(folder / REPORT, names)
    return pictures and picture_all(folder, names) is not None


def _print_folder(reports: dict[tuple[str, str], TrialReport], out: Path, *, pictures: bool) -> None:
    from allegro_twin.surfaces.cli import console

    if not reports:
        return
    what = f"a recording of each run, {REPORT}{', pictures, overview.png' if pictures else ''}"
    console.say(f"In {out}/: {what}")
    name, side = next(iter(reports))
    recording = shlex.quote(f"{out}/{name}_{side}.arrow")
    console.say(f"Look at one in the browser: allegro-twin view {recording} --web")
