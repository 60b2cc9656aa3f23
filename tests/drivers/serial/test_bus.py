"""Several servos on one line."""

from __future__ import annotations

from allegro_twin.drivers.dynamixel.codec.packet import (
    BROADCAST,
    Damaged,
    DynamixelPacket,
    DynamixelParser,
    Heard,
    Instruction,
    PacketError,
    status,
)
from allegro_twin.drivers.dynamixel.codec.table import XM430_W350
from allegro_twin.drivers.dynamixel.virtual.bus import Bus
from allegro_twin.drivers.dynamixel.virtual.servo import Servo

BAUD = 1_000_000


def bus_of(*ids: int) -> Bus:
    bus = Bus([Servo(XM430_W350, identifier, BAUD) for identifier in ids])
    for k, servo in enumerate(bus.servos):
        servo.sense(1000 * k, 0, 0)
    return bus


def asked(bus: Bus, packet: DynamixelPacket, baud: int = BAUD) -> list[Heard]:
    return DynamixelParser().feed(bus.receive(packet.encoded(), baud))


def sync_read(*ids: int, address: int = 132, length: int = 4) -> DynamixelPacket:
    return DynamixelPacket(BROADCAST, Instruction.SYNC_READ, bytes((address, 0, length, 0, *ids)))


def test_a_ping_is_answered_by_the_one_it_is_for_and_a_broadcast_by_all_in_order() -> None:
    bus = bus_of(5, 2, 9)
    said = bytes((0xFC, 0x03, 45))
    assert asked(bus, DynamixelPacket(2, Instruction.PING)) == [status(2, 0, said)]
    assert asked(bus, DynamixelPacket(3, Instruction.PING)) == []
    assert asked(bus, DynamixelPacket(BROADCAST, Instruction.PING)) == [status(i, 0, said) for i in (2, 5, 9)]


def test_a_sync_read_is_answered_in_the_order_that_it_names() -> None:
    bus = bus_of(1, 2, 3)
    assert asked(bus, sync_read(3, 1)) == [
        status(3, 0, (2000).to_bytes(4, "little")),
        status(1, 0, (0).to_bytes(4, "little")),
    ]


def test_after_one_that_is_silent_nobody_answers_a_sync_read() -> None:
    bus = bus_of(1, 2, 3)
    bus.servos[1].mute = True
    assert [each.id for each in asked(bus, sync_read(1, 2, 3))] == [1]


def test_a_sync_write_reaches_all_and_is_answered_by_none() -> None:
    bus = bus_of(1, 2)
    words = bytes((65, 0, 1, 0, 2, 1, 1, 0))
    assert asked(bus, DynamixelPacket(BROADCAST, Instruction.SYNC_WRITE, words)) == []
    assert [servo.memory.get("led") for servo in bus.servos] == [0, 1]


def test_bulk_reads_and_writes_have_an_address_for_each() -> None:
    bus = bus_of(1, 2)
    assert asked(bus, DynamixelPacket(BROADCAST, Instruction.BULK_WRITE, bytes.fromhex("0141000100 0241000100"))) == []
    bulk = bytes((1, 65, 0, 1, 0, 1, 2, 104, 0, 4, 0, 100, 0, 0, 0))
    asked(bus, DynamixelPacket(BROADCAST, Instruction.BULK_WRITE, bulk))
    assert bus.servos[0].memory.get("led") == 1
    assert bus.servos[1].memory.get("goal_velocity") == 100
    read = bytes((2, 104, 0, 4, 0, 1, 65, 0, 1, 0))
    assert asked(bus, DynamixelPacket(BROADCAST, Instruction.BULK_READ, read)) == [
        status(2, 0, (100).to_bytes(4, "little")),
        status(1, 0, b"\x01"),
    ]


def test_reg_write_and_action_move_all_at_once() -> None:
    bus = bus_of(1, 2)
    for identifier in (1, 2):
        assert asked(bus, DynamixelPacket(identifier, Instruction.REG_WRITE, bytes((65, 0, 1)))) == [
            status(identifier, 0)
        ]
    assert not any(servo.memory.get("led") for servo in bus.servos)
    assert asked(bus, DynamixelPacket(BROADCAST, Instruction.ACTION)) == []
    assert all(servo.memory.get("led") for servo in bus.servos)
    assert asked(bus, DynamixelPacket(1, Instruction.ACTION)) == [status(1, PacketError.INSTRUCTION)]


