"""Commands that fit a model to one hand, run it beside the hand, and branch recordings."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.spec import HandSpec
    from allegro_twin.twin.identify.pipeline import KnownWeight
    from allegro_twin.twin.mirror.on_recording import MirrorResult


class FrictionLaws(StrEnum):
    coulomb = "coulomb"
    lugre = "lugre"
    auto = "auto"


class Disturbances(StrEnum):
    forget = "forget"
    hold = "hold"


Recordings = Annotated[list[Path], typer.Argument(help="Recordings (.arrow) of one hand.")]


def excite(
    config: Annotated[
        str, typer.Argument(help="Config of the hand, by path or name.", autocompletion=completion.configs)
    ],
    pose: Annotated[str, typer.Option(help="Pose of the hand: up, palm-up, side or palm-down.")],
    seconds: Annotated[
        float,
        typer.Option(
            help="Duration of the motion in this pose, s; 4 s at least, and 1.5 s to get there.",
            callback=options.positive,
        ),
    ] = 20.0,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for the recordings.", callback=options.folder)
    ] = Path("out/excite"),
    other: OtherHand = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the motion.")] = 0,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask whether the hand lies in the pose.")] = False,
) -> None:
    """Record motions of a hand, for `identify`.

    Repeat it for the poses up, palm-up and side. After an interruption the same command continues."""
    from allegro_twin.app.config import load_config
    from allegro_twin.recording.reader import load
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.twin.identify import record_excitation

    settings = on_hand(load_config(config), other)
    todo = record_excitation.remaining_run(settings, pose, seconds, seed, out)
    if todo is None:
        console.say(f"{pose} is recorded in {out}/")
        return
    ready = record_excitation.pose_config(settings, todo.pose)
    console.errors.print(f"{pose}: {todo.pose.instruction}. It will move every finger for {todo.seconds:.0f} s.")
    if not yes and sys.stdin.isatty() and sys.stderr.isatty():
        typer.prompt("Press Enter when it lies so and nothing is near", default="", show_default=False, err=True)
    kept = options.interruptible(todo.file, then="; the same command records the rest")
    with kept, console.progress() as bar:
        job = bar.add_task(pose, total=todo.seconds)
        record_excitation.record_run(ready, todo, lambda t: bar.update(job, completed=t))
    console.say(f"{todo.file}: {todo.seconds:.0f} s, {pose}")
    for line in record_excitation.describe_unfollowed(load(todo.file)):
        console.warn(f"{line}. `identify` writes nothing of it")


def identify(
    recordings: Recordings,
    hand: Annotated[
        str | None,
        typer.Option(
            help="The hand's own file to write; without it nothing is written.", autocompletion=completion.hands
        ),
    ] = None,
    known_mass: Annotated[
        list[str] | None,
        typer.Option(
            help="A known weight at a fingertip in one recording, kg, as the scale of N·m: tip=0.050@REC, or index=…"
        ),
    ] = None,
    friction: Annotated[
        FrictionLaws,
        typer.Option(
            help="Friction law: coulomb; lugre, with break-away; auto: lugre if coulomb leaves large residuals."
        ),
    ] = FrictionLaws.auto,
    known_masses: Annotated[
        bool, typer.Option("--known-masses", help="Take the masses of the links as exact: the scale of N·m.")
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(help="Write a page to this .html; replaces what is there.", callback=options.file(".html")),
    ] = None,
) -> None:
    """Identify a hand's motors and friction from recordings."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import block_with_file
    from allegro_twin.surfaces.cli.twin import identification

    weights = [weight_of(text) for text in known_mass or ()]
    path = identification.file_to_write(hand) if hand is not None else None
    with options.interruptible(path, report, otherwise="nothing is identified"), console.progress() as bar:
        job = bar.add_task("reading", total=None)
        found = identification.identify_drive(
            recordings, weights, path, known_masses, friction.value, lambda line: bar.update(job, description=line)
        )
    for line in identification.head_lines(found):
        console.console.print(line, soft_wrap=True, highlight=False)
    console.console.print(identification.table(found))
    for line in identification.lines(found):
        console.console.print(line, soft_wrap=True, highlight=False)
    if report is not None:
        from allegro_twin.twin.identify.report import report_page

        identification.write_page(report, report_page(found))
        console.say(f"Report: {report}")
    if path is not None:
        console.warn(identification.store_values(path, found))
        if not found.written.is_nominal:
            console.warn(identification.gain_lines(recordings[0], path))
            block = block_with_file(path, found.motions[0].spec.side)
            console.say(f"Written into {path}; use it with `{block}`")
    else:
        console.hint("Next: --hand FILE writes these values into the hand's own file")


