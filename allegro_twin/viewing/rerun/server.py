"""Rerun's own program, which serves the page or the window: on this machine only, unlike the library's servers.

The library binds to every address (rerun-io/rerun issue 5882); the program can be told not to.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import webbrowser
from pathlib import Path
from urllib.parse import quote

from allegro_twin.errors import ConfigError

_HERE = "127.0.0.1"
_MEMORY = "1GiB"  # Of what a page that is opened late still gets.


class RerunServer:
    """A running Rerun. Raises ConfigError when a port is taken or the program is not there."""

    def __init__(self, *arguments: str) -> None:
        self.port = claim(0)
        command = [str(_program()), "--bind", _HERE, "--port", str(self.port), "--server-memory-limit", _MEMORY]
        self._process = subprocess.Popen(
            [*command, *arguments], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env=os.environ | {"RERUN_APP_ONLY": "true"},
        )  # fmt: skip

    @property
    def url(self) -> str:
        """Where the data go."""
        return f"rerun+http://{_HERE}:{self.port}/proxy"

    def close(self) -> None:
        """End it; the page or the window has no more data then."""
        if self._process.poll() is None:
            self._process.terminate()
            self._process.wait()


def page(port: int) -> tuple[RerunServer, str]:
    """A server with a page for the browser, and the page's address."""
    claim(port)
    server = RerunServer("--serve-web", "--web-viewer-port", str(port))
    return server, f"http://{_HERE}:{port}/?url={quote(server.url, safe='')}"


def window() -> RerunServer:
    """Rerun's own window. Raises ConfigError where there is no screen for it."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ConfigError("there is no screen for Rerun's window: look in the browser with --web, or write a .rrd")
    return RerunServer("--expect-data-soon")


def claim(port: int) -> int:
    """A port of this machine that is free: the given one, or any for 0. Raises ConfigError when it is taken."""
    with socket.socket() as probe:
        try:
            probe.bind((_HERE, port))
        except OverflowError as error:
            raise ConfigError(f"port {port} is no TCP port: they go from 1 to 65535; choose one with --port") from error
        except PermissionError as error:
            raise ConfigError(f"port {port} is not for everyone; choose one above 1023 with --port") from error
        except OSError as error:
            raise ConfigError(f"port {port} is taken by another program; choose another with --port") from error
        return int(probe.getsockname()[1])


def _program() -> Path:
    given = os.environ.get("RERUN_CLI_PATH")
    package = importlib.util.find_spec("rerun_cli")
    folder = Path(package.origin).parent if package is not None and package.origin else Path()
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    bundled = folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun"
    for path in (Path(given) if given else folder / name, folder / name, bundled):
        if path.is_file():
            return path
    raise ConfigError(f"Rerun came without its program ({folder / name}): pip install --force-reinstall rerun-sdk")


def browse(address: str) -> None:
    """Open a page in the person's browser, where there is one."""
    webbrowser.open(address)
