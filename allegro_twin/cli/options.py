"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

Config = Annotated[str, typer.Option("--config", "-c", help="Which hand: a config by path or name.")]
OtherHand = Annotated[
    str | None, typer.Option("--hand", help="Another hand: a file of conf/hands by path or name; `list hands`.")
]
