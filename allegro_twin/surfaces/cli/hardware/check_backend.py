"""The command `check-backend`: a backend against the contract, rule by rule."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin._lazy import import_user_module
from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion

if TYPE_CHECKING:
    from allegro_twin.backend import HandBackend

BROKEN = 5
"""Exit code for a broken rule."""
_MARKS = {"kept": "[green]kept[/]", "broken": "[red]broken[/]", "does not apply": "[dim]does not apply[/]"}


def check_backend(
    backend: Annotated[
        str,
        typer.Argument(
            help="PACKAGE:FACTORY, called without arguments; or a config.",
            autocompletion=completion.configs,
        ),
    ],
) -> None:
    """Check a backend against the contract; the hand moves a little.

    The exit code is 5 if a rule is broken."""
    from rich.markup import escape
    from rich.table import Table

    from allegro_twin.surfaces.cli.console import console, say
    from allegro_twin.testing import check_backend as check

    make = _factory(backend)
    table = Table("rule", "", "", title=f"The backend contract: {backend}", title_justify="left")
    broken = 0
    for result in check(make):
        broken += result.outcome == "broken"
        table.add_row(result.rule, _MARKS[result.outcome], escape(result.text))
    console.print(table)
    if broken:
        what = "1 rule is" if broken == 1 else f"{broken} rules are"
        say(f"{what} broken; docs/contract.md says what each is for")
        raise typer.Exit(BROKEN)
    console.print("The contract is kept.")


def _factory(name: str) -> Callable[[], HandBackend]:
    """The function that opens the backend. Raises ConfigError."""
    module, colon, attribute = name.partition(":")
    if not colon:
        from allegro_twin.app.config import load_config
        from allegro_twin.app.rig import open_backend

        config = load_config(name)
        return lambda: open_backend(config)
    try:
        found = getattr(import_user_module(module), attribute, None)
    except ImportError as error:
        raise ConfigError(f"{name}: no module {module!r} can be imported: {error}") from error
    if not callable(found):
        raise ConfigError(f"{name}: {attribute!r} in {module} is nothing that can be called")

    def opened() -> HandBackend:
        made = found()
        if not hasattr(made, "reset") or not hasattr(made, "spec"):
            raise ConfigError(f"{name}: it returns {type(made).__name__}, which is no backend")
        return made  # type: ignore[no-any-return]

    opened().close()
    return opened
