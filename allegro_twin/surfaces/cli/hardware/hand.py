"""Commands about hands: show one, make the card of a new one, calibrate one."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.options import Config, OtherHand

if TYPE_CHECKING:
    from allegro_twin.sim.hand_import.explore import ExploredHand
    from allegro_twin.spec import HandSpec

hand = typer.Typer(name="hand", help="Group: `hand show` its data, `hand new` from an MJCF or URDF.")
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
    from allegro_twin.surfaces.cli.hand_override import block_with_file, on_hand
    from allegro_twin.surfaces.cli.twin.identification import today
    from allegro_twin.twin.identify import joint_ends as calibration
    from allegro_twin.twin.identify.motions.limits import check_both_ends, encoder_offsets

    if offsets and into is None:
        raise ConfigError("--offsets are written into the hand's own file: name it with --into")
    settings = on_hand(load_config(config), other)
    codec = calibration.codec_with_encoders(settings, config) if offsets else None
    if into is not None:
        calibration.refuse_another_hand(into, settings, config, codec)
    with options.interruptible(into, otherwise="no limits are found"), console.progress() as bar:
        task = bar.add_task("to both ends of every joint", total=None)
        model, found = calibration.find_limits(
            settings, by_hand, lambda t, total: bar.update(task, completed=t, total=total)
        )
    console.console.print(console.limits(model, found))
    check_both_ends(found, model)
    if into is None:
        console.hint("Next: --into FILE writes these limits into the hand's own file")
    else:
        note = calibration.note(config if other is None else f"{config} --hand {other}", by_hand, today())
        if codec is None:
            calibration.store_limits(into, found, model, note)
        else:
            calibration.store_offsets(into, encoder_offsets(found, model, codec), model, codec, note)
        what = "Limits" if codec is None else "Limits and encoder offsets"
        console.say(f"{what} are in {into}; use it with `{block_with_file(into, model.side)}`")


@hand.command()
def show(
    which: Annotated[
        str | None,
        typer.Argument(
            metavar="[HAND]",
            help="A hand's name, file or card; default: that of --config.",
            autocompletion=completion.hands,
        ),
    ] = None,
    config: Config = "sim_right",
) -> None:
    """Show a hand's joints: limits of the model and measured ones, margin, motors."""
    from allegro_twin.app.config import load_config
    from allegro_twin.app.rig import spec_of
    from allegro_twin.files.assets import read_yaml
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand

    if which is not None and Path(which).is_file() and {"hand", "backend"} & read_yaml(Path(which)).keys():
        raise ConfigError(f"{which} is a config, not a hand: --config {which} shows its hand")
    settings = on_hand(load_config(config), which)
    model = load_spec(settings.hand.model, settings.hand.side)
    mine = spec_of(settings)
    if settings.limits.margin < 0:
        raise ConfigError(f"{config}: limits.margin is negative: only calibration may go beyond the limits")
    console.console.print(console.identity(model, mine, settings.limits.margin))


