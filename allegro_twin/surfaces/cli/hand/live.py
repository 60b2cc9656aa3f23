"""Commands for a hand that is open: go to a posture, grasp, teach, play, the keyboard, calibrate, show."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.options import Config, OtherHand

Seconds = Annotated[float, typer.Option(help="How long, on the hand's clock.", callback=options.positive)]


def register(app: typer.Typer) -> None:
    """Add these commands to the command line."""
    for command in (posture, grasp, teach, play, keyboard):
        app.command()(command)
    calibrate = typer.Typer(help="Measure a hand and write what was found into its own file.")
    calibrate.command("limits")(calibrate_limits)
    calibrate.callback()(_group)
    app.add_typer(calibrate, name="calibrate")


def _group() -> None:
    """A group of commands."""


def posture(
    name: Annotated[
        str,
        typer.Argument(
            help="A posture of the library; `allegro-twin list postures`.", autocompletion=complete.postures
        ),
    ],
    config: Config = "sim_right",
    other: OtherHand = None,
    speed: Annotated[float, typer.Option(help="Peak speed of the joint that travels furthest, rad/s.")] = 1.0,
) -> None:
    """Go to a posture and show where the joints are."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.surfaces.hand import Hand

    with Hand.open(on_hand(load_config(config), other)) as hand:
        hand.move_to(name, speed)
        console.console.print(console.final_state(hand.spec, hand.state))


def grasp(
    name: Annotated[
        str,
        typer.Argument(help="A grasp of the library; `allegro-twin list grasps`.", autocompletion=complete.grasps),
    ],
    config: Config = "sim_right",
    other: OtherHand = None,
    width: Annotated[float | None, typer.Option(help="Of the object, m.")] = None,
    force: Annotated[float | None, typer.Option(help="N on the thumb, or the scale of an envelop grasp.")] = None,
) -> None:
    """Perform a grasp and show what the hand felt."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.surfaces.hand import Hand

    with Hand.open(on_hand(load_config(config), other)) as hand:
        felt = hand.grasp(name, object_width=width, force=force)
        console.console.print(console.felt(felt))


def teach(
    name: Annotated[str, typer.Argument(help="What to call it in the library.")],
    config: Config = "sim_right",
    other: OtherHand = None,
    seconds: Seconds = 10.0,
    into: Annotated[Path, typer.Option(help="Library file to store it in.", callback=options.file(".yaml"))] = Path(
        "library/taught.yaml"
    ),
    motion: Annotated[
        bool, typer.Option(help="Store the way the fingers went, not only where they were left.")
    ] = False,
) -> None:
    """Let a person move the fingers under gravity compensation, and store what was shown, for both hands."""
    from allegro_twin.app.config import load_config
    from allegro_twin.hands.library.entries import posture_entry, trajectory_entry
    from allegro_twin.hands.library.library import Library
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.surfaces.hand import Hand

    with Hand.open(on_hand(load_config(config), other), background=sys.stdin.isatty()) as hand:
        console.console.print(f"Move the fingers; {seconds:g} s from now on.")
        with hand.teach() as demonstration:
            hand.wait(seconds)
        library = Library()
        if motion:
            shown = demonstration.motion()
            library.add(name, trajectory_entry(shown.times, shown.positions, hand.spec), hand.spec)
        else:
            library.add(name, posture_entry(demonstration.posture(), hand.spec), hand.spec)
        library.store(name, into)
    console.console.print(f"{name} is in {into}, for the right and the left hand")


def play(
    name: Annotated[
        str,
        typer.Argument(
            help="A trajectory of the library; `allegro-twin list trajectories`.",
            autocompletion=complete.trajectories,
        ),
    ],
    config: Config = "sim_right",
    other: OtherHand = None,
    speed: Annotated[float, typer.Option(help="How many times as fast as it was shown.")] = 1.0,
    approach: Annotated[float, typer.Option(help="Peak speed on the way to where it begins, rad/s.")] = 1.0,
) -> None:
    """Repeat a motion that was shown to a hand, on either hand, and show where the joints are."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.surfaces.hand import Hand

    with Hand.open(on_hand(load_config(config), other)) as hand:
        hand.play(name, speed, approach=approach)
        console.console.print(console.final_state(hand.spec, hand.state))


def keyboard(
    config: Config = "sim_right",
    other: OtherHand = None,
    view: Annotated[bool, typer.Option(help="Watch in Rerun's own window.")] = False,
    web: Annotated[bool, typer.Option(help="Watch in the browser.")] = False,
) -> None:
    """The manufacturer's keys on a live hand: h r g k p m e a o 1 2 3; ? helps, q quits."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand import keys
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.surfaces.cli.run.looking import show_live
    from allegro_twin.surfaces.hand import Hand

    if view and web:
        raise ConfigError("--view and --web are two ways to watch one hand: choose one")
    with Hand.open(on_hand(load_config(config), other), background=sys.stdin.isatty()) as hand:
        if view or web:
            show_live(hand, web=web)
        keys.play(hand, sys.stdin, lambda line: console.console.print(line, highlight=False, markup=False))


def calibrate_limits(
    config: Config = "sim_right",
    other: OtherHand = None,
    by_hand: Annotated[
        float | None,
        typer.Option(help="You move the joints to their ends, for so many seconds.", callback=options.positive),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(help="The hand's own file; without it nothing is written.", callback=options.file(".yaml")),
    ] = None,
    offsets: Annotated[
        bool,
        typer.Option(
            "--offsets", help="Also write encoder offsets that put each joint's middle where the model has it."
        ),
    ] = False,
) -> None:
    """Bring every joint to both its ends and store the real limits."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand import calibration
    from allegro_twin.surfaces.cli.performers import on_hand

    if offsets and into is None:
        raise ConfigError("--offsets are written into the hand's own file: name it with --into")
    settings = on_hand(load_config(config), other)
    codec = calibration.codec_with_encoders(settings, config) if offsets else None
    if into is not None:
        calibration.refuse_another_hand(into, settings, config, codec)
    with console.progress() as bar:
        task = bar.add_task("to both ends of every joint", total=None)
        model, found = calibration.find_limits(
            settings, by_hand, lambda t, total: bar.update(task, completed=t, total=total)
        )
    console.console.print(console.limits(model, found))
    if into is not None:
        note = calibration.note(config if other is None else f"{config} --hand {other}", by_hand)
        if codec is None:
            calibration.store_limits(into, found, note)
        else:
            calibration.store_offsets(into, found, model, codec, note)
        what = "Limits" if codec is None else "Limits and encoder offsets"
        console.console.print(f"{what} are in {into}; use it with `hand: {{serial: {into}}}`", soft_wrap=True)


def show(
    config: Config = "sim_right",
    other: OtherHand = None,
) -> None:
    """The joints of a hand: the model's limits, the measured ones, the margin, and the motors."""
    from allegro_twin.app.config import load_config
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand

    settings = on_hand(load_config(config), other)
    model = load_spec(settings.hand.model, settings.hand.side)
    mine = load_spec(settings.hand.model, settings.hand.side, settings.hand.serial)
    if settings.limits.margin < 0:
        raise ConfigError(f"{config}: limits.margin is negative: only calibration may go beyond the limits")
    console.console.print(console.identity(model, mine, settings.limits.margin))
