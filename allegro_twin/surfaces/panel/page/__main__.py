"""The page's process: `python -m allegro_twin.surfaces.panel.page LINK FRAMES LISTENING`, three descriptors that
`page_process` opened. It serves viser behind the panel's own server."""

from __future__ import annotations

import asyncio
import os
import secrets
import socket
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import viser

from allegro_twin.surfaces.panel import overlay
from allegro_twin.surfaces.panel.access import TokenGate
from allegro_twin.surfaces.panel.page.session_page import SessionPage
from allegro_twin.surfaces.panel.page_process import PageSetup
from allegro_twin.surfaces.panel.requests import Request, StopMotion
from allegro_twin.surfaces.panel.server import PanelServer
from allegro_twin.surfaces.panel.stream import receive_frame


def main() -> None:
    """Serve until the session's process has ended, and end this process with it."""
    number, frames, listening = (int(argument) for argument in sys.argv[1:4])
    link = Connection(number)
    setup = link.recv()
    assert isinstance(setup, PageSetup)
    sending = threading.Lock()

    def send(request: Request | None) -> None:
        with sending:
            link.send(request)

    server = hidden_server()
    page = SessionPage(server, send)
    ready = threading.Event()
    threading.Thread(
        target=lambda: asyncio.run(_serve(listening, server, setup, lambda: send(StopMotion()), ready)), daemon=True
    ).start()
    threading.Thread(target=lambda: _draw(frames, page), daemon=True).start()
    ready.wait()
    send(None)
    try:
        while True:
            page.hear(link.recv())
    except (EOFError, OSError):
        os._exit(0)  # viser's threads would each report a traceback for a browser that is still there.


def hidden_server() -> viser.ViserServer:
    """viser on one of this computer's sixteen million addresses of its own, drawn anew each time: a page in somebody's
    browser, which may try any port, has to find it first. Its tunnel to the internet is taken away."""
    host = ".".join(str(part) for part in (127, *(1 + secrets.randbelow(254) for _ in range(3))))
    server = viser.ViserServer(host=host, port=0, verbose=False)
    server.request_share_url = lambda verbose=True: None  # Any client could ask for it.
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    server.gui.main_panel.dock_right()
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.configure_environment_map(None)  # Half of the time of a picture where no GPU draws it.
    return server


async def _serve(
    listening: int, server: viser.ViserServer, setup: PageSetup, stop: Callable[[], None], ready: threading.Event
) -> None:
    index = Path(viser.__file__).parent / "client" / "build" / "index.html"
    gate = TokenGate(setup.token, asyncio.get_running_loop().time)
    page, behind = overlay.page(index.read_text()), (server.get_host(), server.get_port())
    panel = PanelServer(page, behind, gate, stop, setup.names)
    outside = await asyncio.start_server(panel, sock=socket.socket(fileno=listening), limit=1 << 14)
    ready.set()
    await outside.serve_forever()


def _draw(frames: int, page: SessionPage) -> None:
    pipe = socket.socket(fileno=frames)
    pipe.settimeout(1.0)
    while True:
        try:
            frame = receive_frame(pipe)
        except TimeoutError:
            page.silence()
            continue
        except OSError:
            return
        if frame is None:
            return
        page.show(frame)


if __name__ == "__main__":
    main()
