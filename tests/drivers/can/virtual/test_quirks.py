"""Where sources disagree on what a real hand does, a virtual one can be either."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.app.rig import SimulatedScene
from allegro_twin.app.serve_can import virtual_firmware
from allegro_twin.drivers.can.codec import messages as m
from allegro_twin.drivers.can.codec.frames import Frame, single
from allegro_twin.drivers.can.virtual.firmware import Firmware
from allegro_twin.types import TorqueCommand
from tests.conftest import can_config, on_a_bus
from tests.drivers.can.rigs import PERIOD


def virtual(**quirks: str) -> Firmware:
    return virtual_firmware(can_config("v4", firmware=quirks), SimulatedScene(), step=PERIOD, restart=False)


def told(hand: Firmware, *messages: m.Message) -> None:
    for message in messages:
        hand.receive(hand.codec.encode(message))


def torque(finger: int, value: float) -> m.SetTorque:
    return m.SetTorque(finger, (value,) * 4)


def test_a_driver_that_sends_the_period_and_never_servo_on_hears_the_hand_and_moves_it() -> None:
    """Fairo's v4 driver, whose notes say that servo has no effect."""
    hand = virtual(servo="ignored")
    told(hand, m.SetPeriod(PERIOD), *[torque(finger, 0.1) for finger in range(4)])
    assert len(single(hand.step())) == 4
    before = hand.state.position
    for _ in range(30):
        hand.step()
    assert np.abs(hand.state.position - before).max() > 0.01
    usual = virtual()
    told(usual, m.SetPeriod(PERIOD), torque(0, 0.1))
    assert usual.step() == []


def test_a_hand_on_which_servo_has_no_effect_is_left_limp_all_the_same() -> None:
    backend = on_a_bus("v4", firmware={"servo": "ignored"})
    backend.reset()
    for _ in range(20):
        backend.write(TorqueCommand(np.full(16, 0.05)))
        backend.read()
    hands = backend._port.link._time.hands  # type: ignore[union-attr]  # It is virtual.
    (hand,) = hands.firmwares
    assert any(hand.torque)
    backend.close()
    assert not any(hand.torque)
    assert hand.step() == []
    assert backend.unconfirmed == ""


@pytest.mark.parametrize(("clip", "most"), [("driver", 375 / 1200), ("full", 1.0)])
def test_a_driver_that_does_not_clip_gets_what_the_motors_have(clip: str, most: float) -> None:
    """The ROS 2 driver's effort mode sends 1,800 counts where the manufacturer's others stop at 375."""
    hand = virtual(clip=clip)
    told(hand, m.SetPeriod(PERIOD), m.ServoOn())
    hand.receive(Frame(0x180, np.array([1800, 0, 0, 0], "<i2").tobytes()))
    hand.step()
    hand.step()
    assert hand.state.torque[0] == pytest.approx(most)
