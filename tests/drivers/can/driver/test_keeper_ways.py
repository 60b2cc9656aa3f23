"""How a keeper hears and speaks on each way to a hand, without a hand."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from allegro_twin.drivers.base.keeper.process.links import SlcanPort, SocketcandClient


@contextmanager
def server(answer: bytes = b"< ok >") -> Iterator[tuple[int, list[socket.socket]]]:
    """A socketcand of one client: it greets, and answers `answer` when a bus is opened."""
    clients: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as door:

        def serve() -> None:
            client, _ = door.accept()
            clients.append(client)
            client.sendall(b"< hi >")
            client.recv(100)
            client.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield door.getsockname()[1], clients
        finally:
            thread.join()
            for client in clients:
                client.close()


def test_over_socketcand_only_whole_frames_are_heard_and_the_rest_waits() -> None:
    with server() as (port, clients):
        way = SocketcandClient("127.0.0.1", port, "can0")
        clients[0].sendall(
            b"< ok >< frame 080 1.5 AA0BCC >< frame 1 >< error no such bus >< frame 084 2.0  >< frame 088"
        )
        os.set_blocking(way.fileno(), True)
        assert way.receive() == [(0x80, b"\xaa\x0b\xcc"), (0x84, b"")]
        clients[0].sendall(b" 3.0 01 >")
        assert way.receive() == [(0x88, b"\x01")]
        way._socket.close()


def test_over_socketcand_a_frame_is_said_with_its_length_and_bytes_after_rawmode() -> None:
    with server() as (port, clients):
        way = SocketcandClient("127.0.0.1", port, "can0")
        way.begin()
        way.begin()
        way.send(0x180, b"\x01\xff", remote=False)
        clients[0].settimeout(20.0)
        said = b""
        while said.count(b">") < 2:
            said += clients[0].recv(100)
        assert said == b"< rawmode >< send 180 2 1 ff >"
        way._socket.close()


def test_a_server_that_refuses_is_an_error_with_its_words() -> None:
    with server(b"< error unknown bus >") as (port, _), pytest.raises(OSError, match="< error unknown bus >"):
        SocketcandClient("127.0.0.1", port, "can9")


def test_over_a_serial_port_frames_are_lines_of_slcan() -> None:
    main, other = os.openpty()
    way = SlcanPort(other)
    os.write(main, b"\a\nt0803AA0BCC\rt08\rz\r\rt0840\nt1\n")  # A terminal sends a return as a new line.
    os.set_blocking(other, True)
    assert way.receive() in ([], [(0x80, b"\xaa\x0b\xcc")])
    os.close(main)
    os.close(other)
