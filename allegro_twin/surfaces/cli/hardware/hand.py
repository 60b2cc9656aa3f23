"""Commands about hands: show one, make the card of a new one, calibrate one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import options
from allegro_twin.surfaces.cli.options import Config, OtherHand

hand = typer.Typer(name="hand", help="Group: `hand show` its data, `hand new` from an MJCF.")
calibrate = typer.Typer(name="calibrate", help="Group: `calibrate limits` measures a hand's joint ranges.")


@calibrate.callback()
def _group() -> None:
    """Measure a hand and write the result into its own file."""


@calibrate.command("limits")
def calibrate_limits(
    config: Config = "sim_right",
    other: OtherHand = None,
    by_hand: Annotated[
        float | None,
        typer.Option(help="Move the joints to their ends yourself, for this time, s.", callback=options.positive),
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(
            help="The hand's own file to write; without it nothing is written.", callback=options.file(".yaml")
        ),
    ] = None,
    offsets: Annotated[
        bool,
        typer.Option("--offsets", help="Also write encoder offsets that centre each joint's range on the model's."),
    ] = False,
) -> None:
    """Move every joint to both its ends and store the limits found."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.cli.hardware import calibration

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
    if into is None:
        console.hint("Next: --into FILE writes these limits into the hand's own file")
    else:
        note = calibration.note(config if other is None else f"{config} --hand {other}", by_hand)
        if codec is None:
            calibration.store_limits(into, found, note)
        else:
            calibration.store_offsets(into, found, model, codec, note)
        what = "Limits" if codec is None else "Limits and encoder offsets"
        console.console.print(f"{what} are in {into}; use it with `hand: {{serial: {into}}}`", soft_wrap=True)


@hand.command()
def show(
    config: Config = "sim_right",
    other: OtherHand = None,
) -> None:
    """Show a hand's joints: limits of the model and measured ones, margin, motors."""
    from allegro_twin.app.config import load_config
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand

    settings = on_hand(load_config(config), other)
    model = load_spec(settings.hand.model, settings.hand.side)
    mine = load_spec(settings.hand.model, settings.hand.side, settings.hand.serial)
    if settings.limits.margin < 0:
        raise ConfigError(f"{config}: limits.margin is negative: only calibration may go beyond the limits")
    console.console.print(console.identity(model, mine, settings.limits.margin))


@hand.command()
def new(
    model: Annotated[Path, typer.Argument(metavar="MODEL.xml", help="An MJCF of a hand or gripper, with actuators.")],
    name: Annotated[str | None, typer.Option(help="Name of the hand; default: the file's name.")] = None,
    root: Annotated[str | None, typer.Option(help="Body that is the palm, if several are possible.")] = None,
    side: Annotated[Literal["right", "left"], typer.Option(help="Which hand it is.")] = "right",
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("mine"),
    force: Annotated[bool, typer.Option(help="Overwrite existing files.")] = False,
) -> None:
    """Make the card of a hand from its MJCF, and a config that runs it.

    The card lists the driven joints and their ranges, the joints that follow, and guesses of fingers and palm."""
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