@hand.command()
def new(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="MJCF with actuators, or URDF, of a hand or gripper.")],
    name: Annotated[str | None, typer.Option(help="Name of the hand; default: the file's name.")] = None,
    root: Annotated[str | None, typer.Option(help="Body that stands still, if several are possible.")] = None,
    palm: Annotated[str | None, typer.Option(help="Body on which the fingers begin, if the guess is wrong.")] = None,
    finger: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=BODY", help="A finger and the body that ends it; again for each; default: guessed."),
    ] = None,
    side: Annotated[Literal["right", "left"], typer.Option(help="Which hand it is.")] = "right",
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("mine"),
    force: Annotated[bool, typer.Option(help="Overwrite existing files.")] = False,
    film: Annotated[bool, typer.Option("--film/--no-film", help="Film each joint as it moves (10 s).")] = True,
    check: Annotated[Path | None, typer.Option(metavar="CARD", help="Write nothing; compare this card.")] = None,
) -> None:
    """Make the card of a hand from its MJCF or URDF, a config that runs it, a page, a picture and a film.

    The card lists the driven joints and their ranges, the joints that follow, and guesses of fingers and palm."""
    from allegro_twin.hands.description.specs import names_shipped_hand
    from allegro_twin.sim.hand_import.explore import explore_hand

    called = name or model.stem
    if not called.isidentifier():
        raise ConfigError(f"--name {called!r}: a hand's name is letters, digits and _, for files are called after it")
    if out.suffix in (".yaml", ".yml", ".xml"):
        raise ConfigError(f"--out {out}: it is a folder, into which several files are written; --name names the hand")
    pairs = [_pair(each) for each in finger or ()]
    fingers = dict(pairs)
    if len(fingers) < len(pairs):
        raise ConfigError(f"--finger {next(name for name, _ in pairs if [n for n, _ in pairs].count(name) > 1)}: twice")
    if check is not None:
        _check(check, explore_hand(model, root, palm, fingers))
        return
    if names_shipped_hand(called):
        raise ConfigError(f"{called} is a hand that ships, whose postures and grasps are not this one's: say --name "
                          f"my_{called}")  # fmt: skip
    card, config = out / f"{called}.yaml", out / f"sim_{called}.yaml"
    for path in (card, config):
        if path.exists() and not force:
            raise ConfigError(f"{path} is there already: --force writes over it, --name calls the hand something else")
    _write_hand(model, called, side, out, explore_hand(model, root, palm, fingers, side), film=film)


def _pair(text: str) -> tuple[str, str]:
    name, equals, body = text.partition("=")
    if not (name.isidentifier() and equals and body):
        raise ConfigError(f"--finger {text}: it is NAME=BODY, such as thumb=th_tip")
    return name, body


def _write_hand(
    model: Path, called: str, side: Literal["right", "left"], out: Path, found: ExploredHand, *, film: bool
) -> None:
    """Write card, config, page, picture and film; of a URDF also the MJCF."""
    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.files.yaml_edit import write_settings
    from allegro_twin.grasping.plan.proposals.opposition import card_postures
    from allegro_twin.hands.description.specs import load_spec
    from allegro_twin.sim.hand_import.page import hand_page
    from allegro_twin.sim.hand_import.urdf import is_urdf, write_mjcf
    from allegro_twin.surfaces.cli import console

    card, config, source = out / f"{called}.yaml", out / f"sim_{called}.yaml", model
    out.mkdir(parents=True, exist_ok=True)
    if is_urdf(model):
        source = out / f"{called}.xml"
        write_mjcf(found.spec, source)
    content = found.card | {"mjcf": os.path.relpath(source.resolve(), out.resolve()), "side": side}
    head = f"{called}: written by `allegro-twin hand new` from {model.name}; `palm`, `fingers`, `postures` are guesses."
    write_settings(card, content, head)
    try:
        postures, more = card_postures(load_spec(str(card), side))
    except ConfigError as error:
        console.warn(f"no postures in the card: {error}")
    else:
        found.notes.extend(more)
        content["postures"] = {name: posture.tolist() for name, posture in postures.items()}
        write_settings(card, content, head)
    kind = "pd" if content["commands"] == ["torque"] else "position"
    task = {"task": {"posture": "home"}} if "postures" in content else {}
    run = (
        {"hand": {"model": card.name, "side": side}, "backend": {"kind": "sim"}} | task | {"controller": {"kind": kind}}
    )
    write_settings(config, run, f"{called} in simulation.")
    for note in found.notes:
        console.console.print(f"Note: {note}", soft_wrap=True, highlight=False, markup=False)
    filmed = _picture(load_spec(str(card), side), out / called, film=film)
    with atomic_file(out / f"{called}.md") as temporary:
        temporary.write_text(hand_page(called, model.name, content, found.notes, filmed))
    driven, followers = len(content["driven"]), len(content.get("followers", ()))
    typed = f"allegro-twin run {shlex.quote(str(config))} --image {shlex.quote(f'{called}.png')}"
    console.console.print(
        f"Wrote {card}: {driven} driven, {followers} following, fingers {', '.join(content['fingers']) or 'none'}. "
        f"What is known, guessed and missing: {out / called}.md. Next: {typed}",
        soft_wrap=True,
    )


