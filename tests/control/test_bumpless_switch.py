"""A controller takes over without a jump, whatever the one before did."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.control.bumpless_switch import HANDOVER, BumplessSwitch
from allegro_twin.control.controllers import PD, PID, ConstantTorque, GravityCompensation, GravityFeedforward
from allegro_twin.control.trajectory import Hold
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run
from allegro_twin.types import Array, TorqueCommand
from tests.conftest import MakeSim
from tests.test_safety import state

SPEC = load_spec()
LIMIT = SPEC.actuation.torque_limit


@given(arrays(float, 16, elements=st.floats(-2, 2)), arrays(float, 16, elements=st.floats(-2, 2)))
def test_between_any_two_torques_no_period_changes_by_more_than_a_twentieth_of_the_clip(
    before: Array, after: Array
) -> None:
    relay = BumplessSwitch(ConstantTorque(before), LIMIT)
    memory = relay.start(state(0))
    sent = []
    for tick in range(200):
        if tick == 50:
            relay.switch(ConstantTorque(after))
        command, memory = relay(state(tick), memory)
        assert isinstance(command, TorqueCommand)
        sent.append(command.torque)
    assert (np.abs(np.diff(sent, axis=0)) <= 0.05 * LIMIT + 1e-12).all()
    np.testing.assert_allclose(sent[-1], np.clip(after, -LIMIT, LIMIT), atol=1e-12)
    np.testing.assert_allclose(sent[50], np.clip(before, -LIMIT, LIMIT), atol=1e-12)
    assert HANDOVER < 100 * 0.003


def test_a_changed_copy_goes_on_with_the_same_memory() -> None:
    relay = BumplessSwitch(PID(Hold(np.zeros(16)), load_gains("default", SPEC), LIMIT), LIMIT)
    memory = relay.start(state(0))
    for tick in range(10):
        _, memory = relay(state(tick), memory)
    before = memory.memory.integral
    relay.amend(lambda controller: controller)
    _, memory = relay(state(10), memory)
    assert (np.abs(memory.memory.integral) >= np.abs(before)).all()
    assert memory.memory.began == 0.0


@pytest.mark.parametrize("order", [("gravity", "pid", "pd", "torque"), ("torque", "pd", "gravity", "pid")])
def test_switching_among_all_controllers_on_a_moving_hand_is_smooth(order: tuple[str, ...], make_sim: MakeSim) -> None:
    gravity = GravityFeedforward(hand_kinematics(SPEC).gravity_torque)
    gains = load_gains("default", SPEC)
    start = SPEC.posture(np.clip(0.3, SPEC.lower, SPEC.upper))
    kinds = {
        "gravity": GravityCompensation(gravity),
        "pid": PID(Hold(start), gains, LIMIT, gravity),
        "pd": PD(Hold(start + 0.05), gains, gravity),
        "torque": ConstantTorque(np.full(16, 0.02)),
    }
    backend = make_sim(SPEC, facing=(0, 0, 1), fingers=(1, 0, 0), posture=start)
    relay = BumplessSwitch(kinds[order[0]], LIMIT)
    at_switch = []
    before = None
    for k, sample in enumerate(run(backend, relay)):
        assert isinstance(sample.command, TorqueCommand)
        if before is not None and k % 100 == 1 and k > 1:
            at_switch.append(np.abs(sample.command.torque - before) / LIMIT)
        before = sample.command.torque
        if k % 100 == 0 and 0 < k <= 300:
            relay.switch(kinds[order[k // 100]])
        if k == 350:
            break
    assert np.max(at_switch) <= 0.05
