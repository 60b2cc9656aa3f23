"""A served hand hears what leaves it limp, however busy its machine is and however its host ends."""

from __future__ import annotations

import select
import socket
import time
from collections import deque

import can

from allegro_twin.app.rig import SimulatedScene
from allegro_twin.app.serve_can import virtual_firmware
from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.drivers.can.virtual.serve import serve
from allegro_twin.drivers.can.virtual.shared_bus import VirtualHands
from allegro_twin.drivers.can.virtual.socketcand import SocketcandServer
from tests.conftest import can_config

V4 = make_codec("v4")


class Waiting(can.BusABC):
    """A bus on which frames lie ready."""

    def __init__(self, frames: list[can.Message]) -> None:
        self.frames = deque(frames)
        self.channel_info = "waiting"
        super().__init__("waiting")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        pass

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.frames.popleft() if self.frames else None


def test_a_hand_that_is_late_at_every_step_still_hears_its_host() -> None:
    hand = virtual_firmware(can_config("v4"), SimulatedScene(), step=0.003, restart=False)
    hand.receive(V4.encode(m.ServoOn()))
    off = V4.encode(m.ServoOff())
    bus = Waiting([can.Message(arbitration_id=off.id, is_extended_id=False, data=off.data)] * 5)
    late = iter(range(1, 10_000))
    served = next(serve(VirtualHands([hand]), bus, lambda: 0.05 * next(late)))
    assert (served.late, served.heard) == (1, 5)
    assert not hand.serving
    bus.shutdown()


def test_what_a_tcp_client_said_before_it_vanished_is_still_heard() -> None:
    server = SocketcandServer("can0", port=0)
    client = socket.create_connection(server.address)
    client.sendall(b"< open can0 >< rawmode >")
    assert server.recv(0.1) is None
    hello = can.Message(arbitration_id=0x80, data=bytes(8), is_extended_id=False)
    server.send(hello)
    select.select([client], [], [], 1.0)
    client.sendall(b"< send 104 0 >< send 204 1 0 >")
    client.close()  # With frames unread: the connection is reset.
    time.sleep(0.05)
    for _ in range(3):
        server.send(hello)
    first, second = server.recv(1.0), server.recv(1.0)
    assert first is not None
    assert second is not None
    assert (first.arbitration_id, second.arbitration_id) == (0x104, 0x204)
    assert server.recv(0.05) is None
    server.shutdown()


def test_no_frame_runs_into_the_answer_to_rawmode() -> None:
    server = SocketcandServer("can0", port=0)
    client = socket.create_connection(server.address)
    client.sendall(b"< open can0 >< rawmode >")
    while not any(waiting.raw_from < float("inf") for waiting in server._clients.values()):
        server.recv(0.001)
    server.send(can.Message(arbitration_id=0x80, data=bytes(8), is_extended_id=False))
    time.sleep(0.06)
    server.send(can.Message(arbitration_id=0x84, data=bytes(8), is_extended_id=False))
    select.select([client], [], [], 1.0)
    time.sleep(0.01)
    said = client.recv(4096)
    assert said.startswith(b"< hi >< ok >< ok >< frame 084 ")
    client.close()
    server.shutdown()
