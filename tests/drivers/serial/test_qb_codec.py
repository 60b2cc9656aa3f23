"""Packets of qb devices: what is known of them to the byte, and what becomes of damaged ones."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.drivers.qb.codec import Command, QbPacket, QbParser, answer, lrc, pack_int16, unpack_int16
from allegro_twin.drivers.qb.device import QbDevice

PING = bytes.fromhex("3a3a 01 02 00 00")
GOAL = bytes.fromhex("3a3a 01 06 82 4a38 0000 f0")  # 19000, 0; 82 ^ 4a ^ 38 = f0.
packets = st.builds(QbPacket, st.integers(0, 255), st.integers(0, 255), st.binary(max_size=40))


def test_a_packet_is_frame_length_command_numbers_with_the_high_byte_first_and_their_xor() -> None:
    assert QbPacket(1, Command.PING).encoded() == PING
    assert QbPacket(1, Command.SET_INPUTS, pack_int16(19_000, 0)).encoded() == GOAL
    assert lrc(bytes.fromhex("824a380000")) == 0xF0
    assert QbPacket(1, Command.ACTIVATE, b"\x03").encoded().hex(" ") == "3a 3a 01 03 80 03 83"


@given(st.lists(st.integers(-32768, 32767), max_size=5))
def test_numbers_come_back_as_they_were(values: list[int]) -> None:
    assert list(unpack_int16(pack_int16(*values))) == values


def test_numbers_that_do_not_fit_stop_at_the_ends() -> None:
    assert list(unpack_int16(pack_int16(40_000, -40_000))) == [32767, -32768]


@given(st.lists(packets, max_size=6), st.integers(1, 7))
def test_packets_come_out_as_they_went_in_however_they_are_cut(said: list[QbPacket], step: int) -> None:
    parser, data = QbParser(), b"".join(packet.encoded() for packet in said)
    heard = [packet for k in range(0, len(data), step) for packet in parser.feed(data[k : k + step])]
    assert heard == said


@given(st.lists(st.binary(max_size=300), max_size=4))
def test_whatever_is_found_is_a_packet_that_stood_there(noise: list[bytes]) -> None:
    parser, data = QbParser(), b"".join(noise)
    for piece in noise:
        for packet in parser.feed(piece):
            assert packet.encoded() in data


def test_a_damaged_packet_is_none_and_the_next_one_is_found() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        spoilt = bytearray(GOAL)
        spoilt[int(rng.integers(4, len(GOAL)))] ^= 1 << int(rng.integers(8))
        assert QbParser().feed(bytes(spoilt) + GOAL) == [QbPacket(1, Command.SET_INPUTS, pack_int16(19_000, 0))]


def test_half_a_packet_before_a_pause_never_becomes_one() -> None:
    parser = QbParser()
    assert parser.feed(GOAL[:6]) == []
    parser.clear()
    assert parser.feed(GOAL[6:]) == []
    assert parser.feed(GOAL)


def test_an_answer_is_that_of_this_device_to_this_command() -> None:
    mine = QbPacket(1, Command.GET_CURRENTS, pack_int16(5, 0)).encoded()
    others = (
        QbPacket(2, Command.GET_CURRENTS, pack_int16(6, 0)).encoded()
        + QbPacket(1, Command.GET_INPUTS, pack_int16(7, 0)).encoded()
    )
    assert answer(others, 1, Command.GET_CURRENTS, 4) is None
    assert answer(others + mine[:-1], 1, Command.GET_CURRENTS, 4) is None
    assert answer(others + mine, 1, Command.GET_CURRENTS, 4) == pack_int16(5, 0)
    assert answer(mine, 1, Command.GET_CURRENTS, 6) is None


def test_a_device_says_who_it_is_in_its_firmwares_text_without_a_packet() -> None:
    device = QbDevice(7)
    device.receive(QbPacket(7, Command.ACTIVATE, b"\x03").encoded())
    device.receive(QbPacket(7, Command.SET_INPUTS, pack_int16(9_000, 0)).encoded())
    device.sense(np.array([123.0]), np.array([45.0]))
    asked = (
        QbPacket(7, Command.GET_INFO, pack_int16(0)).encoded(),
        QbPacket(0, Command.GET_INFO, pack_int16(0)).encoded(),
    )
    for question in (*asked, b"?\r\n"):
        text = device.receive(question).decode("ascii")
        assert text.startswith("\r\nFirmware version: ")
        lines = text.split("\r\n")
        for line in ("DEVICE INFO", "ID: 7", "Motor reference - Position: 9000 ", "Motor enabled: YES", "1 -> 123",
                     "Current (mA): 45", "USAGE STATISTICS"):  # fmt: skip
            assert line in lines
    cycles = device.receive(QbPacket(7, Command.GET_INFO, pack_int16(1)).encoded())
    assert cycles.startswith(b"\r\nUSAGE STATISTICS\r\n")
    assert device.receive(QbPacket(8, Command.GET_INFO, pack_int16(0)).encoded()) == b""
    assert device.receive(QbPacket(7, Command.GET_INFO, pack_int16(99)).encoded()) == b""
