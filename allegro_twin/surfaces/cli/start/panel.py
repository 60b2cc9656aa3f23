"""The command `panel`: control a hand from a browser."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion, options
from allegro_twin.surfaces.cli.options import OtherHand


class OnDisconnect(StrEnum):
    hold = "hold"
    limp = "limp"


def panel(
    config: Annotated[
        str, typer.Argument(help="Config of the hand, by path or name.", autocompletion=completion.configs)
    ] = "sim_right",
    other: OtherHand = None,
    host: Annotated[str, typer.Option(help="Address to serve. Beyond this computer a token is needed.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="TCP port of the page.", callback=options.port)] = 8080,
    token: Annotated[
        Path | None,
        typer.Option("--token-file", help="File with the token for --host; default: a random token, printed."),
    ] = None,
    gone: Annotated[
        OnDisconnect, typer.Option(help="What the hand does when the controlling browser is gone: hold or go limp.")
    ] = OnDisconnect.hold,
    out: Annotated[Path, typer.Option(help="Folder for recordings.")] = Path("out"),
    into: Annotated[
        Path, typer.Option(help="Library file for taught postures and motions.", callback=options.file(".yaml"))
    ] = Path("library/taught.yaml"),
    browser: Annotated[bool, typer.Option(help="Open the page in this computer's browser.")] = False,
) -> None:
    """Control a hand from a browser, with a stop always in sight."""
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli import console
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.panel.hand_session import Folders, HandSessions
    from allegro_twin.surfaces.panel.host import Host
    from allegro_twin.surfaces.panel.page_process import PageServer
    from allegro_twin.viewing.rerun.server import browse

    settings = on_hand(load_config(config), other)
    pages = PageServer(host, port, gone.value, None if token is None else _token(token))

    def report(address: str) -> None:
        console.console.print(f"Open {address} (Ctrl-C ends it)", soft_wrap=True, highlight=False, markup=False)
        if browser:
            browse(address)

    try:
        Host(HandSessions(settings, Folders(out, into)), pages).serve(report)
    except KeyboardInterrupt:
        return


def _token(path: Path) -> str:
    from allegro_twin.surfaces.panel.access import checked

    try:
        return checked(path.read_text().strip())
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--token-file {path}: cannot be read ({error})") from error