def _picture(spec: HandSpec, stem: Path, *, film: bool) -> bool:
    """A picture, and a film; whether there is a film. Where nothing can be rendered that is said, and all else goes
    on."""
    from allegro_twin.surfaces.cli import console

    try:
        from allegro_twin.viewing.hand_portrait import HandPortrait

        portrait = HandPortrait(spec)
    except (ConfigError, ImportError) as error:
        console.warn(f"no picture of the hand: {error}")
        return False
    try:
        portrait.still(stem.with_suffix(".png"))
        if film:
            portrait.film(stem.with_suffix(".mp4"))
    except ConfigError as error:
        console.warn(str(error))
        return False
    finally:
        portrait.close()
    return film


def _check(path: Path, found: ExploredHand) -> None:
    """Print where a card and the file that it names say different things. Raises ConfigError if they do."""
    from allegro_twin.files.assets import read_yaml
    from allegro_twin.sim.hand_import.explore import measured_stiffness
    from allegro_twin.surfaces.cli import console

    card = read_yaml(path)
    if "driven" not in card:
        raise ConfigError(f"{path}: no card of a hand: it has no `driven`")
    measured = measured_stiffness(found)
    rows = [row | ({"stiffness": measured[row["name"]]} if row["name"] in measured else {}) for row in
            found.card["driven"]]  # fmt: skip
    differences = card_differences(card, found.card | {"driven": rows})
    for line in differences:
        console.console.print(line, soft_wrap=True, highlight=False, markup=False)
    if differences:
        many = "1 value differs" if len(differences) == 1 else f"{len(differences)} values differ"
        raise ConfigError(f"{path}: {many} from the file; `hand new --force` writes it anew")
    console.say(f"{path}: as its file")


def card_differences(card: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """A line for each quantity of a card that its file says otherwise; what only a person can know is left alone."""
    lines = []
    for block in ("root", "commands", "palm", "wrist"):
        lines += _differences(block, card.get(block), found.get(block))
    for block in ("driven", "followers"):
        mine = {row["name"]: row for row in card.get(block, ())}
        theirs = {row["name"]: row for row in found.get(block, ())}
        for name in {**theirs, **mine}:
            lines += _differences(f"{block} {name}", mine.get(name), theirs.get(name))
    for name in {**found["fingers"], **card.get("fingers", {})}:
        lines += _differences(f"finger {name}", card.get("fingers", {}).get(name), found["fingers"].get(name))
    return lines


def _differences(name: str, mine: Any, theirs: Any) -> list[str]:
    """Lines that say a quantity with the card's value and the file's."""
    if mine == theirs:
        return []
    if isinstance(mine, Mapping) and isinstance(theirs, Mapping):
        return [line for key in {**theirs, **mine} for line in _differences(f"{name}, {key}", mine.get(key),
                                                                           theirs.get(key))]  # fmt: skip
    if mine is None or theirs is None:
        return [f"{name}: {'not in the card' if mine is None else 'in the card'}, "
                f"{'not in the file' if theirs is None else 'in the file'}"]  # fmt: skip
    if name.endswith("positions") and len(mine) == len(theirs):
        place = max(range(len(mine)), key=lambda k: abs(mine[k] - theirs[k]))
        return [f"{name}: {mine[place]:g} in the card, {theirs[place]:g} in the file, at place {place + 1} of "
                f"{len(mine)}, where they differ most"]  # fmt: skip
    return [f"{name}: {_words(mine)} in the card, {_words(theirs)} in the file"]


def _words(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return " ".join(map(_words, value)) if isinstance(value, list | tuple) else str(value)
