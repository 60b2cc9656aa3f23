"""The FCI backend of a Franka arm, against a fake of pylibfranka with a simulated arm at its far end.

No arm was ever connected to these tests.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.backend import HandBackend, Recoverable
from allegro_twin.cell.arm.contact_reflex import CollisionSettings
from allegro_twin.cell.arm.fci import fci_thresholds
from allegro_twin.cell.arm.impedance import Impedance, Stiffness
from allegro_twin.cell.arm.limits import arm_limits
from allegro_twin.cell.arm.target import CartesianTarget
from allegro_twin.drivers.franka import CollisionThresholds, FrankaArm, FrankaSettings, open_franka
from allegro_twin.errors import ArmReflex, CommandError, ConfigError, HandFault, LinkError
from allegro_twin.hands.description.arms import load_arm_spec
from allegro_twin.kinematics.arm import ArmModel
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard
from allegro_twin.spec.arm import Load
from allegro_twin.testing import BackendContract
from allegro_twin.types import TorqueCommand, frozen
from tests.cell.arm.rigs import rig
from tests.drivers.fake_franka import FCI, FakeArm, FakeErrors, NetworkException

PUSH = np.array([12.0, 0.0, -5.0, 0.0, 0.0, 0.0])


def connected(cycles: int = 1, load: Load | None = None, **more: Any) -> tuple[FrankaArm, FakeArm]:
    spec = replace(load_arm_spec("fr3"), load=load)
    box = FakeArm(rig(spec=spec).sim)
    return FrankaArm(FCI, box, spec, cycles, **more), box


class TestContract(BackendContract):
    def make(self) -> HandBackend:
        return connected()[0]

    def does_not_apply(self, reason: str) -> None:
        """Rules of hands that take positions, and of backends whose time is not real."""
        assert reason in ("it takes torques", "it is live", "it is live, and this takes a second and more")


def constant(value: float) -> TorqueCommand:
    return TorqueCommand(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, value]))


def test_a_command_is_held_and_changes_by_one_newton_metre_a_millisecond_at_most() -> None:
    arm, box = connected(cycles=3)
    arm.reset()
    box.sent.clear()
    arm.write(constant(4.5))
    arm.read()
    arm.read()
    assert [round(float(torque[6]), 6) for torque in box.sent] == [1.0, 2.0, 3.0, 4.0, 4.5, 4.5]


def test_a_period_is_as_many_cycles_of_the_interface_as_was_said() -> None:
    arm, _ = connected(cycles=3)
    arm.reset()
    times = [(arm.read().t, arm.read().tick) for _ in range(2)]
    assert arm.period == pytest.approx(0.003)
    np.testing.assert_allclose([t for t, _ in times], [0.003, 0.009])
    assert [tick for _, tick in times] == [2, 4]


def test_cycles_without_a_command_are_counted() -> None:
    arm, box = connected()
    arm.reset()
    box.skipped = 4
    state = arm.read()
    assert arm.missed == 4
    assert state.tick == 5


def test_thresholds_and_load_are_set_before_control_begins() -> None:
    given = CollisionThresholds((20.0,) * 7, (40.0,) * 7, (10.0,) * 6, (30.0,) * 6)
    arm, box = connected(load=Load(1.3, frozen([0.0, 0.0, 0.09])), collision=given)
    arm.reset()
    assert box.calls == ["load 1.3", "start"]
    assert [each[0] for each in box.thresholds] == [20.0, 40.0, 10.0, 30.0]


def test_the_wrench_is_what_a_sensor_on_the_flange_would_have_with_the_loads_weight() -> None:
    arm, box = connected(load=Load(1.0, frozen([0.0, 0.0, 0.1])))
    box.wrench = np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])
    state = arm.reset()
    axes = ArmModel(arm.spec).flange(state.position).rotation
    np.testing.assert_allclose(axes @ (state.wrench[:3] - box.wrench[:3]), [0.0, 0.0, -9.81], atol=1e-9)
    np.testing.assert_allclose(np.cross([0.0, 0.0, 0.1], state.wrench[:3] - box.wrench[:3]), state.wrench[3:])


@pytest.mark.parametrize("name", ["joint_reflex", "cartesian_reflex"])
def test_a_reflex_is_named_with_its_force_and_recovery_leads_out_in_the_same_session(name: str) -> None:
    arm, box = connected()
    arm.reset()
    before = arm.read()
    box.collide(name, PUSH)
    with pytest.raises(ArmReflex, match=f"{name}: fr3 met something, 13 N on its flange, and holds itself") as error:
        arm.read()
    assert error.value.name == name
    assert error.value.wrench == tuple(PUSH)
    with pytest.raises(ArmReflex):
        arm.write(constant(0.0))
    assert isinstance(arm, Recoverable)
    after = arm.recover()
    assert box.calls[-4:] == ["stop", "recover", "load 0", "start"]
    assert after.t > before.t
    arm.write(constant(0.1))
    assert arm.read().t > after.t


def test_any_other_error_of_the_arm_is_named_as_libfranka_names_it() -> None:
    arm, box = connected()
    arm.reset()
    box.collide("joint_velocity_violation", PUSH)
    with pytest.raises(HandFault, match="fr3 has stopped: joint_velocity_violation; free it, and reset it") as error:
        arm.read()
    assert not isinstance(error.value, ArmReflex)


def test_an_arm_that_no_longer_answers_is_a_link_error_until_it_is_reset() -> None:
    arm, box = connected()
    arm.reset()
    box.fails = NetworkException("libfranka: UDP receive: Timeout\n")
    for _ in range(2):
        with pytest.raises(LinkError, match="fr3 does not answer: libfranka: UDP receive: Timeout; see to the cable"):
            arm.read()
    box.fails = None
    assert arm.reset().t == 0.0


def test_an_arm_in_reflex_is_recovered_by_a_reset() -> None:
    arm, box = connected()
    box.mode, box.errors = "Reflex", FakeErrors("joint_reflex")
    arm.reset()
    assert box.calls[0] == "recover"


def test_a_pressed_button_is_never_overridden() -> None:
    arm, box = connected()
    box.mode = "UserStopped"
    with pytest.raises(HandFault, match="fr3 is stopped by its button: release it, and reset"):
        arm.reset()
    assert "start" not in box.calls


def test_an_end_effector_in_desk_that_moves_the_frame_is_refused() -> None:
    arm, box = connected()
    box.desk[2, 3] = 0.1034
    with pytest.raises(ConfigError, match="Desk has an end effector whose frame is not the flange's"):
        arm.reset()
    assert box.calls[-1] == "stop"


def test_a_torque_beyond_the_motors_is_refused() -> None:
    arm, _ = connected()
    arm.reset()
    with pytest.raises(CommandError, match=r"fr3_joint7: 13\.0 N·m is beyond 12 N·m; put a guard before it"):
        arm.write(constant(13.0))


def test_before_a_reset_and_after_closing_nothing_is_read() -> None:
    arm, box = connected()
    with pytest.raises(HandFault, match="no session yet"):
        arm.read()
    arm.reset()
    arm.close()
    arm.close()
    assert box.calls.count("stop") == 1
    with pytest.raises(HandFault, match="is closed: reset it"):
        arm.read()
    assert arm.reset().t == 0.0


def test_the_cells_impedance_leads_the_simulated_arm_through_the_interface() -> None:
    arm, _ = connected()
    model = ArmModel(arm.spec)
    begin = model.pose(arm.reset().position)
    goal = Pose(begin.position + np.array([0.0, 0.05, 0.03]), begin.rotation)
    controller = Impedance(model, CartesianTarget(goal), Stiffness(1000.0, 50.0))
    *_, last = until(1.0, run(Guard(arm, arm_limits(arm.spec)), controller))
    assert np.linalg.norm(model.pose(last.state.position).position - goal.position) < 0.01


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylibfranka", None)
    with pytest.raises(ConfigError, match=r"pip install 'allegro-twin\[franka\]'"):
        open_franka(FrankaSettings(host="172.16.0.2"), load_arm_spec("fr3"))


def test_an_address_without_an_arm_is_one_line() -> None:
    pytest.importorskip("pylibfranka", exc_type=ImportError, reason="needs pylibfranka: extra franka")
    with pytest.raises(LinkError, match=r"no arm at 127\.0\.0\.1: .*activate the FCI in Desk"):
        open_franka(FrankaSettings(host="127.0.0.1", realtime="ignore"), load_arm_spec("fr3"))


def test_a_cells_thresholds_become_the_lower_of_its_two_phases() -> None:
    settings = CollisionSettings(
        upper_torque_thresholds_acceleration=(40.0,) * 7,
        upper_torque_thresholds_nominal=(20.0,) * 7,
        upper_force_thresholds_acceleration=(25.0, 40.0, 40.0, 25.0, 25.0, 25.0),
        upper_force_thresholds_nominal=(30.0,) * 6,
    )
    found = fci_thresholds(settings)
    assert found.upper_torque == (20.0,) * 7
    assert found.upper_force == (25.0, 30.0, 30.0, 25.0, 25.0, 25.0)
    assert found.lower_torque == (10.0,) * 7
