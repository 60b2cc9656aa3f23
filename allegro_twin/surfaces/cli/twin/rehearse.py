"""The command `rehearse`: what motions and grasps that were made on a twin lose on one hand."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.app.config import RunConfig
    from allegro_twin.twin.rehearsal import HandRehearsal, RehearsalProtocol, RehearsedHand

CHANNEL = re.compile(r"v?s?l?can\d+")
"""A SocketCAN interface."""


def rehearse(
    config: Annotated[
        str,
        typer.Argument(
            help="Config of the hand, by path or name; or a SocketCAN interface, such as can0.",
            autocompletion=completion.configs,
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder to write; what is done there goes on.", callback=options.folder)
    ] = Path("out/rehearsal"),
    other: OtherHand = None,
    version: Annotated[str | None, typer.Option(help="Of a hand on an interface: v1 to v5plus.")] = None,
    side: Annotated[
        Literal["right", "left"] | None,
        typer.Option(help="Of a hand on an interface; default: as --hand says, else right."),
    ] = None,
    poses: Annotated[
        str | None, typer.Option(help="Poses that the hand can have, separated by commas; default: up,side,palm-up.")
    ] = None,
    grasps: Annotated[
        str | None,
        typer.Option(help="Close these scenarios' grasps too, separated by commas; in the air, but for a simulation."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the excitations.")] = 0,
    film: Annotated[bool, typer.Option("--film", help="Film grasps on simulated objects; in `films`.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask whether the hand lies in its poses.")] = False,
) -> None:
    """Rehearse on one hand what was made on its twin; 10 minutes.

    It checks the link, leads every joint to both its ends, excites the hand in each pose, identifies it, and then holds
    postures and follows a trajectory with the nominal hand and with the identified one. The hand is limp between the
    motions and after any end. After an interruption the same command continues."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.cli.twin import identification
    from allegro_twin.twin.rehearsal import HandRehearsal, RehearsedHand

    identification.check_scipy()
    settings = on_hand(config_of(config, version, side), other)
    protocol, hand = protocol_of(poses, grasps, seed), RehearsedHand(settings)
    if film:
        check_films(hand, protocol)
    asks = not yes and not hand.simulated
    if asks and not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise ConfigError(
            f"{config} moves a hand that a person must lay into {len(protocol.poses)} poses: run it in a terminal, or "
            "say --yes and --poses"
        )
    with console.progress() as bar:
        rehearsal = HandRehearsal(hand, protocol, out, identification.today(), conversation(bar, asks=asks),
                                  films=film)  # fmt: skip
        try:
            result = rehearsal.run()
        finally:
            bar.stop()
            if rehearsal.steps:
                console.errors.print(f"What was measured is in {out}", highlight=False, soft_wrap=True)
    show(rehearsal, result, out)
    if result["problems"]:
        raise typer.Exit(5)


def conversation(bar: Any, *, asks: bool) -> Any:
    """What is said on standard error, and asked there."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.twin.rehearsal import Conversation

    task = bar.add_task("", total=None)

    def place(pose: Any) -> bool:
        line = f"{pose.name}: {pose.instruction}. Every finger will move, step after step, for some minutes."
        if asks:
            bar.stop()
            console.errors.print(line, soft_wrap=True)
            typer.prompt("Press Enter when it lies so and nothing is near", default="", show_default=False, err=True)
            bar.start()
        return asks

    def begin(step: str) -> None:
        bar.update(task, description=step)
        if not sys.stderr.isatty():
            console.errors.print(step, highlight=False)

    return Conversation(place, place, begin, lambda t: bar.update(task, completed=t), console.warn)


def show(rehearsal: HandRehearsal, result: dict[str, Any], out: Path) -> None:
    """Print the score, what was not done or reached, and where the page is."""
    from rich.table import Table

    from allegro_twin.surfaces.cli import console
    from allegro_twin.twin.rehearsal import hidden_scores
    from allegro_twin.twin.rehearsal.page import NO_HANDS, score_rows

    hidden, twins = hidden_scores(), rehearsal.protocol.twins
    table = Table(title=f"Rehearsal of {rehearsal.spec.name}: {result['hand_s'] / 60.0:.1f} min of motion")
    for head in ("", *twins, "hidden hands", "among them"):
        table.add_column(head, justify="left" if not head else "right")
    for row in score_rows(result, hidden):
        table.add_row(*row)
    if table.row_count:
        console.console.print(table)
    console.console.print(NO_HANDS if hidden is None else hidden.about, highlight=False, soft_wrap=True)
    for note in rehearsal.notes:
        console.console.print(note, highlight=False, soft_wrap=True)
    for line in result["problems"]:
        console.warn(line)
    written = f"; the hand's file: {out / 'hand.yaml'}" if (out / "hand.yaml").exists() else ""
    console.say(f"Page: {out / 'report.html'}{written}")


def config_of(name: str, version: str | None, side: str | None) -> RunConfig:
    """A config by name, or that of a hand on a SocketCAN interface, under PD with the manufacturer's gains. Raises
    ConfigError."""
    from allegro_twin.app.config import RunConfig, load_config
    from allegro_twin.files.schema import parse_settings

    if not CHANNEL.fullmatch(name):
        if version is not None:
            raise ConfigError(f"--version is for a hand on an interface such as can0; {name} says its own")
        if side is not None:
            raise ConfigError(f"--side is for a hand on an interface such as can0; {name} says its own")
        return load_config(name)
    if version is None:
        raise ConfigError(f"{name} is an interface: say the hand's --version, v1 to v5plus")
    backend = {"kind": "can", "version": version, "interface": "socketcan", "channel": name}
    hand = {} if side is None else {"side": side}
    content = {"hand": hand, "backend": backend, "controller": {"kind": "pd", "gains": "v4"}}
    return parse_settings(RunConfig, content, name)


def check_films(hand: RehearsedHand, protocol: RehearsalProtocol) -> None:
    """Raise ConfigError where there is nothing to film, or nothing to film with."""
    from allegro_twin.viewing.films import check_av

    if not hand.simulated or not protocol.grasps:
        raise ConfigError(
            "--film films grasps on simulated objects: name --grasps and a config with a simulated scene; motions of a "
            "real hand are in recordings/, and `allegro-twin view` shows them"
        )
    check_av()


def protocol_of(poses: str | None, grasps: str | None, seed: int) -> RehearsalProtocol:
    """The steps that are wanted. Raises ConfigError for a pose or a scenario that does not exist."""
    from allegro_twin.grasping.scenario import load_scenario
    from allegro_twin.twin.identify import find_pose
    from allegro_twin.twin.rehearsal import RehearsalProtocol

    usual = RehearsalProtocol()
    chosen = tuple(usual.poses) if poses is None else _parts(poses) or ("",)
    for pose in chosen:
        find_pose(pose, "right")
    for scenario in _parts(grasps):
        load_scenario(scenario)
    seconds = {pose: usual.poses.get(pose, 16.0) for pose in chosen}
    return RehearsalProtocol(poses=seconds, grasps=_parts(grasps), seed=seed)


def _parts(text: str | None) -> tuple[str, ...]:
    return tuple(part.strip() for part in (text or "").split(",") if part.strip())