def gap(
    recordings: Recordings,
    hand: Annotated[
        str | None,
        typer.Option(help="The hand's own file; default: the one of the recording.", autocompletion=completion.hands),
    ] = None,
) -> None:
    """Measure the model's open-loop error against recordings."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.twin import identification

    identification.check_scipy()
    from allegro_twin.twin.identify.pipeline import measure_gaps
    from allegro_twin.twin.identify.results.hand_file import mismatch_warning

    console.warn(mismatch_warning(identification.hand_file(hand)) if hand else "")
    for each in measure_gaps(recordings, hand or ""):
        console.console.print(identification.gap_table(each))


def mirror(
    target: Annotated[str, typer.Argument(help="A recording (.arrow), or the config of a hand.")],
    hand: Annotated[
        str | None,
        typer.Option(help="The hand's own file; default: the one of the recording.", autocompletion=completion.hands),
    ] = None,
    free: Annotated[Path | None, typer.Option(help="A recording without contacts; it sets the thresholds.")] = None,
    stop_on: Annotated[
        str, typer.Option(help="Events that leave the hand limp, separated by commas: contact, weak, stuck, …")
    ] = "",
    record: Annotated[
        Path | None,
        typer.Option(
            help="Record it with `predicted`, `disturbance`, `event`; replaces it.",
            callback=options.file(".arrow"),
        ),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(help="Write a Rerun file of the run; replaces what is there.", callback=options.file(".rrd")),
    ] = None,
    view: Annotated[bool, typer.Option(help="Watch live in Rerun's own window.")] = False,
    web: Annotated[bool, typer.Option(help="Watch live in the browser.")] = False,
    gravity: Annotated[
        str | None, typer.Option(help="Gravity in the palm's frame, m/s², if the hand does not report it: 0,0,-9.81.")
    ] = None,
    partial: Annotated[bool, typer.Option(help="Use what is there of a recording that was cut short.")] = False,
) -> None:
    """Run the model beside a hand: find touches, slips, faults.

    Ctrl-C ends a run with what was found up to then."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.twin import identification, mirror_run

    identification.check_scipy()
    from allegro_twin.twin.mirror.factory import describe_backlash

    down = None if gravity is None else mirror_run.parse_gravity(gravity)
    if Path(target).suffix == ".arrow":
        from allegro_twin.recording.reader import load

        if stop_on or rrd is not None or view or web:
            raise ConfigError(f"{target} is a recording: --stop-on, --rrd, --view and --web are for a hand that runs")
        recording = load(Path(target), partial=partial)
        spec = recording.spec
        console.warn(describe_backlash(spec, hand or ""))
        with _mirrored(record, None):
            found, ended = mirror_run.mirror_file(recording, hand or "", free, down, record)
            if found is not None and found.free is not None:
                console.warn(mirror_run.other_name(found.free, spec))
                console.warn(mirror_run.misfit(found.free, spec))
            _show_mirrored(found, spec, free)
            if ended is not None:
                raise ended
        return
    from allegro_twin.app.config import load_config
    from allegro_twin.app.rig import spec_of

    if partial:
        raise ConfigError(f"--partial is for a recording, and {target} is a config")
    config = load_config(target)
    spec = spec_of(config)
    console.warn(describe_backlash(spec, hand or ""))
    stop = tuple(part.strip() for part in stop_on.split(",") if part.strip())
    wanted = mirror_run.MirrorOutputs(free, stop, record, rrd, "web" if web else "native" if view else None, down)
    with _mirrored(record, rrd):
        with console.progress() as bar:
            job = bar.add_task("beside the model", total=config.seconds)
            found, ended = mirror_run.run_with_mirror(
                config, hand or "", wanted, lambda t: bar.update(job, completed=t), console.errors.print, console.warn
            )
        _show_mirrored(found, spec, free)
        if ended is not None:
            raise ended


