"""The vendor's SDK, unmodified, with its own serial port, is what judges the virtual servos: through a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

dynamixel_sdk = pytest.importorskip("dynamixel_sdk", reason="pip install 'allegro-twin[dynamixel]'")
if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

from allegro_twin.drivers.dynamixel.codec.table import MODELS, Model  # noqa: E402  # What is missing is said first.
from allegro_twin.drivers.dynamixel.virtual.hand import VirtualServoHand  # noqa: E402  # As above.
from tests.drivers.serial.rigs import Joints, Serving, calibrated, small_spec, soon  # noqa: E402  # As above.

BAUD = 1_000_000
PATIENCE = 1000.0
"""ms: a busy computer is no silent servo."""


@pytest.fixture
def hand() -> VirtualServoHand:
    return VirtualServoHand(Joints(small_spec()), calibrated(), BAUD)


@pytest.fixture
def port(hand: VirtualServoHand, tmp_path: Path) -> Iterator[Any]:
    with Serving(tmp_path / "hand.tty", hand):
        opened = dynamixel_sdk.PortHandler(str(tmp_path / "hand.tty"))
        assert opened.openPort()
        assert opened.setBaudRate(BAUD)
        wait = opened.setPacketTimeout
        opened.setPacketTimeout = lambda length: (wait(length), opened.setPacketTimeoutMillis(PATIENCE))
        yield opened
        opened.closePort()


@pytest.fixture
def packets() -> Any:
    return dynamixel_sdk.PacketHandler(2.0)


def test_a_ping_says_the_model_and_a_broadcast_finds_everybody(port: Any, packets: Any) -> None:
    assert packets.ping(port, 3) == (1020, 0, 0)
    found, result = packets.broadcastPing(port)
    assert result == 0
    assert found == {identifier: [1020, 45] for identifier in (3, 4, 5, 6)}


def test_the_eeprom_is_locked_while_torque_is_on(port: Any, packets: Any) -> None:
    assert packets.write1ByteTxRx(port, 3, 11, 5) == (0, 0)
    assert packets.write1ByteTxRx(port, 3, 64, 1) == (0, 0)
    result, error = packets.write1ByteTxRx(port, 3, 11, 3)
    assert (result, error) == (0, 7)
    assert packets.getRxPacketError(error) == "[RxPacketError] Writing or Reading is not available to target address!"
    assert packets.read1ByteTxRx(port, 3, 11) == (5, 0, 0)


def test_a_goal_current_above_the_limit_is_error_6_and_other_mistakes_have_their_numbers(
    port: Any, packets: Any
) -> None:
    assert packets.write2ByteTxRx(port, 4, 38, 100) == (0, 0)
    assert packets.write2ByteTxRx(port, 4, 102, 101) == (0, 6)
    assert packets.write2ByteTxRx(port, 4, 102, 100) == (0, 0)
    assert packets.write1ByteTxRx(port, 4, 11, 9) == (0, 4)
    assert packets.write2ByteTxRx(port, 4, 116, 0) == (0, 5)
    assert packets.write4ByteTxRx(port, 4, 132, 0) == (0, 7)


def test_sync_write_and_sync_read_move_the_hand_and_tell_where_it_is(
    port: Any, packets: Any, hand: VirtualServoHand
) -> None:
    for identifier in (3, 4, 5, 6):
        assert packets.write1ByteTxRx(port, identifier, 11, 5) == (0, 0)
        assert packets.write1ByteTxRx(port, identifier, 64, 1) == (0, 0)
    write = dynamixel_sdk.GroupSyncWrite(port, packets, 116, 4)
    for k in range(4):
        assert write.addParam(3 + k, list((2300 + 10 * k).to_bytes(4, "little")))
    assert write.txPacket() == 0
    read = dynamixel_sdk.GroupSyncRead(port, packets, 126, 10)
    for identifier in (3, 4, 5, 6):
        assert read.addParam(identifier)

    def there() -> bool:  # The SDK gives an answer up after milliseconds, which a busy machine may take.
        return read.txRxPacket() == 0 and all(abs(read.getData(3 + k, 132, 4) - (2300 + 10 * k)) <= 1 for k in range(4))

    assert soon(there, 30.0)  # The SDK waits busily, in one interpreter with the hand.
    np.testing.assert_allclose(hand.state.position, np.array([252, -252, 252, -252]) * np.pi / 2048, atol=0.003)


def test_bulk_read_and_write_and_reg_write_with_action(port: Any, packets: Any) -> None:
    write = dynamixel_sdk.GroupBulkWrite(port, packets)
    assert write.addParam(3, 65, 1, [1])
    assert write.addParam(4, 112, 4, [7, 0, 0, 0])
    assert write.txPacket() == 0
    read = dynamixel_sdk.GroupBulkRead(port, packets)
    assert read.addParam(3, 65, 1)
    assert read.addParam(4, 112, 4)
    assert read.txRxPacket() == 0
    assert (read.getData(3, 65, 1), read.getData(4, 112, 4)) == (1, 7)
    assert packets.regWriteTxRx(port, 5, 65, 1, [1]) == (0, 0)
    assert packets.read1ByteTxRx(port, 5, 65) == (0, 0, 0)
    assert packets.read1ByteTxRx(port, 5, 69) == (1, 0, 0)
    packets.action(port, 5)
    assert soon(lambda: bool(packets.read1ByteTxRx(port, 5, 65) == (1, 0, 0)))


def test_the_bus_watchdog_strikes_and_is_cleared(port: Any, packets: Any, hand: VirtualServoHand) -> None:
    assert packets.write1ByteTxRx(port, 3, 11, 5) == (0, 0)
    assert packets.write1ByteTxRx(port, 3, 64, 1) == (0, 0)
    assert packets.write1ByteTxRx(port, 3, 98, 2) == (0, 0)
    assert soon(lambda: hand.servos[0].memory.get("bus_watchdog") == -1)
    assert packets.read1ByteTxRx(port, 3, 98) == (255, 0, 0)
    assert packets.write4ByteTxRx(port, 3, 116, 2100) == (0, 4)
    assert packets.write1ByteTxRx(port, 3, 98, 0) == (0, 0)
    assert packets.write4ByteTxRx(port, 3, 116, 2100) == (0, 0)


def test_a_hardware_error_sets_the_alert_bit_until_a_reboot(port: Any, packets: Any, hand: VirtualServoHand) -> None:
    hand.servos[2].fail(1 << 5)
    assert packets.read1ByteTxRx(port, 5, 70) == (32, 0, 0x80)
    assert packets.reboot(port, 5) == (0, 0)
    assert packets.read1ByteTxRx(port, 5, 70) == (0, 0, 0)


def test_a_factory_reset_and_clear(port: Any, packets: Any) -> None:
    assert packets.clearMultiTurn(port, 6) == (0, 0)
    assert packets.write2ByteTxRx(port, 6, 38, 50) == (0, 0)
    assert packets.factoryReset(port, 6, 0x02) == (0, 0)
    assert packets.read2ByteTxRx(port, 6, 38) == (1193, 0, 0)


def test_at_another_speed_nobody_answers(port: Any, packets: Any) -> None:
    assert port.setBaudRate(57_600)
    port.setPacketTimeout = lambda length: port.setPacketTimeoutMillis(100.0)
    assert packets.ping(port, 3)[1] == dynamixel_sdk.COMM_RX_TIMEOUT
    port.setBaudRate(BAUD)
    port.setPacketTimeout = lambda length: port.setPacketTimeoutMillis(PATIENCE)
    assert packets.write1ByteTxRx(port, 3, 8, 1) == (0, 0)
    assert port.setBaudRate(57_600)
    assert packets.ping(port, 3) == (1020, 0, 0)


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_scattered_items_are_read_and_written_together_through_indirect_addresses(
    model: Model, tmp_path: Path, packets: Any
) -> None:
    """As e-Manual has it: pointers from 168 on, their data from 224 (XM430) or 208 (XC330) on."""
    hand = VirtualServoHand(Joints(small_spec()), calibrated(model=model), BAUD)
    pointers, data, count = model.indirect[0]
    with Serving(tmp_path / "hand.tty", hand):
        port = dynamixel_sdk.PortHandler(str(tmp_path / "hand.tty"))
        assert port.openPort()
        assert port.setBaudRate(BAUD)
        wait = port.setPacketTimeout
        port.setPacketTimeout = lambda length: (wait(length), port.setPacketTimeoutMillis(PATIENCE))
        items = (65, 116, 117, 118, 119, 146, 132, 133, 134, 135)  # LED, Goal Position, Temperature, Present Position.
        for identifier in (3, 4):
            assert packets.read2ByteTxRx(port, identifier, pointers + 2 * (count - 1)) == (data + count - 1, 0, 0)
            for k, address in enumerate(items):
                assert packets.write2ByteTxRx(port, identifier, pointers + 2 * k, address) == (0, 0)
            assert packets.write1ByteTxRx(port, identifier, 11, 5) == (0, 0)
            assert packets.write1ByteTxRx(port, identifier, 64, 1) == (0, 0)
        write = dynamixel_sdk.GroupSyncWrite(port, packets, data, 5)
        bulk = dynamixel_sdk.GroupBulkRead(port, packets)
        read = dynamixel_sdk.GroupSyncRead(port, packets, data + 5, 5)
        for identifier in (3, 4):
            assert write.addParam(identifier, [1, *(2200 + identifier).to_bytes(4, "little")])
            assert bulk.addParam(identifier, data, 5)
            assert read.addParam(identifier)
        assert write.txPacket() == 0
        assert soon(lambda: bulk.txRxPacket() == 0 and bulk.getData(3, data, 1) == 1)
        assert [bulk.getData(k, data + 1, 4) for k in (3, 4)] == [2203, 2204]
        assert [packets.read4ByteTxRx(port, k, 116)[0] for k in (3, 4)] == [2203, 2204]

        def there() -> bool:
            return read.txRxPacket() == 0 and all(abs(read.getData(k, data + 6, 4) - 2200 - k) <= 1 for k in (3, 4))

        assert soon(there, 30.0)
        assert read.getData(3, data + 5, 1) == hand.servos[0].memory.get("present_temperature")
        many = dynamixel_sdk.GroupBulkWrite(port, packets)
        assert many.addParam(3, data, 1, [0])
        assert many.txPacket() == 0
        assert soon(lambda: packets.read1ByteTxRx(port, 3, 65) == (0, 0, 0))
        port.closePort()
