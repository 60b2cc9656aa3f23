"""Where what is drawn in Rerun goes: its own window, a page in the browser, or a file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Self

import rerun as rr

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.viewing.rerun import server

TOGETHER = 0.1  # s of the device's clock that are sent together to somebody who watches.


class Canvas(ABC):
    """A Rerun recording. One of `spawn`, `serve`, `to_file` says where it goes."""

    def __init__(self) -> None:
        self._stream = rr.RecordingStream("allegro_twin")
        self._server: server.Server | None = None

    def spawn(self) -> Self:
        """Open the native viewer. Raises ConfigError where there is no screen for it."""
        self._server = server.window()
        return self._connected()

    def serve(self, *, open_browser: bool = True, web_port: int = 9090) -> str:
        """Serve a page to this machine's browser; its address. Raises ConfigError when the port is taken."""
        self._server, address = server.page(web_port)
        self._connected()
        if open_browser:
            server.browse(address)
        return address

    def to_file(self, path: Path) -> Self:
        """Write a file that `rerun` and https://app.rerun.io open. Raises ConfigError where it cannot be made."""
        try:
            self._stream.save(str(path), default_blueprint=self._layout())
        except (OSError, RuntimeError) as error:
            raise ConfigError(f"cannot write {path}: {error}") from error
        self._begin()
        return self

    def flush(self) -> None:
        """Wait until everything drawn has left this process."""
        self._send()
        self._stream.flush()

    def close(self) -> None:
        """Let go of the viewer or the file. Raises RecordingError when the disk did not take all that was drawn."""
        try:
            self.flush()
        except RuntimeError as error:
            raise RecordingError(f"cannot write the Rerun recording: {error}; is the disk full?") from error
        finally:
            self._stream.disconnect()
            if self._server is not None:
                self._server.close()

    def _connected(self) -> Self:
        assert self._server is not None
        self._stream.connect_grpc(self._server.url, default_blueprint=self._layout())
        self._begin()
        return self

    @abstractmethod
    def _layout(self) -> rr.blueprint.Blueprint:
        """How it is arranged."""

    @abstractmethod
    def _begin(self) -> None:
        """Draw what stays as it is."""

    @abstractmethod
    def _send(self) -> None:
        """Send what was collected."""