def test_what_is_no_instruction_is_said_to_be_none() -> None:
    bus = bus_of(1)
    assert asked(bus, DynamixelPacket(1, 0x77)) == [status(1, PacketError.INSTRUCTION)]
    assert asked(bus, DynamixelPacket(1, Instruction.READ, b"\x00")) == [status(1, PacketError.LENGTH)]
    assert asked(bus, DynamixelPacket(1, Instruction.WRITE, b"\x00")) == [status(1, PacketError.INSTRUCTION)]


def test_a_garbled_packet_is_answered_with_a_crc_error() -> None:
    bus, data = bus_of(1), bytearray(DynamixelPacket(1, Instruction.WRITE, bytes((65, 0, 1))).encoded())
    data[10] ^= 4
    assert DynamixelParser().feed(bus.receive(bytes(data), BAUD)) == [status(1, PacketError.CRC)]
    assert bus.servos[0].memory.get("led") == 0


def test_the_status_return_level_says_what_is_answered() -> None:
    bus = bus_of(1)
    for level, answered in ((2, (1, 1, 1)), (1, (1, 1, 0)), (0, (1, 0, 0))):
        bus.servos[0].memory.put("status_return_level", level)
        packets = (
            DynamixelPacket(1, Instruction.PING),
            DynamixelPacket(1, Instruction.READ, bytes((132, 0, 4, 0))),
            DynamixelPacket(1, Instruction.WRITE, bytes((65, 0, 1))),
        )
        assert tuple(len(asked(bus, packet)) for packet in packets) == answered
    assert asked(bus, sync_read(1)) == []


def test_a_broadcast_read_or_write_is_answered_by_none() -> None:
    bus = bus_of(1, 2)
    assert asked(bus, DynamixelPacket(BROADCAST, Instruction.READ, bytes((132, 0, 4, 0)))) == []
    assert asked(bus, DynamixelPacket(BROADCAST, Instruction.WRITE, bytes((65, 0, 1)))) == []
    assert all(servo.memory.get("led") for servo in bus.servos)


def test_a_broadcast_does_not_reset_everything_of_everybody() -> None:
    bus = bus_of(7, 8)
    asked(bus, DynamixelPacket(BROADCAST, Instruction.FACTORY_RESET, b"\xff"))
    assert [servo.id for servo in bus.servos] == [7, 8]
    assert asked(bus, DynamixelPacket(7, Instruction.FACTORY_RESET, b"\xff")) == [status(7, 0)]
    assert bus.servos[0].id == 1


def test_two_servos_with_one_id_speak_over_each_other() -> None:
    bus = bus_of(4, 4)
    assert asked(bus, DynamixelPacket(4, Instruction.PING)) == [
        status(4, 0, bytes((0xFC, 0x03, 45)))
    ]  # They say the same.
    bus.servos[0].sense(0x0F0F, 0, 0)
    bus.servos[1].sense(0x00FF, 0, 0)
    heard = asked(bus, DynamixelPacket(4, Instruction.READ, bytes((132, 0, 4, 0))))
    assert heard == [Damaged(4)]


def test_at_another_speed_nobody_hears_anything() -> None:
    bus = bus_of(1)
    assert asked(bus, DynamixelPacket(1, Instruction.PING), baud=57_600) == []
    asked(bus, DynamixelPacket(1, Instruction.WRITE, bytes((8, 0, 1))))
    assert len(asked(bus, DynamixelPacket(1, Instruction.PING), baud=57_600)) == 1


def test_a_hardware_error_is_in_every_answer() -> None:
    bus = bus_of(1)
    bus.servos[0].fail(1 << 5)
    assert asked(bus, DynamixelPacket(1, Instruction.READ, bytes((70, 0, 1, 0)))) == [status(1, 0x80, b"\x20")]


def test_the_line_is_in_use_for_the_bytes_and_the_return_delays() -> None:
    bus = bus_of(1, 2, 3, 4)
    goals = bytes((116, 0, 4, 0)) + b"".join(bytes((i, 0, 0, 0, 0)) for i in (1, 2, 3, 4))
    asked(bus, DynamixelPacket(BROADCAST, Instruction.SYNC_WRITE, goals), BAUD)
    asked(bus, sync_read(1, 2, 3, 4, address=126, length=10))
    assert abs(bus.seconds - (136 * 10 / BAUD + 4 * 0.0005)) < 1e-9
