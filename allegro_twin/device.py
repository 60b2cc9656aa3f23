"""Optional members of a backend: whether its time passes by itself, its warnings, and how its session ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from allegro_twin.backend import HandBackend
from allegro_twin.plugin_faults import as_plugin_fault


class Device(Protocol):
    """Optional members of a backend; `device_of` fills in those that a backend does not have."""

    @property
    def live(self) -> bool:
        """Whether the hand's time passes by itself, as a real hand's does; False where only `read` lets it pass.

        Default: True. A live hand is driven from a thread of its own, without a gap between two calls.
        """
        ...

    @property
    def unconfirmed(self) -> str:
        """Why it is not sure that the hand was left limp; empty where it is sure. Default: empty."""
        ...

    @property
    def calibration(self) -> Mapping[str, Any]:
        """What turns the wire's counts into rad and N·m, as plain data for recordings. Default: empty."""
        ...

    def warnings(self) -> Sequence[str]:
        """What went wrong since `reset` without ending the session. Default: nothing."""
        ...

    def listen(self, log: Callable[[Any], None]) -> bool:
        """Pass every frame of the wire to `log` from now on; False where there are none. Default: False."""
        ...


def innermost(backend: object) -> Any:
    """The backend behind guards and others that pass everything on, which have what is behind them as `in_front_of`."""
    while (behind := getattr(backend, "in_front_of", None)) is not None:
        backend = behind
    return backend


def device_of(backend: HandBackend) -> Device:
    """The optional members of the backend behind a guard, with defaults for those that it does not have."""
    return _Device(innermost(backend))


class _Device:
    def __init__(self, backend: Any) -> None:
        self._backend = backend

    @property
    def live(self) -> bool:
        return bool(getattr(self._backend, "live", True))

    @property
    def unconfirmed(self) -> str:
        return str(getattr(self._backend, "unconfirmed", ""))

    @property
    def calibration(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = getattr(self._backend, "calibration", {})
        return found

    def warnings(self) -> Sequence[str]:
        said = getattr(self._backend, "warnings", None)
        with self._call("warnings"):
            return () if said is None else tuple(map(str, said()))

    def listen(self, log: Callable[[Any], None]) -> bool:
        listen = getattr(self._backend, "listen", None)
        with self._call("listen"):
            return False if listen is None else bool(listen(log))

    def _call(self, method: str) -> AbstractContextManager[None]:
        backend = type(self._backend)
        return as_plugin_fault(backend, f"{backend.__qualname__}.{method}", "backend")
