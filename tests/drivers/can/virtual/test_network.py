"""A bus over TCP: python-can's own socketcand client drives a hand; other clients hear it and come and go."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Iterator

import can
import numpy as np
import pytest

from allegro_twin.app.rig import open_backend
from allegro_twin.app.serve_can import far_end
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.link.buses import open_bus
from allegro_twin.drivers.can.virtual.socketcand import GRACE, SocketcandServer
from allegro_twin.errors import LinkError
from allegro_twin.types import TorqueCommand
from tests.conftest import can_config
from tests.drivers.can.rigs import Serving, driven, soon_limp


@pytest.fixture
def server() -> Iterator[SocketcandServer]:
    made = SocketcandServer("can0", port=0)
    yield made
    made.shutdown()


def dial(server: SocketcandServer) -> socket.socket:
    return socket.create_connection(server.address, timeout=5.0)


def spoken(server: SocketcandServer, client: socket.socket, *pieces: bytes) -> tuple[list[can.Message], bytes]:
    """Frames that came of what a client sent, and what it was answered."""
    frames, answer = [], b""
    for piece in pieces:
        client.sendall(piece)
        while (message := server.recv(0.03)) is not None:
            frames.append(message)
    while select.select([client], [], [], 0.05)[0] and (data := client.recv(4096)):
        answer += data
    return frames, answer


def test_a_hand_is_driven_through_it() -> None:
    with Serving(SocketcandServer("can0", port=0), can_config("v4")) as there:
        assert isinstance(there.bus, SocketcandServer)
        host, port = there.bus.address
        backend = driven("socketcand", "can0", options={"host": host, "port": port})
        try:
            backend.reset()
            for _ in range(60):
                backend.write(TorqueCommand(np.full(16, 0.02)))
                state = backend.read()
        finally:
            backend.close()
        assert state.tick >= 60
        assert soon_limp(there)


def test_messages_may_come_in_pieces_and_together(server: SocketcandServer) -> None:
    with dial(server) as client:
        assert spoken(server, client, b"< open can0 >< rawmode >< echo >")[1] == b"< hi >< ok >< ok >< echo >"
        frames, answer = spoken(server, client, b"< send 180 ", b"2 a", b"a bb >< send 10", b"0 0 >")
    assert [(f.arbitration_id, bytes(f.data)) for f in frames] == [(0x180, b"\xaa\xbb"), (0x100, b"")]
    assert answer == b""


@pytest.mark.parametrize(
    "words",
    ["", "open can7", "send", "send 180", "send xyz 0", "send 180 zz", "send 180 2 11", "send 180 1 1ff",
     "send 180 1 -1", "send 800 0", "send -1 0", "send 180 9 1 2 3 4 5 6 7 8 9", "isotpmode", "\xff"],
)  # fmt: skip
def test_what_makes_no_sense_is_an_error_to_that_client_alone(words: str, server: SocketcandServer) -> None:
    with dial(server) as client:
        frames, answer = spoken(server, client, f"< {words} >".encode("latin-1"), b"< send 100 1 AA >")
        assert len(frames) == 1
        assert b"< error" in answer


def test_clients_hear_each_other_and_the_hand(server: SocketcandServer) -> None:
    with dial(server) as one, dial(server) as other:
        for client in (one, other):
            spoken(server, client, b"< open can0 >< rawmode >")
        time.sleep(2 * GRACE)  # A driver that has just been told `ok` is not spoken to at once.
        spoken(server, one, b"< send 123 1 AB >")
        assert b"< frame 123 " in other.recv(4096)
        server.send(can.Message(arbitration_id=0x80, data=bytes(8), is_extended_id=False))
        for client in (one, other):
            assert b"< frame 080 " in client.recv(4096)


def test_a_client_that_dies_takes_nobody_with_it(server: SocketcandServer) -> None:
    """Both speak at once; what the first says cannot be told to the second, whose turn comes then."""
    with dial(server) as one:
        spoken(server, one, b"< open can0 >< rawmode >")
        other = dial(server)
        spoken(server, other, b"< open can0 >< rawmode >")
        other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
        other.close()  # With a reset, as when a process is killed.
        one.sendall(b"< send 123 1 AB >< send 124 1 AB >")
        time.sleep(0.05)
        heard = []
        while (message := server.recv(0.1)) is not None:
            heard.append(message.arbitration_id)
        assert heard == [0x123, 0x124]
        assert len(server._clients) == 1


def test_a_client_that_does_not_read_is_left_behind(server: SocketcandServer) -> None:
    """It loses frames; the hand says all of them to the others, and goes on hearing them."""
    with dial(server) as lazy, dial(server) as other:
        for client in (lazy, other):
            spoken(server, client, b"< open can0 >< rawmode >")
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        for there in server._clients:  # The kernel would keep megabytes.
            there.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 65536)
        time.sleep(2 * GRACE)
        sent, read, chunk = 20_000, 0, 200
        for _ in range(sent // chunk):
            for _ in range(chunk):
                server.send(can.Message(arbitration_id=0x80, data=bytes(8), is_extended_id=False))
            while select.select([other], [], [], 0.0)[0]:
                read += other.recv(1 << 20).count(b"< frame 080 ")
        kept = 0
        while select.select([lazy], [], [], 0.1)[0] and (data := lazy.recv(1 << 20)):
            kept += data.count(b"< frame 080 ")
        assert kept < sent / 2 < read
        assert [message.arbitration_id for message in spoken(server, other, b"< send 123 1 AB >")[0]] == [0x123]


def test_more_clients_than_it_serves_are_sent_away_and_the_hand_goes_on(server: SocketcandServer) -> None:
    """1,100 at once: more than `select` can count."""
    with dial(server) as first:
        spoken(server, first, b"< open can0 >< rawmode >")
        crowd: list[socket.socket] = []
        for _ in range(1100):
            crowd.append(dial(server))
            server.recv(0.0)
            if len(crowd) > 200:  # This process may not have more open at once.
                crowd.pop(0).close()
        while server.recv(0.05) is not None:
            pass
        assert crowd[-1].recv(100) == b"< error too many clients >"
        for one in crowd:
            one.close()
        while server.recv(0.05) is not None:
            pass
        assert len(spoken(server, first, b"< send 100 1 AA >")[0]) == 1


def test_a_hand_that_anybody_can_reach_says_so(caplog: pytest.LogCaptureFixture) -> None:
    config = can_config("v4", interface="socketcand", options={"host": "0.0.0.0", "port": 0})
    assert isinstance(config.backend, CanSettings)
    far_end(config.backend).shutdown()
    assert "listening on 0.0.0.0: whoever reaches port 0 moves this hand" in caplog.text


def test_a_client_that_closes_lets_the_server_hear_its_last_words(server: SocketcandServer) -> None:
    """While the hand goes on reporting: unread frames reset a connection, and what was sent is lost with it."""
    host, port = server.address
    serving = threading.Event()
    heard: list[int] = []

    def serve() -> None:
        while not serving.is_set():
            server.send(can.Message(arbitration_id=0x80, data=bytes(8), is_extended_id=False))
            while (message := server.recv(0.001)) is not None:
                heard.append(message.arbitration_id)

    thread = threading.Thread(target=serve)
    thread.start()
    for _ in range(20):
        bus = open_bus("socketcand", "can0", 1_000_000, {"host": host, "port": port})
        heard.clear()
        time.sleep(0.06)
        for identifier in range(0x180, 0x190, 4):
            bus.send(can.Message(arbitration_id=identifier, data=bytes(8), is_extended_id=False))
        bus.shutdown()
        time.sleep(0.01)
        assert heard == [0x180, 0x184, 0x188, 0x18C]
    serving.set()
    thread.join()


def test_a_port_that_is_taken_is_a_link_error(server: SocketcandServer) -> None:
    with pytest.raises(LinkError, match=r"cannot listen on 127\.0\.0\.1:\d+: .*; is another hand there already"):
        SocketcandServer("can0", port=server.address[1])


def test_a_channel_that_is_not_there_is_a_link_error() -> None:
    config = can_config("v4", interface="socketcan", channel="nocan7")
    assert isinstance(config.backend, CanSettings)
    with pytest.raises(LinkError, match="socketcan nocan7 does not open"):
        open_backend(config)