def _mirrored(record: Path | None, rrd: Path | None) -> AbstractContextManager[None]:
    """What an interrupted mirror says of its files, or else of what it printed."""
    return options.interruptible(record, rrd, otherwise="what is shown is what came until then")


def _show_mirrored(found: MirrorResult | None, spec: HandSpec, free: Path | None) -> None:
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.twin import mirror_run

    if found is None:
        return
    console.console.print(mirror_run.table(found, spec.joint_labels))
    console.warn(mirror_run.missing_checks(found, free))
    for line in mirror_run.lines(found, spec):
        console.console.print(line, highlight=False, soft_wrap=True)


def branch(
    recording: Annotated[Path, typer.Argument(help="A recording (.arrow) of a simulated, virtual or real hand.")],
    at: Annotated[float, typer.Option(help="Instant of the change, s.")],
    change: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Change: friction=0.5 (contacts; simulations only), damping=…, frictionloss=… (all joints), "
            "strength=0.8 (a factor on the motors), or controller.gains=v4.",
        ),
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option(
            help="Continue with this hand's model, from the mirror's estimate; default for a real hand: the "
            "recording's file.",
            autocompletion=completion.hands,
        ),
    ] = None,
    disturbance: Annotated[
        Disturbances, typer.Option(help="With a model: forget the disturbance of that instant, or hold it.")
    ] = Disturbances.forget,
    open_loop: Annotated[
        bool, typer.Option("--open-loop", help="With a model: continue the recorded commands, not the controller.")
    ] = False,
    gravity: Annotated[
        str | None, typer.Option(help="Gravity in the palm's frame, m/s², if the hand does not report it: 0,0,-9.81.")
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(help="Record the branch to this .arrow; replaces what is there.", callback=options.file(".arrow")),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(
            help="Write both futures to one Rerun file; replaces what is there.", callback=options.file(".rrd")
        ),
    ] = None,
    image: Annotated[
        Path | None,
        typer.Option(
            help="Plot all futures, joint by joint, to this .png; replaces it.", callback=options.file(".png")
        ),
    ] = None,
) -> None:
    """Change something at one instant of a recording: what if?

    A simulation is repeated from its beginning. For a hand on a bus or a line its model continues, with the change and
    without it; the second shows the model's own error."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.twin import branch_run, mirror_run
    from allegro_twin.twin.branch.result import BranchOptions

    down = None if gravity is None else mirror_run.parse_gravity(gravity)
    wanted = BranchOptions(hand or "", disturbance.value, open_loop, down)
    with options.interruptible(record, rrd, image, otherwise="nothing is compared"):
        found = branch_run.run_branch(recording, at, change or [], branch_run.BranchOutputs(record, rrd), wanted)
    for line in branch_run.warnings(recording, wanted):
        console.warn(line)
    if image is not None:
        branch_run.draw_branch(image, recording, found, at)
    console.console.print(branch_run.table(recording, found, at))
    for line in branch_run.lines(found, at):
        console.console.print(line, highlight=False, soft_wrap=True)


def weight_of(text: str) -> KnownWeight:
    """Parse `tip=0.050@REC`. Raises ConfigError."""
    from allegro_twin.twin.identify.pipeline import KnownWeight

    at, equals, rest = text.partition("=")
    mass, sign, recording = rest.partition("@")
    try:
        if equals and sign and recording and 0.0 < float(mass) < 1.0:
            return KnownWeight(at, float(mass), recording)
    except ValueError:
        pass  # The error below names the format.
    raise ConfigError(f"--known-mass {text}: say where, kg below 1, and in which recording: tip=0.050@REC")
