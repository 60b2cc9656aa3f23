"""Commands that make a model the twin of one hand: excite it, identify its drive, say how good the twin is."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.twin.identify.pipeline import KnownWeight


class Laws(StrEnum):
    coulomb = "coulomb"
    lugre = "lugre"
    auto = "auto"


Recordings = Annotated[list[Path], typer.Argument(help="Recordings (.arrow) of one hand.")]


def register(app: typer.Typer) -> None:
    """Add these commands to the command line."""
    from allegro_twin.surfaces.cli.twins.what_if import branch

    for command in (excite, identify, gap, mirror, branch):
        app.command()(command)


def excite(
    config: Annotated[
        str, typer.Argument(help="Which hand: a config by path or name.", autocompletion=complete.configs)
    ],
    pose: Annotated[str, typer.Option(help="How the hand lies: up, palm-up, side or palm-down.")],
    seconds: Annotated[float, typer.Option(help="Of motion in this pose.", callback=options.positive)] = 20.0,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for the recordings.", callback=options.folder)
    ] = Path("out/excite"),
    other: OtherHand = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the motion.")] = 0,
    yes: Annotated[bool, typer.Option("--yes", help="The hand lies as it should: do not ask.")] = False,
) -> None:
    """Play motions that show what the hand's drive is made of, and record them; the same command again goes on after
    an interruption. Three poses, up, palm-up and side, show all of it."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.twin.identify import record_excitation

    settings = on_hand(load_config(config), other)
    todo = record_excitation.remaining_run(settings, pose, seconds, seed, out)
    if todo is None:
        console.console.print(f"{pose} is recorded in {out}/", soft_wrap=True)
        return
    ready = record_excitation.pose_config(settings, todo.pose)
    console.errors.print(f"{pose}: {todo.pose.instruction}. It will move every finger for {todo.seconds:.0f} s.")
    if not yes and sys.stdin.isatty() and sys.stderr.isatty():
        typer.prompt("Press Enter when it lies so and nothing is near", default="", show_default=False, err=True)
    with console.progress() as bar:
        job = bar.add_task(pose, total=todo.seconds)
        record_excitation.record_run(ready, todo, lambda t: bar.update(job, completed=t))
    console.console.print(f"{todo.file}: {todo.seconds:.0f} s, {pose}", soft_wrap=True)


def identify(
    recordings: Recordings,
    hand: Annotated[
        str | None,
        typer.Option(help="The hand's own file, to be written; without it nothing is.", autocompletion=complete.hands),
    ] = None,
    known_mass: Annotated[
        list[str] | None,
        typer.Option(
            help="A weight at a fingertip in one recording: tip=0.050@REC (kg; or index=…): the scale of N·m."
        ),
    ] = None,
    friction: Annotated[
        Laws, typer.Option(help="Whether friction breaks away (lugre); auto: if Coulomb's leaves too much over.")
    ] = Laws.auto,
    known_masses: Annotated[
        bool, typer.Option("--known-masses", help="The masses of the links are right: the scale of N·m.")
    ] = False,
    report: Annotated[
        Path | None, typer.Option(help="Write a page to this .html.", callback=options.file(".html"))
    ] = None,
) -> None:
    """Find out what a hand's drive is made of, from recordings of `excite`, and write it into the hand's own file."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.twins import identifying

    weights = [weight_of(text) for text in known_mass or ()]
    path = identifying.hand_file(hand) if hand is not None else None
    with console.progress() as bar:
        job = bar.add_task("reading", total=None)
        found = identifying.identified(
            recordings, weights, path, known_masses, friction.value, lambda line: bar.update(job, description=line)
        )
    console.console.print(identifying.table(found))
    for line in identifying.lines(found):
        console.console.print(line, soft_wrap=True, highlight=False)
    if report is not None:
        from allegro_twin.twin.identify.report import report_page

        identifying.write_page(report, report_page(found))
        console.console.print(f"Report: {report}", soft_wrap=True)
    if path is not None:
        console.warn(identifying.keep(path, found))
        console.console.print(f"Written into {path}; use it with `hand: {{serial: {path}}}`", soft_wrap=True)


def gap(
    recordings: Recordings,
    hand: Annotated[
        str | None,
        typer.Option(help="The hand's own file; default: the one it was recorded with.", autocompletion=complete.hands),
    ] = None,
) -> None:
    """How good the twin is: the recorded commands played into the model, open loop, against what the hand did."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.twins import identifying

    identifying.check_scipy()
    from allegro_twin.twin.identify.pipeline import measure_gaps
    from allegro_twin.twin.identify.results.hand_file import mismatch_warning

    console.warn(mismatch_warning(identifying.hand_file(hand)) if hand else "")
    for each in measure_gaps(recordings, hand or ""):
        console.console.print(identifying.gap_table(each))


