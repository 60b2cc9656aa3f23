"""Worker processes: each runs one task of a named function at a time, and ends with the program that started it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from allegro_twin.errors import HandError

_DEAF = (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
"""Signals that a terminal sends to all processes of a program: the first process decides, and ends the others."""
_PATIENCE = 10.0
"""s that a process has for closing its files before it is killed."""


class WorkerEvent(NamedTuple):
    """A message of a task's function while it runs."""

    task: int
    message: Any


class UnitDone(NamedTuple):
    """The result of a task's function."""

    task: int
    result: Any


class UnitFailed(NamedTuple):
    """The HandError that the function of a task raised."""

    task: int
    error: HandError


class WorkerLost(NamedTuple):
    """A task whose process ended: `code` is its exit code, or minus the signal that killed it."""

    task: int
    code: int


@dataclass(slots=True)
class _Process:
    program: subprocess.Popen[bytes]
    pipe: Connection[Any, Any]
    task: int | None = None


class Workers:
    """Up to `count` processes that call `function(shared, task, tell)`, named `package.module:name`; tasks, results
    and what is told are pickled. A process starts when it is first needed and takes the place of one that died.

    To be used in a `with`: its end stops them all, with SIGTERM, which their Python sees as Ctrl-C.
    """

    def __init__(self, function: str, shared: Any, count: int, environment: Mapping[str, str] | None = None) -> None:
        self._function, self._shared, self._count = function, shared, count
        paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
        self._environment = {**(environment or {}), **os.environ, "PYTHONPATH": paths}
        self._processes: list[_Process] = []

    @property
    def free(self) -> int:
        """How many more tasks can be given now."""
        return self._count - self.busy

    @property
    def busy(self) -> int:
        """How many tasks are being done."""
        return sum(each.task is not None for each in self._processes)

    def give(self, task: int, content: Any) -> None:
        """Have a task done, by its number."""
        idle = next((each for each in self._processes if each.task is None), None)
        process = idle or self._start()
        process.task = task
        try:
            if idle is None:
                process.pipe.send((self._function, self._shared))
            process.pipe.send(content)
        except ConnectionError:
            pass  # It has died; `events` says so.

    def events(self) -> Iterator[WorkerEvent | UnitDone | UnitFailed | WorkerLost]:
        """Waits for events and returns them."""
        pipes: list[Any] = [each.pipe for each in self._processes if each.task is not None]
        ready = wait(pipes)
        for process in [each for each in self._processes if each.pipe in ready]:
            assert process.task is not None  # Or its pipe was not waited for.
            yield self._heard(process, process.task)

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *raised: object) -> None:
        self._end(list(self._processes))

    def _start(self) -> _Process:
        mine, theirs = Pipe()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _DEAF)  # What is blocked stays so in a new process.
        try:
            command = [sys.executable, "-P", "-m", "allegro_twin.sweep.worker", str(theirs.fileno())]
            program = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()], env=self._environment
            )
            process = _Process(program, mine)
            self._processes.append(process)
        finally:
            theirs.close()  # So that the pipe ends with the process.
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return process

    def _heard(self, process: _Process, task: int) -> WorkerEvent | UnitDone | UnitFailed | WorkerLost:
        try:
            kind, content = process.pipe.recv()
        except (EOFError, ConnectionError):
            self._end([process], ask=False)  # It is ending already.
            return WorkerLost(task, process.program.returncode)
        if kind == "told":
            return WorkerEvent(task, content)
        process.task = None
        return UnitDone(task, content) if kind == "done" else UnitFailed(task, content)

    def _end(self, processes: list[_Process], *, ask: bool = True) -> None:
        for each in processes:
            each.pipe.close()
            if ask:
                each.program.terminate()
        for each in processes:
            try:
                each.program.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                each.program.kill()
                each.program.wait()
            self._processes.remove(each)
