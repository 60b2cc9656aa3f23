"""Standard input, output and error: always there, and without a traceback where they take no more."""

from __future__ import annotations

import io
import os
import sys
from typing import Any

failed: list[OutputLost] = []
"""What standard output and error did not take."""


class OutputLost(OSError):
    """Standard output or error takes no more, as on a full disk. Raised once for each; what comes later is dropped."""


class _Output(io.FileIO):
    def __init__(self, descriptor: int, called: str) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._called, self._lost = called, False

    def write(self, data: Any, /) -> int:
        if self._lost:
            return len(data)
        try:
            return super().write(data)
        except BrokenPipeError:  # Nobody listens, which is no fault.
            raise
        except OSError as error:
            self._lost = True
            failed.append(OutputLost(f"cannot write to {self._called}: {error.strerror or error}"))
            raise failed[-1] from error


def open_streams() -> None:
    """Open the standard streams that are closed, onto nothing, and let the others raise OutputLost."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:  # Or the next file has this number, and gets what libraries print.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    if sys.stdin is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115 - for the whole program.
    sys.stdout, sys.stderr = _output(sys.stdout, "standard output"), _output(sys.stderr, "standard error")


def _output(stream: Any, called: str) -> Any:
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8")
    if type(stream) is not io.TextIOWrapper:  # Of a notebook or a test.
        return stream
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Output(stream.fileno(), called)), stream.encoding, stream.errors,
        line_buffering=stream.line_buffering, write_through=stream.write_through,
    )  # fmt: skip