def mirror(
    target: Annotated[str, typer.Argument(help="A recording (.arrow), or the config of a hand on a bus, which runs.")],
    hand: Annotated[
        str | None,
        typer.Option(help="The hand's own file; default: the one it was recorded with.", autocompletion=complete.hands),
    ] = None,
    free: Annotated[
        Path | None, typer.Option(help="A recording that touched nothing: it says from where on a push is a touch.")
    ] = None,
    stop_on: Annotated[
        str, typer.Option(help="What leaves the hand limp: contact, weak, stuck, …, with commas between.")
    ] = "",
    record: Annotated[
        Path | None,
        typer.Option(
            help="Record a run, with `predicted`, `disturbance` and `event`.", callback=options.file(".arrow")
        ),
    ] = None,
    rrd: Annotated[
        Path | None, typer.Option(help="Draw a run into a Rerun file.", callback=options.file(".rrd"))
    ] = None,
    view: Annotated[bool, typer.Option(help="Watch a run live in Rerun's own window.")] = False,
    web: Annotated[bool, typer.Option(help="Watch a run live in the browser.")] = False,
    gravity: Annotated[
        str | None, typer.Option(help="In the palm's frame, m/s², of a hand that does not report it: 0,0,-9.81.")
    ] = None,
) -> None:
    """Run the model beside a hand: what it expects, what pushes the fingers, and what is wrong with them; a recording
    plays past it faster."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.twins import identifying, mirroring

    identifying.check_scipy()
    from allegro_twin.twin.mirror.factory import describe_backlash

    down = None if gravity is None else mirroring.vector(gravity)
    if Path(target).suffix == ".arrow":
        from allegro_twin.recording.reader import load
        from allegro_twin.twin.mirror.on_recording import mirror_recording

        if stop_on or record is not None or rrd is not None or view or web:
            raise ConfigError(
                f"{target} is a recording: --stop-on, --record, --rrd, --view and --web are for a hand that runs"
            )
        spec = load(Path(target)).spec
        console.warn(describe_backlash(spec, hand or ""))
        found = mirror_recording(Path(target), hand or "", free, down)
    else:
        from allegro_twin.app.config import load_config
        from allegro_twin.app.rig import spec_of

        config = load_config(target)
        spec = spec_of(config)
        console.warn(describe_backlash(spec, hand or ""))
        with console.progress() as bar:
            job = bar.add_task("beside the model", total=config.seconds)
            stop = tuple(part.strip() for part in stop_on.split(",") if part.strip())
            wanted = mirroring.Wanted(free, stop, record, rrd, "web" if web else "native" if view else None, down)
            found = mirroring.live(
                config, hand or "", wanted, lambda t: bar.update(job, completed=t), console.errors.print
            )
    console.console.print(mirroring.table(found, spec.joint_labels))
    console.warn(mirroring.unnamed(found, free))
    for line in mirroring.lines(found, spec):
        console.console.print(line, highlight=False)


def weight_of(text: str) -> KnownWeight:
    """`tip=0.050@REC`. Raises ConfigError."""
    from allegro_twin.twin.identify.pipeline import KnownWeight

    at, equals, rest = text.partition("=")
    mass, sign, recording = rest.partition("@")
    try:
        if equals and sign and recording and 0.0 < float(mass) < 1.0:
            return KnownWeight(at, float(mass), Path(recording).name)
    except ValueError:
        pass  # Said below.
    raise ConfigError(f"--known-mass {text}: say where, kg below 1, and in which recording: tip=0.050@REC")
