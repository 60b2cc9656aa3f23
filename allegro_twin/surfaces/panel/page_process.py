"""The page's own process: how it is started, told about the session, listened to, and started again when it dies."""

from __future__ import annotations

import errno
import importlib.metadata
import importlib.util
import ipaddress
import re
import secrets
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Literal

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.panel.requests import Request
from allegro_twin.surfaces.panel.stream import PageMessage

_START = 30.0  # s that the page's process may take to say that it is there.
_DEATHS = 3
"""Times that a page is started again."""
_VISER = (1, 1)
"""The oldest that has what the page asks of it, as in pyproject.toml."""
_EXTRA = "pip install --upgrade 'allegro-twin[panel]'"


@dataclass(frozen=True, slots=True)
class PageSetup:
    """The first message to the page's process."""

    token: str | None
    names: tuple[str, ...]
    """By which a browser may have found it; empty: by any, for there is a token."""


class PageProcess:
    """One process that shows the page. Raises ConfigError when it does not start."""

    def __init__(self, listening: socket.socket, setup: PageSetup, url: str) -> None:
        self._url, self._ready, self.alive = url, threading.Event(), True
        ours, theirs = socket.socketpair()
        self.frames, frames = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        numbers = [theirs.fileno(), frames.fileno(), listening.fileno()]
        command = [sys.executable, "-m", "allegro_twin.surfaces.panel.page", *map(str, numbers)]
        # A session of its own: Ctrl-C is for the hand's process, which then lets go of this one.
        self._process = subprocess.Popen(
            command, pass_fds=numbers, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
        )
        theirs.close()
        frames.close()
        self._link, self._telling = Connection(ours.detach()), threading.Lock()
        self._link.send(setup)

    def address(self) -> str:
        """Where a browser finds it, once it is there."""
        self._ready.wait(_START)
        if not self._ready.is_set() or not self.alive:
            raise ConfigError("the panel's page did not start; its output stands above")
        return self._url

    def requests(self) -> Iterator[Request]:
        """All requests that come, until the page has died."""
        try:
            while True:
                message: Any = self._link.recv()
                if message is None:
                    self._ready.set()
                else:
                    yield message
        except (EOFError, OSError):
            self.alive = False
            self._ready.set()

    def tell(self, message: PageMessage) -> None:
        """Send a message; a page that has died misses it, and the next one is told again."""
        with self._telling, suppress(OSError):
            self._link.send(message)

    def close(self) -> None:
        """End it."""
        self._link.close()
        self.frames.close()
        if self._process.poll() is None:
            self._process.terminate()
        self._process.wait()


class PageServer:
    """Server of the pages, in a process of its own. Raises ConfigError for a port that is taken, and where viser is
    missing or too old."""

    def __init__(self, host: str, port: int, gone: Literal["hold", "limp"], token: str | None = None) -> None:
        """`gone`: what a session does when nobody drives any more."""
        _viser()
        self.gone, self._listening = gone, _listening(host, port)
        port = int(self._listening.getsockname()[1])
        self._deaths = -1
        here = is_loopback(host)
        if not here:
            token = token or secrets.token_urlsafe(24)
        names = ("localhost", "127.0.0.1", "::1", host) if here else ()
        self._setup = PageSetup(token, names)
        name = f"[{host}]" if ":" in host else host
        self._url = f"http://{name}:{port}/" + (f"?token={token}" if token else "")

    def open(self) -> PageProcess:
        """A page. Raises ConfigError when it has died too often."""
        self._deaths += 1
        if self._deaths > _DEATHS:
            raise ConfigError(f"the panel's page has ended {self._deaths} times; its output stands above")
        return PageProcess(self._listening, self._setup, self._url)


def _viser() -> None:
    """Raises ConfigError where it is not there, or too old."""
    if importlib.util.find_spec("viser") is None:
        raise ConfigError(f"the panel needs viser: {_EXTRA}")
    # An upgrade into a folder (`pip install --target`) leaves the older one's papers beside the newer one's.
    found = [each.version for each in importlib.metadata.distributions(name="viser")]
    if found and all(_numbers(version) < _VISER for version in found):
        least = ".".join(map(str, _VISER))
        raise ConfigError(
            f"the panel needs viser {least} or newer, and {max(found, key=_numbers)} is installed: {_EXTRA}"
        )


def _numbers(version: str) -> tuple[int, ...]:
    """The first two of a version; of 0rc1 the 0."""
    return tuple(int(found[0]) if (found := re.match(r"\d+", part)) else 0 for part in version.split(".")[:2])


def is_loopback(host: str) -> bool:
    """Whether only this computer can reach it."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=64)
    except PermissionError as error:
        raise ConfigError(f"port {port} is not for everyone; choose one above 1023 with --port") from error
    except (OSError, UnicodeError) as error:  # The second for what cannot be a name.
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            raise ConfigError(f"port {port} is taken by another program; choose another with --port") from error
        raise ConfigError(f"--host {host}: no address of this computer") from error
