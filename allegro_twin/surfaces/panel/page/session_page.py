"""The pages of all browsers that look at one session: what they see together, and what each of them sees."""

from __future__ import annotations

import base64
import threading
from collections.abc import Callable
from typing import Any

import viser

from allegro_twin.errors import HandError
from allegro_twin.surfaces.panel.page.client import ClientPage
from allegro_twin.surfaces.panel.page.page_state import PageState
from allegro_twin.surfaces.panel.page.scene import SceneView
from allegro_twin.surfaces.panel.requests import Request
from allegro_twin.surfaces.panel.stream import (
    LibraryContents,
    Notice,
    PageMessage,
    SessionEnded,
    SessionInfo,
    StreamFrame,
)
from allegro_twin.surfaces.worker_process import WorkerProcess
from allegro_twin.viewing.thumbnails import Thumbnails

_EVERY = 5
"""Frames between two refreshes of buttons and bars: six a second."""
_NICE = 10  # Pictures of the library may wait for the picture of the hand.


class SessionPage:
    """Gets messages and frames of the session, and keeps the pages of all browsers. `send` passes requests on."""

    def __init__(self, server: viser.ViserServer, send: Callable[[Request], None]) -> None:
        self._server, self.state = server, PageState(send)
        self._scene: SceneView | None = None
        self._clients: dict[int, ClientPage] = {}
        self._changing, self._count = threading.RLock(), 0
        server.on_client_connect(self._come)
        server.on_client_disconnect(self._go)

    def hear(self, message: PageMessage) -> None:
        """A message of the session's process."""
        with self._changing:
            match message:
                case SessionInfo():
                    self._open(message)
                case LibraryContents():
                    self.state.library = message
                    threading.Thread(target=self._draw_library, args=(message,), name="library", daemon=True).start()
                case Notice():
                    self.state.notice = message
                    for client in self._clients.values():
                        client.tell(message)
                case SessionEnded(why):
                    self.state.ended = why
            self._refresh()

    def show(self, frame: StreamFrame) -> None:
        """A moment of the session."""
        with self._changing:
            if self._scene is None or self.state.info is None or frame.session != self.state.info.session:
                return
            drawn = self.state.add(frame)
            if drawn is not None:
                self._scene.show(drawn)
            self._count += 1
            if self._count % _EVERY == 0:
                self._refresh()

    def silence(self) -> None:
        """No frame came for a second."""
        with self._changing:
            if self.state.frame is not None and not self.state.silent:
                self.state.silent = True
                self._refresh()

    def _open(self, info: SessionInfo) -> None:
        self.state.open(info)
        self._scene = SceneView(self._server, info, self._dragged)
        self.state.redraw = self._scene.show
        for who, client in list(self._clients.items()):
            self._clients[who] = client.rebuilt()

    def _dragged(self, number: int, event: Any) -> None:
        with self._changing:
            client, pose = self._clients.get(event.client_id), None if self._scene is None else self._scene.pose(number)
            if client is not None:
                client.drag(number, event, pose)

    def _draw_library(self, contents: LibraryContents) -> None:
        """Render new entries in a process of its own: some seconds of work that no picture should wait for."""
        info, drawn = self.state.info, self.state.thumbnails
        assert info is not None
        new = {name: at for name, at in {**contents.postures, **contents.grasps}.items() if name not in drawn}
        try:
            with WorkerProcess(Thumbnails(info.spec), nice=_NICE) as render:
                for name, posture in new.items():
                    data = base64.b64encode(render(posture)).decode()
                    drawn[name] = f'<img src="data:image/webp;base64,{data}">'
        except HandError as error:
            with self._changing:
                self.state.notice = Notice(f"the library has no pictures: {error}")
        with self._changing:
            for client in self._clients.values():
                client.fill()

    def _come(self, client: viser.ClientHandle) -> None:
        with self._changing:
            self.state.lock.join(client.client_id)
            self._clients[client.client_id] = ClientPage(self.state, client, self._refresh_all)
            self._refresh()

    def _go(self, client: viser.ClientHandle) -> None:
        with self._changing:
            self._clients.pop(client.client_id, None)
            self.state.let_go(client.client_id, left=True)
            self._refresh()

    def _refresh_all(self) -> None:
        with self._changing:
            self._refresh()

    def _refresh(self) -> None:
        for client in self._clients.values():
            client.refresh()
