"""Work in a process of its own: what is slow or large beside a control loop would cost the loop its periods."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Protocol, Self

from allegro_twin.errors import ConfigError, HandError

_START = 120.0  # s that it may take to begin: it may import PyTorch, from a cold disk.


class Job(Protocol):
    """The first message to the process, pickled. `open` is called there and gives the function that answers."""

    def open(self) -> Callable[[Any], Any]: ...


class WorkerProcess:
    """A process that does a job. One question at a time, in order."""

    def __init__(self, job: Job, *, nice: int = 0) -> None:
        """Begin, with so much less priority than this process. Raises what `open` of the job raised, or ConfigError
        when the process does not start."""
        ours, theirs = socket.socketpair()
        command = [sys.executable, "-m", "allegro_twin.surfaces.worker_process", str(theirs.fileno()), str(nice)]
        # A session of its own: Ctrl-C is for the hand's process, which then lets go of this one.
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, start_new_session=True
        )
        theirs.close()
        self._line, self._what = Connection(ours.detach()), type(job).__name__
        try:
            self._line.send(job)
            if not self.ready(_START):
                raise ConfigError(f"{self._what.lower()} did not begin within {_START:g} s")
            self.answer()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def __call__(self, question: Any) -> Any:
        """Ask, and wait for the answer."""
        self.ask(question)
        return self.answer()

    def ask(self, question: Any) -> None:
        """Ask, and go on."""
        try:
            self._line.send(question)
        except OSError:
            raise self._died() from None

    def ready(self, seconds: float = 0.0) -> bool:
        """Whether an answer has come, after so long at most, s."""
        return self._line.poll(seconds)

    def answer(self) -> Any:
        """The answer. Raises what was raised there, and HandError when the process has died."""
        try:
            found = self._line.recv()
        except (EOFError, OSError):
            raise self._died() from None
        if isinstance(found, HandError):
            raise found
        return found

    def close(self) -> None:
        """End the process. Idempotent."""
        self._line.close()
        self._process.terminate()
        self._process.wait()

    def _died(self) -> HandError:
        return HandError(f"the process of {self._what.lower()} has died; its output stands above")


def serve(line: Connection) -> None:
    """In that process: take the job, then answer until nobody asks any more. A HandError is an answer."""
    try:
        try:
            work = line.recv().open()
            line.send(None)
            while True:
                question = line.recv()
                line.send(work(question))
        except HandError as error:
            line.send(error)
    except (EOFError, OSError):
        return  # Nobody is there to answer.


if __name__ == "__main__":
    os.nice(int(sys.argv[2]))
    serve(Connection(int(sys.argv[1])))
