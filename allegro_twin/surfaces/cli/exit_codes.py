"""Exit codes of the command line, one-line error messages, and signals."""

from __future__ import annotations

import io
import logging
import os
import shutil
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from types import FrameType
from typing import Any, NoReturn

import typer

from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, MotionInterrupted, MotionStalled
from allegro_twin.files import standard_streams
from allegro_twin.files.first_error import message_of
from allegro_twin.surfaces.cli.computer_errors import REINSTALL, computer_error

USAGE: type[Exception] = typer.BadParameter.__mro__[1]
"""The parser's usage error. Not every version of typer has a public name for it."""
HELP_WIDTH = 80
"""Columns that the help has at least."""
INTERRUPTED = 130
"""Exit code of a command that Ctrl-C ends: 128 and the number of the signal, as a shell counts it."""
_ENDS = [
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
]  # Windows has the first.


_ended_by: list[int] = []
"""The other signal that has ended this command."""


def run(app: typer.Typer, arguments: Sequence[str], program: str) -> NoReturn:
    """Run a command line and exit. Every HandError, every usage error and what this computer refuses is one line on
    standard error."""
    stop_on_signals()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # A terminal may lack a degree sign.
    if shutil.get_terminal_size().columns < HELP_WIDTH:  # Typer cuts names of options off in a narrower one.
        os.environ.setdefault("TERMINAL_WIDTH", str(HELP_WIDTH))
    logging.getLogger("can").addHandler(logging.NullHandler())  # python-can raises what it logs.
    try:
        code = _answer(app, arguments, program)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except standard_streams.OutputLost:
        code = 2
    if code == INTERRUPTED and _ended_by:
        code = 128 + _ended_by[0]
    if standard_streams.failed:
        complain(f"{program}: {standard_streams.failed[0]}")
    sys.exit(code or 2 if standard_streams.failed else code)


def complain(line: str) -> None:
    """Write a line to standard error, if it takes one."""
    with suppress(OSError):
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


def _answer(app: typer.Typer, arguments: Sequence[str], program: str) -> int:
    """Run a command line; the exit code. Raises BrokenPipeError, OutputLost, and faults of this package."""
    try:
        _check_none_empty(arguments)
        return int(app(list(arguments), prog_name=program, standalone_mode=False) or 0)
    except HandError as error:
        complain(f"{program}: {message_of(error)}")
        return exit_code(error)
    except USAGE as error:
        complain(usage_error(error))
        return 2
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except (BrokenPipeError, standard_streams.OutputLost):
        raise
    except Exception as error:
        if "KeyboardInterrupt" in str(error):  # It came while a library was loaded, in a callback from C.
            return INTERRUPTED
        doctor = "doctor" in arguments[:1]  # Which cannot say more of what it needs itself.
        if not (said := computer_error(error, REINSTALL) if doctor else computer_error(error)):
            raise
        complain(f"{program}: {said}")
        return 2


def _check_none_empty(arguments: Sequence[str]) -> None:
    """Raise ConfigError for an argument without a letter, of which a path would make the current folder."""
    before = ""
    for argument in arguments:
        name = argument.rstrip("=") if argument.startswith("--") else before
        if not argument or (argument.startswith("--") and argument.endswith("=")):
            what = name if name.startswith("-") else f"the argument after {name or 'allegro-twin'}"
            raise ConfigError(f"{what} is empty: give it a value, or leave it out (is a variable of the shell unset?)")
        before = argument


def exit_code(error: HandError) -> int:
    """3 for a link error, 4 for a fault or a motion that did not reach its end, 2 for what the user can correct."""
    if isinstance(error, LinkError):
        return 3
    return 4 if isinstance(error, (HandFault, MotionStalled, MotionInterrupted)) else 2


def usage_error(error: Any) -> str:
    """A usage error in one line, with the value and a pointer to the help."""
    command = "allegro-twin" if error.ctx is None else error.ctx.command_path
    text = " ".join(error.format_message().split()).rstrip(".").replace("Value error, ", "")
    details = error.__cause__.errors()[:1] if hasattr(error.__cause__, "errors") else ()
    value = "".join(f", not {detail['input']!r}" for detail in details if repr(detail["input"]) not in text)
    return f"{command}: {text[:1].lower()}{text[1:]}{value}; `{command} --help` shows what there is"


def stop_on_signals() -> None:
    """Handle SIGTERM, SIGHUP and SIGQUIT as Ctrl-C, but for the exit code."""
    _ended_by.clear()
    for number in _ENDS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # As nohup sets it.
            signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> None:
    """End as Ctrl-C does, so that the hand is left limp. Further signals are ignored."""
    for each in (*_ENDS, signal.SIGINT):
        signal.signal(each, signal.SIG_IGN)
    _ended_by.append(number)
    raise KeyboardInterrupt
