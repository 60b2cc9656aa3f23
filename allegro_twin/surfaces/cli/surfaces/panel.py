"""The command that serves the panel."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import complete, options
from allegro_twin.surfaces.cli.options import OtherHand


class Gone(StrEnum):
    hold = "hold"
    limp = "limp"


def register(app: typer.Typer) -> None:
    """Add this command to the command line."""
    app.command()(panel)


def panel(
    config: Annotated[
        str, typer.Argument(help="Which hand: a config by path or name.", autocompletion=complete.configs)
    ] = "sim_right",
    other: OtherHand = None,
    host: Annotated[
        str, typer.Option(help="The address to serve. Another than this computer's own needs a token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Of the page in the browser.", callback=options.port)] = 8080,
    token: Annotated[
        Path | None,
        typer.Option("--token-file", help="A file with the token for --host; without it one is made up and printed."),
    ] = None,
    gone: Annotated[
        Gone, typer.Option(help="What the hand does when nobody drives any more: a tab closed, a network lost.")
    ] = Gone.hold,
    out: Annotated[Path, typer.Option(help="Folder for recordings.")] = Path("out"),
    into: Annotated[Path, typer.Option(help="Library file for what is taught.", callback=options.file(".yaml"))] = Path(
        "library/taught.yaml"
    ),
    browser: Annotated[bool, typer.Option(help="Open the page in this computer's browser.")] = False,
) -> None:
    """Drive a hand from a browser: any config, with a stop that is always in sight."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.surfaces.panel.hand_session import Folders, HandSessions
    from allegro_twin.surfaces.panel.host import Host
    from allegro_twin.surfaces.panel.page_process import PageServer
    from allegro_twin.viewing.rerun.server import browse

    settings = on_hand(load_config(config), other)
    pages = PageServer(host, port, gone.value, None if token is None else _token(token))

    def tell(address: str) -> None:
        console.console.print(f"Open {address} (Ctrl-C ends it)", soft_wrap=True, highlight=False, markup=False)
        if browser:
            browse(address)

    try:
        Host(HandSessions(settings, Folders(out, into)), pages).serve(tell)
    except KeyboardInterrupt:
        return


def _token(path: Path) -> str:
    from allegro_twin.surfaces.panel.access import checked

    try:
        return checked(path.read_text().strip())
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--token-file {path}: cannot be read ({error})") from error
