"""Exit codes of the command line, one-line error messages, and signals."""

from __future__ import annotations

import io
import logging
import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import Any, NoReturn

import typer

from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, MotionInterrupted, MotionStalled
from allegro_twin.files.first_error import message_of

USAGE: type[Exception] = typer.BadParameter.__mro__[1]
"""The parser's usage error. Not every version of typer has a public name for it."""
_ENDS = [
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
]  # Windows has the first.


def run(app: typer.Typer, arguments: Sequence[str], program: str) -> NoReturn:
    """Run a command line and exit. Every HandError and every usage error is one line on standard error."""
    stop_on_signals()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # A terminal may lack a degree sign.
    logging.getLogger("can").addHandler(logging.NullHandler())  # python-can raises what it logs.
    try:
        _check_none_empty(arguments)
        sys.exit(app(list(arguments), prog_name=program, standalone_mode=False) or 0)
    except HandError as error:
        sys.stderr.write(f"{program}: {message_of(error)}\n")
        sys.exit(exit_code(error))
    except ImportError as error:
        if error.path is None:
            raise
        sys.stderr.write(f"{import_error(error)}\n")
        sys.exit(2)
    except USAGE as error:
        sys.stderr.write(f"{usage_error(error)}\n")
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except Exception as error:
        if "KeyboardInterrupt" in str(error):  # It came while a library was loaded, in a callback from C.
            sys.exit(130)
        raise


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


def import_error(error: ImportError) -> str:
    """One line about a compiled module that is installed and cannot be loaded."""
    return f"allegro-twin: {str(error).splitlines()[0]}; `allegro-twin doctor` says which package of the system has it"


def stop_on_signals() -> None:
    """Handle SIGTERM, SIGHUP and SIGQUIT as Ctrl-C."""
    for number in _ENDS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # As nohup sets it.
            signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> None:
    """End as Ctrl-C does, so that the hand is left limp. Further signals are ignored."""
    for each in (*_ENDS, signal.SIGINT):
        signal.signal(each, signal.SIG_IGN)
    raise KeyboardInterrupt
