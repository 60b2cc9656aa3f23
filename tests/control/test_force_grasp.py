"""The envelop grasp wraps with constant torques, and then holds on where the object stopped its fingers; the latching
grasp squeezes from there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from allegro_twin.control.controllers import PD
from allegro_twin.control.force_grasp import CentroidGrasp, EnvelopGrasp, LatchGrasp, LatchParameters
from allegro_twin.control.trajectory import Hold
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.types import HandState, Vector, frozen
from tests.control.test_controllers import gravity_of
from tests.test_safety import state

SPEC = load_spec()
REST = SPEC.posture(np.clip(0.3, SPEC.lower, SPEC.upper))
TORQUE = frozen(np.tile([0.0, 0.2, 0.1, 0.1], 4))


def envelop(squeeze_at: float) -> EnvelopGrasp:
    reach = PD(Hold(REST), load_gains("default", SPEC))
    gravity, joints = gravity_of(SPEC, np.zeros(3)), np.array([finger.joints for finger in SPEC.fingers])
    return EnvelopGrasp(reach, 0.1, squeeze_at, gravity, joints, TORQUE, closing_scale=0.5, stiffness=5.0, ramp=0.1)


def still(t: float, position: Vector = REST) -> HandState:
    return state(round(t / 0.003), position=position, velocity=np.zeros(16))


def torque_after(controller: EnvelopGrasp, seconds: float, then: Vector) -> Vector:
    """The torque at `then`, after the hand has stood still at REST for a while."""
    memory = controller.start(still(0.0))
    for t in np.arange(0.0, seconds, 0.003):
        _, memory = controller(still(float(t)), memory)
    command, _ = controller(still(seconds, then), memory)
    return command.torque


def test_before_the_squeeze_a_part_of_the_torque_closes_whatever_the_position() -> None:
    for position in (REST, SPEC.posture(REST + 0.05)):
        np.testing.assert_allclose(torque_after(envelop(9.0), 0.5, position)[1:4], 0.5 * TORQUE[1:4], atol=1e-12)


def test_a_wrapped_object_that_moves_meets_a_spring_on_top_of_the_whole_torque() -> None:
    at_rest = torque_after(envelop(0.2), 0.6, REST)
    np.testing.assert_allclose(at_rest[TORQUE != 0], TORQUE[TORQUE != 0], atol=1e-12)
    moved = torque_after(envelop(0.2), 0.6, SPEC.posture(REST - 0.02))
    np.testing.assert_allclose((moved - at_rest)[TORQUE != 0], 5.0 * 0.02, atol=1e-12)


def test_a_finger_that_still_moves_keeps_closing_and_is_no_spring() -> None:
    controller = envelop(0.2)
    memory = controller.start(still(0.0))
    velocity = np.zeros(16)
    velocity[1] = 1.0
    for t in np.arange(0.0, 0.6, 0.003):
        _, memory = controller(state(round(t / 0.003), position=REST, velocity=velocity), memory)
    assert np.isnan(memory.rest[:4]).all()
    np.testing.assert_array_equal(memory.rest[4:], REST[4:])


def test_joints_without_a_torque_follow_the_pre_shape() -> None:
    controller, away = envelop(0.2), SPEC.posture(REST + 0.05)
    command, _ = controller.reach(still(0.6, away), controller.reach.start(still(0.0)))
    np.testing.assert_allclose(torque_after(controller, 0.6, away)[::4], command.torque[::4])
    assert (np.abs(command.torque[::4]) > 0.1).all()


def test_a_centroid_grasp_that_asks_a_mirror_presses_once_every_finger_is_touched_though_they_move() -> None:
    touched, fingers = np.array([True, False]), ("index", "thumb")
    model, joints = hand_kinematics(SPEC), np.array([SPEC.finger(name).joints for name in fingers])
    reach, gravity = PD(Hold(REST), load_gains("default", SPEC)), gravity_of(SPEC, np.zeros(3))
    least = np.full(16, 1e-6)

    def met(seconds: float, felt: Callable[[], NDArray[np.bool_]] | None) -> float:
        controller = CentroidGrasp(
            reach, 0.1, 9.0, lambda q: model.fingertip_jacobians(q, fingers), joints, gravity, TORQUE, least, 3.0,
            contacts=felt,
        )  # fmt: skip
        memory = controller.start(still(0.0))
        for t in np.arange(0.0, seconds, 0.003):
            _, memory = controller(state(round(t / 0.003), position=REST, velocity=np.full(16, 0.5)), memory)
        return memory.contact

    assert np.isnan(met(0.6, lambda: touched))
    assert np.isnan(met(0.6, None))
    touched[1] = True
    assert met(0.6, lambda: touched) == pytest.approx(0.102)


OFFSET = frozen(np.tile([0.0, 0.02, 0.02, 0.01], 4))


def latching() -> LatchGrasp:
    """It closes from 0.1 to 0.5 s and goes on by 0.1 rad, with 0.1 N·m at most."""
    gains, ones = load_gains("default", SPEC), np.ones(16)
    parameters = LatchParameters(
        gains.kp * ones, gains.kd * ones, 0.1, 0.5, 0.2, 0.1 * ones, 0.0 * ones, 0.1 * ones, OFFSET
    )
    return LatchGrasp(Hold(REST), parameters, gravity_of(SPEC, np.zeros(3)))


def latched(stopped: Vector, then: Vector, seconds: float = 1.0) -> Vector:
    """The torque at `then`, after an object has stopped the fingers at `stopped` all the time."""
    controller = latching()
    memory = controller.start(still(0.0, stopped))
    for t in np.arange(0.0, seconds, 0.003):
        _, memory = controller(still(float(t), stopped), memory)
    return controller(still(seconds, then), memory)[0].torque


@pytest.mark.parametrize("off", [-0.05, 0.0, 0.05])
def test_a_latching_grasp_squeezes_with_the_same_torque_wherever_the_object_stopped_it(off: float) -> None:
    stopped = frozen(REST + off)
    stiffness = load_gains("default", SPEC).kp
    np.testing.assert_allclose(latched(stopped, stopped), stiffness * OFFSET, atol=1e-12)
    yielded = frozen(stopped - 0.01)
    np.testing.assert_allclose(latched(stopped, yielded), stiffness * (OFFSET + 0.01), atol=1e-12)


def test_a_latching_grasp_closes_with_no_more_than_its_share_and_goes_on_beyond_its_close() -> None:
    early = frozen(REST - 0.05)
    np.testing.assert_allclose(latched(early, early, 0.45), 0.1, atol=1e-12)
    np.testing.assert_allclose(latched(REST, frozen(REST + 0.095), 0.45), 12.0 * 0.005, atol=1e-9)


def test_before_it_closes_a_latching_grasp_has_all_of_its_torque() -> None:
    early = frozen(REST - 0.05)
    np.testing.assert_allclose(latched(early, early, 0.06), 12.0 * 0.05, atol=1e-12)
