"""Commands that show what the package contains: lists, environments, examples, the gallery of grasps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.surfaces.cli import completion, options


def list_(
    what: Annotated[
        str,
        typer.Argument(
            help="One kind, such as objects, grasps or policies; default: all.", autocompletion=completion.kinds
        ),
    ] = "",
) -> None:
    """List objects, grasps, scenarios, configs, hands, policies …"""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.start import catalogue

    kinds = catalogue.KINDS
    if what and what not in kinds:
        raise ConfigError(unknown("list", what, kinds))
    for kind in [what] if what else kinds:
        console.console.print(kinds[kind]())


def envs(
    task: Annotated[
        str,
        typer.Argument(help="One task; default: all.", autocompletion=completion.tasks),
    ] = "",
) -> None:
    """List the Gymnasium environments with their spaces."""
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.learning import envs as environments

    console.console.print(environments.environment_table(task))


def examples(
    folder: Annotated[Path, typer.Argument(help="Folder to copy into.", callback=options.folder)],
) -> None:
    """Copy the example scripts into a folder of your own."""
    from allegro_twin.files.assets import data_root
    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.surfaces.cli import console

    found = sorted(path for path in (data_root() / "examples").iterdir() if path.suffix in (".py", ".csv"))
    if there := [path.name for path in found if (folder / path.name).exists()]:
        raise ConfigError(f"{folder}: has {there[0]} already; give another folder")
    for path in found:
        with atomic_file(folder / path.name) as temporary:
            temporary.write_bytes(path.read_bytes())
    console.say(f"{len(found)} files in {folder}/: python {folder}/{found[0].name}")


def gallery(
    folder: Annotated[Path, typer.Argument(help="Folder for grasps.md and its pictures.", callback=options.folder)],
    draws: Annotated[int, typer.Option(min=0, help="Trials of each grasp under uncertainty.")] = 20,
) -> None:
    """Render every grasp of the library into a page."""
    from allegro_twin.surfaces.cli import console

    try:
        from allegro_twin.surfaces.cli.grasps.gallery import make
    except ImportError as error:
        raise ConfigError(f"a gallery needs Pillow: pip install 'allegro-twin[view]' ({error})") from error

    with console.progress() as bar:
        task = bar.add_task("grasps", total=None)
        count = make(folder, draws, lambda name: bar.update(task, description=name, advance=1))
    console.say(f"{count} grasps in {folder}/grasps.md")
