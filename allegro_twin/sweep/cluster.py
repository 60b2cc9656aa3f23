"""A sweep on several computers: Ray Core as the engine."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any

from allegro_twin.errors import ConfigError, HandError, LinkError
from allegro_twin.sweep.jobs import Item, Result, Sweep, Unit
from allegro_twin.sweep.local import RETRIES
from allegro_twin.sweep.units import UnitTask, compute, unit_task

_AHEAD = 2
"""Units that wait in line for each one that is computed, so that no core waits for this program."""

_PATIENCE = 5.0
"""s that the first node of a cluster has for answering at all."""


class RayCluster:
    """Units as Ray's tasks, `cores` of a node for each: 1, or as many as a node has for functions that use them all.

    `address`: of a running cluster, as `ray.init` takes it; None: the one that this program has joined, or that the
    environment's RAY_ADDRESS names, or one of this computer alone, started now. Ray computes a unit again, up to twice,
    whose process or node was lost. Every node needs MuJoCo in the same version and the same sources. Raises ConfigError
    where Ray is not installed, LinkError where no cluster answers.
    """

    def __init__(self, address: str | None = None, *, cores: int = 1) -> None:
        if cores < 1:
            raise ConfigError(f"a unit needs 1 core or more, not {cores}")
        try:
            self._ray: Any = import_module("ray")
        except ImportError as error:
            raise ConfigError(f"a cluster needs Ray: pip install 'allegro-twin[ray]' ({error})") from error
        if not hasattr(self._ray, "is_initialized"):
            place = getattr(self._ray, "__file__", None) or next(iter(self._ray.__path__))
            raise ConfigError(f"a cluster needs Ray, and `import ray` finds {place}: start elsewhere, or rename it")
        self._cores = cores
        if not self._ray.is_initialized():
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Or Ray tells its makers of every start.
            try:
                _knock(address or "")
                self._ray.init(address, log_to_driver=False, logging_level=logging.ERROR, configure_logging=False)
            except (OSError, ValueError, RuntimeError) as error:
                raise LinkError(f"no Ray cluster at {address or 'this computer'}: {_line(error)}") from error

    def results(self, sweep: Sweep, units: Sequence[Unit]) -> Iterator[tuple[int, list[Result]]]:
        """The number of each unit with its results, as they come. Raises HandError."""
        ray = self._ray
        task = ray.remote(num_cpus=self._cores, max_retries=RETRIES)(compute_task)
        work, left, begun = ray.put(unit_task(sweep, elsewhere=True)), list(range(len(units)))[::-1], dict[Any, int]()
        try:
            while left or begun:
                while left and len(begun) < self._at_once():
                    number = left.pop()
                    begun[task.remote(work, units[number].items)] = number
                (ready,), _ = ray.wait(list(begun), num_returns=1)
                number = begun.pop(ready)
                yield number, self._got(ready, f"{sweep.function}, {units[number]}")
        finally:
            for waiting in begun:
                ray.cancel(waiting, force=True)

    def _at_once(self) -> int:
        """Units in flight, for the cluster's present size."""
        return _AHEAD * max(1, int(self._ray.cluster_resources().get("CPU", 1) // self._cores))

    def _got(self, ready: Any, what: str) -> list[Result]:
        try:
            found: list[Result] | HandError = self._ray.get(ready)
        except self._ray.exceptions.RayTaskError as error:
            mistake = f"{type(error.cause).__name__}: {_line(error.cause)}"
            raise HandError(f"{what}: {mistake}; what is finished stays") from error
        except self._ray.exceptions.RayError as error:
            raise HandError(f"{what}: lost by Ray: {_line(error)}; what is finished stays") from error
        if isinstance(found, HandError):
            raise found
        return found


def compute_task(work: UnitTask, items: Sequence[Item]) -> list[Result] | HandError:
    """`compute` as Ray's task: its error is a value, or Ray would wrap it in its own."""
    try:
        return compute(work, items)
    except HandError as error:
        return error


def _knock(address: str) -> None:
    """Raises OSError where nobody listens at host:port; Ray itself waits for minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdigit() and "/" not in host:
        socket.create_connection((host, int(port)), _PATIENCE).close()


def _line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
