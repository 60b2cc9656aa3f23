"""Packets of protocol 2.0: the manual's own examples, byte stuffing, and a parser that noise does not stop."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allegro_twin.drivers.dynamixel.codec.packet import (
    BROADCAST,
    HEADER,
    Damaged,
    DynamixelPacket,
    DynamixelParser,
    Instruction,
    crc16,
    status,
)

VECTORS = [
    # ROBOTIS e-Manual, protocol2: the examples of each instruction.
    (DynamixelPacket(1, Instruction.PING), "FFFFFD00 01 0300 01 194E"),
    (DynamixelPacket(BROADCAST, Instruction.PING), "FFFFFD00 FE 0300 01 3142"),
    (status(1, 0, bytes((0x06, 0x04, 0x26))), "FFFFFD00 01 0700 55 00 060426 655D"),
    (status(2, 0, bytes((0x06, 0x04, 0x26))), "FFFFFD00 02 0700 55 00 060426 6F6D"),
    (DynamixelPacket(1, Instruction.READ, bytes((0x84, 0, 4, 0))), "FFFFFD00 01 0700 02 84000400 1D15"),
    (status(1, 0, bytes((0xA6, 0, 0, 0))), "FFFFFD00 01 0800 55 00 A6000000 8CC0"),
    (DynamixelPacket(1, Instruction.WRITE, bytes((0x74, 0, 0, 2, 0, 0))), "FFFFFD00 01 0900 03 740000020000 CA89"),
    (status(1, 0), "FFFFFD00 01 0400 55 00 A10C"),
    (
        DynamixelPacket(1, Instruction.REG_WRITE, bytes((0x68, 0, 0xC8, 0, 0, 0))),
        "FFFFFD00 01 0900 04 6800C8000000 AE8E",
    ),
    (DynamixelPacket(1, Instruction.ACTION), "FFFFFD00 01 0300 05 02CE"),
    (DynamixelPacket(1, Instruction.FACTORY_RESET, bytes((1,))), "FFFFFD00 01 0400 06 01 A1E6"),
    (DynamixelPacket(1, Instruction.REBOOT), "FFFFFD00 01 0300 08 2F4E"),
    (DynamixelPacket(1, Instruction.CLEAR, bytes((1, 0x44, 0x58, 0x4C, 0x22))), "FFFFFD00 01 0800 10 0144584C22 B1DC"),
    (
        DynamixelPacket(BROADCAST, Instruction.SYNC_READ, bytes((0x84, 0, 4, 0, 1, 2))),
        "FFFFFD00 FE 0900 82 840004000102 CEFA",
    ),
    (
        DynamixelPacket(BROADCAST, Instruction.SYNC_WRITE, bytes.fromhex("74000400 0196000000 02AA000000")),
        "FFFFFD00 FE 1100 83 74000400 0196000000 02AA000000 8287",
    ),
    (
        DynamixelPacket(BROADCAST, Instruction.BULK_READ, bytes.fromhex("0190000200 0292000100")),
        "FFFFFD00 FE 0D00 92 0190000200 0292000100 1A05",
    ),
    (status(2, 0, bytes((0x24,))), "FFFFFD00 02 0500 55 00 24 8BA9"),
]
packets = st.builds(
    DynamixelPacket, st.integers(0, 252) | st.just(BROADCAST), st.integers(0, 255), st.binary(max_size=60)
)


@pytest.mark.parametrize(("packet", "wire"), VECTORS)
def test_the_manuals_examples_are_encoded_and_parsed(packet: DynamixelPacket, wire: str) -> None:
    data = bytes.fromhex(wire)
    assert packet.encoded() == data
    assert DynamixelParser().feed(data) == [packet]


def test_a_header_inside_the_parameters_is_stuffed() -> None:
    packet = DynamixelPacket(1, Instruction.WRITE, bytes.fromhex("7400 FFFFFD00 FFFFFDFD"))
    data = packet.encoded()
    assert data[7:-2] == bytes.fromhex("03 7400 FFFFFDFD00 FFFFFDFDFD")
    assert int.from_bytes(data[5:7], "little") == len(data) - 7
    assert DynamixelParser().feed(data) == [packet]


@given(st.lists(packets, max_size=6), st.integers(1, 30))
def test_packets_come_back_whatever_pieces_they_come_in(sent: list[DynamixelPacket], piece: int) -> None:
    data = b"".join(packet.encoded() for packet in sent)
    parser = DynamixelParser()
    heard = [each for k in range(0, len(data), piece) for each in parser.feed(data[k : k + piece])]
    assert heard == sent


@given(st.binary(max_size=80), packets)
def test_noise_before_a_packet_costs_nothing_but_a_packet_that_it_begins(noise: bytes, packet: DynamixelPacket) -> None:
    heard = DynamixelParser().feed(noise + packet.encoded() + DynamixelPacket(1, Instruction.PING).encoded())
    assert packet in heard or noise.endswith((b"\xff", b"\xfd")) or HEADER in noise
    assert DynamixelPacket(1, Instruction.PING) in heard or HEADER in noise


def test_a_packet_that_was_cut_short_costs_itself_alone() -> None:
    long = DynamixelPacket(1, Instruction.WRITE, bytes(40)).encoded()
    next_one = DynamixelPacket(2, Instruction.PING)
    for k in range(8, len(long)):
        assert DynamixelParser().feed(long[:k] + next_one.encoded())[-1] == next_one


def test_a_packet_with_a_wrong_crc_is_told_as_damaged_with_the_id_it_claims() -> None:
    data = bytearray(DynamixelPacket(7, Instruction.WRITE, b"\x40\x00\x01").encoded())
    data[9] ^= 1
    assert DynamixelParser().feed(bytes(data)) == [Damaged(7)]


@given(packets.filter(lambda packet: len(packet.parameters) > 0), st.data())
def test_one_bit_that_turned_over_is_never_taken_for_another_packet(
    packet: DynamixelPacket, data: st.DataObject
) -> None:
    wire = bytearray(packet.encoded())
    bit = data.draw(st.integers(0, 8 * len(wire) - 1))
    wire[bit // 8] ^= 1 << bit % 8
    assert not [each for each in DynamixelParser().feed(bytes(wire)) if isinstance(each, DynamixelPacket)]


@settings(max_examples=400)
@given(st.lists(st.one_of(st.binary(max_size=300), st.just(HEADER), packets.map(DynamixelPacket.encoded)), max_size=8))
def test_no_bytes_make_the_parser_raise_or_hold_more_than_a_packet(pieces: list[bytes]) -> None:
    parser = DynamixelParser()
    for piece in pieces:
        parser.feed(piece)
        parser.feed(piece[::-1])
    assert len(parser._held) <= 7 + 1024


def test_the_crc_of_nothing_is_zero_and_sees_where_a_byte_stands() -> None:
    assert crc16(b"") == 0
    assert crc16(b"\x01\x02") != crc16(b"\x02\x01")
