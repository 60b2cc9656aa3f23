"""Options that several commands share, and the checks that run before a command begins."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from allegro_twin.errors import ConfigError, HandError, RecordingError
from allegro_twin.surfaces.cli import completion, console

OUTPUT = "Output"
"""Panel of the options that say what a command writes and shows."""
TRIALS = "Trials"
"""Panel of the options about uncertainty, seeds and budgets."""
COMPUTE = "Compute"
"""Panel of the options about processes and clusters."""
MESH = "Mesh objects"
"""Panel of the options for an object that is a mesh."""
POLICY = "Policies"
"""Panel of the options that a policy takes."""
HAND = "allegro"
"""The model of hand where none is named."""


class Sides(StrEnum):
    """Side of the hand that a command runs."""

    right = "right"
    left = "left"
    both = "both"


class Recordings(StrEnum):
    """Trials that get a Rerun recording."""

    ends = "ends"
    """The best and the worst of each object."""
    all = "all"


class Engines(StrEnum):
    """Engine of a sweep."""

    local = "local"
    ray = "ray"


Count = Annotated[
    int | None,
    typer.Option("--jobs", min=1, help="Processes; default: one for each core.", rich_help_panel=COMPUTE),
]

OtherGrasp = Annotated[
    str | None, typer.Option(help="Use this grasp, not the scenario's.", autocompletion=completion.grasps)
]
OtherObject = Annotated[
    str | None,
    typer.Option(
        "--object",
        help="Use this object, not the scenario's first: a name of the catalogue, or an .obj or .stl.",
        autocompletion=completion.objects,
    ),
]
Config = Annotated[
    str,
    typer.Option("--config", "-c", help="Config of the hand, by path or name.", autocompletion=completion.configs),
]
OtherHand = Annotated[
    str | None,
    typer.Option(
        "--hand",
        help="Use another hand: a file of conf/hands, by path or name (`list hands`).",
        autocompletion=completion.hands,
    ),
]
TrainedHand = Annotated[
    str | None,
    typer.Option(
        "--hand",
        help="Model of hand, or a card; default: the recipe's. With a task: its defaults for this hand.",
        autocompletion=completion.models,
    ),
]


def positive(param: typer.CallbackParam, value: float | None) -> float | None:
    """Callback for a time or a count: it must be positive and finite. Raises ConfigError."""
    if value is not None and not 0 < value < math.inf:
        raise ConfigError(f"{option(param)} must be positive and finite, not {value}")
    return value


def port(param: typer.CallbackParam, value: int | None) -> int | None:
    """Callback for a TCP port, 1 to 65535. Raises ConfigError."""
    if value is not None and not 1 <= value <= 65535:
        raise ConfigError(f"{option(param)} must be a TCP port, 1 to 65535, not {value}")
    return value


def folder(context: typer.Context, param: typer.CallbackParam, value: Path | None) -> Path | None:
    """Callback for an output folder: it is made, and locked for this command until it ends. Raises
    RecordingError."""
    if value is None or context.resilient_parsing:  # Shell completion only.
        return value
    from allegro_twin.files.output_folder import lock_folder

    try:
        context.with_resource(lock_folder(value))
    except RecordingError as error:
        raise RecordingError(f"{option(param)} {error}") from error
    return value


@contextmanager
def run_folder(folder: Path, last: str = "") -> Iterator[Path]:
    """Lock an output folder that this run replaces as a whole. After an interruption or a fault the unfinished files
    stay in a subfolder, and the message names it."""
    from allegro_twin.files.output_folder import UNFINISHED, write_run

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


@contextmanager
def interruptible(
    *files: Path | None, then: str = "", otherwise: str = "", progress: Callable[[], str] | None = None
) -> Iterator[None]:
    """Where Ctrl-C ends the block, say `progress`, which of its files have what came until then, and `then` of them.
    `otherwise`: what is said where no file is asked for."""
    asked = [file for file in files if file is not None]
    before = {file: _written(file) for file in asked}
    try:
        yield
    except KeyboardInterrupt:
        kept = [str(file) for file in asked if _written(file) not in (None, before[file])]
        missing = [str(file) for file in asked if str(file) not in kept]
        said = [] if progress is None else [progress()]
        said += [f"what came until then is in {', '.join(kept)}{then}"] if kept else []
        said += [f"{', '.join(missing)} not written"] if missing else []
        said += [otherwise] if otherwise and not asked else []
        if said:
            console.warn(f"interrupted: {'; '.join(said)}")
        raise


def _written(file: Path) -> tuple[int, int, int] | None:
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size


def end_unwritten(message: str, code: int = 0) -> NoReturn:
    """End a command that has printed its result, and of whose files one could not be written. `code`: what the result
    alone ends with; where that is 0, raises RecordingError."""
    if code == 0:
        raise RecordingError(message)
    console.warn(message)
    raise typer.Exit(code)


def file(*suffixes: str) -> Callable[[typer.CallbackParam, Path | None], Path | None]:
    """Callback for an output file with one of these suffixes. It raises ConfigError or RecordingError before the work
    begins."""

    def check(param: typer.CallbackParam, value: Path | None) -> Path | None:
        if value is None:
            return None
        if value.suffix not in suffixes:
            raise ConfigError(f"{option(param)} {value}: must end in {' or '.join(suffixes)}")
        from allegro_twin.files.assets import refuse_shipped
        from allegro_twin.files.atomic_write import check_place

        refuse_shipped(value)
        check_place(value)
        return value

    return check


film = file(".mp4", ".mkv", ".mov")
"""Callback for a film that is to be written: what `viewing.films` writes."""


def refuse_mesh(path: Path) -> None:
    """Raise ConfigError for a mesh or a scan where a config is wanted."""
    from allegro_twin.sim.objects.meshes import SUFFIXES

    if path.suffix.lower() in SUFFIXES:
        way = f"`allegro-twin plan {path}`, or `lab lab_allegro --object {path}`"
        raise ConfigError(f"{path} is a mesh or a scan, not a config: {way}")


def option(param: typer.CallbackParam) -> str:
    """The name of an option as the user types it."""
    return str(param.opts[0])
