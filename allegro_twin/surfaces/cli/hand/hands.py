"""The commands about hands: what is known of one, and the card of another."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli.hand.live import show


def register(app: typer.Typer) -> None:
    """Add these commands to the command line."""
    hand = typer.Typer(help="What is known of a hand, and the card of another.")
    hand.command()(show)
    hand.command()(new)
    app.add_typer(hand, name="hand")


def new(
    model: Annotated[Path, typer.Argument(metavar="MODEL.xml", help="An MJCF of a hand or gripper, with actuators.")],
    name: Annotated[str | None, typer.Option(help="Of the hand; the file's otherwise.")] = None,
    root: Annotated[str | None, typer.Option(help="The body that is the palm, where several could be.")] = None,
    side: Annotated[Literal["right", "left"], typer.Option(help="Which hand it is.")] = "right",
    out: Annotated[Path, typer.Option(help="Where to write.")] = Path("mine"),
    force: Annotated[bool, typer.Option(help="Write over what is there.")] = False,
) -> None:
    """Write the card of a hand from its MJCF, and a config that runs it: what is driven and how far, what follows, and
    guesses of its fingers and of where its palm looks."""
    from allegro_twin.files.yaml_edit import write_settings
    from allegro_twin.sim.mjcf_import.explore import explore_mjcf
    from allegro_twin.surfaces.cli import console

    called = name or model.stem
    if not called.isidentifier():
        raise ConfigError(f"--name {called!r}: a hand's name is letters, digits and _, for files are called after it")
    card, config = out / f"{called}.yaml", out / f"sim_{called}.yaml"
    for path in (card, config):
        if path.exists() and not force:
            raise ConfigError(f"{path} is there already: --force writes over it, --name calls the hand something else")
    found = explore_mjcf(model, root)
    content = found.card | {"mjcf": os.path.relpath(model.resolve(), out.resolve()), "side": side}
    write_settings(
        card,
        content,
        f"{called}: written by `allegro-twin hand new` from {model.name}; `palm` and `fingers` are guesses.",
    )
    kind = "pd" if content["commands"] == ["torque"] else "position"
    run = {"hand": {"model": str(card), "side": side}, "backend": {"kind": "sim"}, "controller": {"kind": kind}}
    write_settings(config, run, f"{called} in simulation. Run it from the folder in which it was written.")
    for note in found.notes:
        console.console.print(f"Note: {note}", soft_wrap=True)
    driven, followers = len(content["driven"]), len(content.get("followers", ()))
    console.console.print(
        f"Wrote {card}: {driven} driven, {followers} following, fingers {', '.join(content['fingers']) or 'none'}. "
        f"Look at it: allegro-twin run {config} --image {called}.png",
        soft_wrap=True,
    )
