"""`python -m allegro_twin.sweep.worker`, which `workers.Workers` starts: does task after task until its pipe ends.

It is a program of its own, not a fork and not multiprocessing's: it imports nothing of the program that started it, so
a notebook, a script without a guard or a thread with a lock may start it.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any

from allegro_twin.errors import HandError
from allegro_twin.sweep.units import find_function


def main() -> None:
    """Take the function and what its tasks share; then tasks, and answer each."""
    pipe: Connection[Any, Any] = Connection(int(sys.argv[1]))
    os.set_inheritable(pipe.fileno(), False)
    try:
        _answer(pipe, *pipe.recv())
    except (EOFError, ConnectionError):
        pass  # Whoever wanted the results is gone.
    except KeyboardInterrupt:
        sys.exit(130)  # Not in many lines: it was asked to end.


def _answer(pipe: Connection[Any, Any], name: str, shared: Any) -> None:
    work, stop = find_function(name), _Stop()
    signal.signal(signal.SIGTERM, stop)
    if hasattr(select, "poll"):
        threading.Thread(target=_end_with, args=(pipe.fileno(),), daemon=True).start()
    while True:
        task = pipe.recv()
        stop.working = True
        try:
            result = ("done", work(shared, task, lambda message: pipe.send(("told", message))))
        except HandError as error:
            error.history = ()  # Thousands of samples may hang on a fault, and nobody beyond the pipe reads them.
            result = ("failed", error)
        stop.working = False
        pipe.send(result)


def _end_with(pipe: int) -> None:
    """End in the middle of a task, too, when whoever wanted the results is gone, killed for example."""
    waiting = select.poll()
    waiting.register(pipe, 0)  # Its end alone.
    waiting.poll()
    os.kill(os.getpid(), signal.SIGTERM)


class _Stop:
    """Ends as Ctrl-C does in the middle of a task, so that its files are closed; a second signal does not interrupt
    that. Between tasks nothing is open."""

    working = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if not self.working:
            os._exit(130)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise KeyboardInterrupt


if __name__ == "__main__":
    main()
