"""What many options have in common: what they take, what they refuse before anything begins, and what may follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from allegro_twin.errors import ConfigError, HandError, RecordingError
from allegro_twin.files.assets import refuse_shipped
from allegro_twin.files.atomic_write import check_place
from allegro_twin.files.output_folder import UNFINISHED, lock_folder, write_run
from allegro_twin.surfaces.cli import complete, console

Config = Annotated[
    str,
    typer.Option("--config", "-c", help="Which hand: a config by path or name.", autocompletion=complete.configs),
]
OtherHand = Annotated[
    str | None,
    typer.Option(
        "--hand",
        help="Another hand: a file of conf/hands by path or name; `list hands`.",
        autocompletion=complete.hands,
    ),
]
TrainedHand = Annotated[
    str | None,
    typer.Option(
        "--hand",
        help="A model of hand, or a card; default: the recipe's. With the name of a task its defaults, for that hand.",
        autocompletion=complete.models,
    ),
]


def positive(param: typer.CallbackParam, value: float | None) -> float | None:
    """A callback for a time or a count that must be above zero, and finite. Raises ConfigError."""
    if value is not None and not 0 < value < math.inf:
        raise ConfigError(f"{option(param)} must be positive and finite, not {value}")
    return value


def port(param: typer.CallbackParam, value: int) -> int:
    """A callback for a TCP port that can be said beforehand. Raises ConfigError."""
    if not 1 <= value <= 65535:
        raise ConfigError(f"{option(param)} must be a TCP port, 1 to 65535, not {value}")
    return value


def folder(context: typer.Context, param: typer.CallbackParam, value: Path | None) -> Path | None:
    """A callback for a folder to write into, which is made, and this command's alone until it ends. Raises
    RecordingError."""
    if value is None or context.resilient_parsing:  # The shell asks what may follow.
        return value
    try:
        context.with_resource(lock_folder(value))
    except RecordingError as error:
        raise RecordingError(f"{option(param)} {error}") from error
    return value


@contextmanager
def run_folder(folder: Path, last: str = "") -> Iterator[Path]:
    """`write_run` of a folder, with what was recorded before an interruption or a fault kept, and said."""
    try:
        with write_run(folder, last, keep=True) as staging:
            yield staging
    except BaseException as error:
        if (folder / UNFINISHED).exists():
            said = f"what was written until then is in {folder / UNFINISHED}; the rest of {folder} is as it was"
            if isinstance(error, HandError):
                error.args = (f"{error}; {said}",)  # An error is one line.
            else:
                console.warn(said)
        raise


def file(*suffixes: str) -> Callable[[typer.CallbackParam, Path | None], Path | None]:
    """A callback for a file to write, with one of these suffixes. It raises ConfigError or RecordingError now, and not
    when the work is done."""

    def check(param: typer.CallbackParam, value: Path | None) -> Path | None:
        if value is None:
            return None
        if value.suffix not in suffixes:
            raise ConfigError(f"{option(param)} {value}: must end in {' or '.join(suffixes)}")
        refuse_shipped(value)
        check_place(value)
        return value

    return check


def option(param: typer.CallbackParam) -> str:
    """What the user calls it."""
    return str(param.opts[0])
