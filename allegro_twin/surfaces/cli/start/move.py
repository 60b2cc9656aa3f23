"""Commands that move a hand: go to a posture, grasp, teach, play, the keyboard."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.options import Config, OtherHand

Seconds = Annotated[float, typer.Option(help="Duration on the hand's clock, s.", callback=options.positive)]


def posture(
    name: Annotated[
        str,
        typer.Argument(
            help="A posture of the library; `allegro-twin list postures`.", autocompletion=completion.postures
        ),
    ],
    config: Config = "sim_right",
    other: OtherHand = None,
    speed: Annotated[float, typer.Option(help="Peak speed of the joint with the longest path, rad/s.")] = 1.0,
) -> None:
    """Go to a posture and print the joint positions."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.hand import Hand

    with Hand.open(on_hand(load_config(config), other)) as hand:
        hand.move_to(name, speed)
        console.console.print(console.final_state(hand.spec, hand.state))


def grasp(
    name: Annotated[
        str,
        typer.Argument(help="A grasp of the library; `allegro-twin list grasps`.", autocompletion=completion.grasps),
    ],
    config: Config = "sim_right",
    other: OtherHand = None,
    width: Annotated[float | None, typer.Option(help="Width of the object, m.")] = None,
    force: Annotated[float | None, typer.Option(help="Force on the thumb, N; for an envelop grasp a factor.")] = None,
) -> None:
    """Close a grasp and print the forces of the fingers.

    The exit code is 5 if nothing as wide as --width is there."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.hand import Hand

    with Hand.open(on_hand(load_config(config), other)) as hand:
        grasped = hand.grasp(name, object_width=width, force=force)
        console.console.print(console.grasp_forces(grasped))
    if grasped.empty:
        raise typer.Exit(5)


def teach(
    name: Annotated[str, typer.Argument(help="Its name in the library.")],
    config: Config = "sim_right",
    other: OtherHand = None,
    seconds: Seconds = 10.0,
    into: Annotated[Path, typer.Option(help="Library file to store it in.", callback=options.file(".yaml"))] = Path(
        "library/taught.yaml"
    ),
    motion: Annotated[bool, typer.Option(help="Store the motion, not only the final posture.")] = False,
    force: Annotated[bool, typer.Option(help="Replace an entry of that name in the file.")] = False,
) -> None:
    """Store a posture or motion that you show with your hands."""
    from allegro_twin.app.config import load_config
    from allegro_twin.app.rig import spec_of
    from allegro_twin.hands.description.specs import card_side
    from allegro_twin.hands.library.entries import posture_entry, trajectory_entry
    from allegro_twin.hands.library.library import Library, found_later
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.hand import Hand

    settings, library = on_hand(load_config(config), other), Library()
    old = library.check_store(name, into, spec_of(settings))
    if old is not None and not force:
        raise ConfigError(f"{name!r} is a {old.kind} in {into} already: --force replaces it, or choose another name")
    opened = Hand.open(settings, background=sys.stdin.isatty())
    with options.interruptible(into), opened as hand:
        limp = "" if "gravity" in hand.controllers else ", which nothing holds: support them"
        console.say(f"Move the fingers{limp}; {seconds:g} s from now on.")
        with hand.teach() as demonstration:
            hand.wait(seconds)
        if motion:
            shown = demonstration.motion()
            library.add(name, trajectory_entry(shown.times, shown.positions, hand.spec), hand.spec)
        else:
            library.add(name, posture_entry(demonstration.posture(), hand.spec), hand.spec)
        library.store(name, into)
    console.warn(demonstration.clipped(motion=motion))
    both = ", for the right and the left hand" if card_side(hand.spec.model) is None else ""
    console.say(f"{name} is in {into}{both}")
    console.warn(found_later(into))


def play(
    name: Annotated[
        str,
        typer.Argument(
            help="A trajectory of the library; `allegro-twin list trajectories`.",
            autocompletion=completion.trajectories,
        ),
    ],
    config: Config = "sim_right",
    other: OtherHand = None,
    speed: Annotated[float, typer.Option(help="Speed factor; 1: as recorded.")] = 1.0,
    approach: Annotated[float, typer.Option(help="Peak speed on the way to its start, rad/s.")] = 1.0,
) -> None:
    """Play a trajectory of the library, print the joint positions."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
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
    """Control a hand with the manufacturer's keys; ? lists them."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.cli.start import keys
    from allegro_twin.surfaces.cli.start.view import show_live
    from allegro_twin.surfaces.hand import Hand

    if view and web:
        raise ConfigError("--view and --web are two ways to watch one hand: choose one")
    with Hand.open(on_hand(load_config(config), other), background=sys.stdin.isatty()) as hand:
        if view or web:
            show_live(hand, web=web)
        keys.play(hand, sys.stdin, lambda line: console.console.print(line, highlight=False, markup=False))
