"""`python -m allegro_twin.surfaces.panel.page NEWS FRAMES LISTENING`: three descriptors that `panel.pages` opened."""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import viser

from allegro_twin.surfaces.panel import overlay
from allegro_twin.surfaces.panel.access import Gate
from allegro_twin.surfaces.panel.cell import Place
from allegro_twin.surfaces.panel.page.cell_board import CellBoard
from allegro_twin.surfaces.panel.page.shared_state import Board
from allegro_twin.surfaces.panel.page.viser_app import hidden_server
from allegro_twin.surfaces.panel.page_process import Setup
from allegro_twin.surfaces.panel.requests import Stop, Wish
from allegro_twin.surfaces.panel.server import Door
from allegro_twin.surfaces.panel.stream import received


def main() -> None:
    """Serve until the hand's process has ended."""
    news, frames, listening = (int(number) for number in sys.argv[1:4])
    link = Connection(news)
    setup = link.recv()
    assert isinstance(setup, Setup)
    sending = threading.Lock()

    def wish(what: Wish | Place | None) -> None:
        with sending:
            link.send(what)

    server = hidden_server()
    board: Board | CellBoard = CellBoard(server, wish) if setup.cell else Board(server, wish, setup.gone)
    ready = threading.Event()
    threading.Thread(
        target=lambda: asyncio.run(_serve(listening, server, setup, lambda: wish(Stop()), ready)), daemon=True
    ).start()
    threading.Thread(target=lambda: _draw(frames, board), daemon=True).start()
    ready.wait()
    wish(None)
    try:
        while True:
            board.hear(link.recv())
    except (EOFError, OSError):
        return


async def _serve(
    listening: int, server: viser.ViserServer, setup: Setup, stop: Callable[[], None], ready: threading.Event
) -> None:
    index = Path(viser.__file__).parent / "client" / "build" / "index.html"
    gate = Gate(setup.token, asyncio.get_running_loop().time)
    door = Door(
        overlay.page(index.read_text()), (server.get_host(), server.get_port()), gate, stop, setup.names
    )  # fmt: skip
    outside = await asyncio.start_server(door, sock=socket.socket(fileno=listening), limit=1 << 14)
    ready.set()
    await outside.serve_forever()


def _draw(frames: int, board: Board | CellBoard) -> None:
    pipe = socket.socket(fileno=frames)
    pipe.settimeout(1.0)
    while True:
        try:
            frame = received(pipe)
        except TimeoutError:
            board.silence()
            continue
        except OSError:
            return
        if frame is None:
            return
        board.show(frame)


if __name__ == "__main__":
    main()
