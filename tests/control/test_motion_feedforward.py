"""Inverse dynamics fed forward: what it gives is what the motion takes, and a hand that is as its file says follows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path as FilePath
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.control.controllers import PD, PID
from allegro_twin.control.motion_feedforward import MotionFeedforward
from allegro_twin.control.trajectory import Hold, Moves, Path, SetPoint
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run, until
from allegro_twin.sim.drivetrain import parasitic_torque
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec, Side
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.twin.rehearsal import rehearsal_trajectory
from allegro_twin.types import Array, Vector, frozen

SWING = 0.3
"""rad, about the middle of every joint's range."""


def swinging(spec: HandSpec, frequency: float = 1.0) -> tuple[Path, Callable[[float], Array]]:
    """A path on which all joints swing, each a little later than the one before, and its accelerations."""
    middle = (spec.lower + spec.upper) / 2.0
    phase = np.linspace(0.0, 3.0, spec.n_joints)
    omega = 2.0 * np.pi * frequency

    def path(t: float) -> SetPoint:
        angle = omega * t + phase
        return SetPoint(frozen(middle + SWING * np.sin(angle)), frozen(SWING * omega * np.cos(angle)))

    return path, lambda t: -SWING * omega**2 * np.sin(omega * t + phase)


@pytest.mark.parametrize("side", ["right", "left"])
def test_what_is_fed_forward_is_what_mujoco_says_that_the_motion_takes(side: Side) -> None:
    spec = load_spec(side=side)
    model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    model.opt.gravity[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, (path, acceleration) = mujoco.MjData(model), swinging(spec)
    places = [model.joint(name).qposadr[0] for name in spec.joints]
    dofs = [model.joint(name).dofadr[0] for name in spec.joints]
    smooth = replace(spec.actuation, frictionloss=np.zeros(spec.n_joints))
    feedforward = MotionFeedforward(hand_kinematics(spec).inverse_dynamics, smooth)
    for t in (0.1, 0.35, 0.8):
        data.qpos[places], data.qvel[dofs] = path(t)
        data.qacc[dofs] = acceleration(t)
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(feedforward(path, t), data.qfrc_inverse[dofs], rtol=2e-3, atol=2e-5)


def test_friction_is_fed_forward_in_the_direction_of_the_motion_and_not_at_rest() -> None:
    spec = load_spec()
    feedforward = MotionFeedforward(lambda q, v, a: np.zeros(16), spec.actuation)
    path, _ = swinging(spec)
    actuation = spec.actuation
    lossy = (
        feedforward(path, 0.1) - actuation.armature * swinging(spec)[1](0.1) - actuation.damping * path(0.1).velocity
    )
    fast = np.abs(path(0.1).velocity) > 0.2
    np.testing.assert_allclose(lossy[fast], (np.sign(path(0.1).velocity) * actuation.frictionloss)[fast], atol=1e-4)
    assert not feedforward(Hold(np.zeros(16)).begin(np.zeros(16)), 1.0).any()


def test_the_reference_is_looked_at_where_it_will_be_when_the_torque_acts() -> None:
    spec, (path, _) = load_spec(), swinging(load_spec())
    model = hand_kinematics(spec)
    late = MotionFeedforward(model.inverse_dynamics, spec.actuation, lead=0.02)
    np.testing.assert_allclose(late(path, 0.1), MotionFeedforward(model.inverse_dynamics, spec.actuation)(path, 0.12))


def test_a_motor_whose_torque_ripples_is_told_as_much_more_where_it_gives_less() -> None:
    spec, (path, _) = load_spec(), swinging(load_spec())
    drive = Drive.from_values({"ripple_cosine": 0.1, "ripple_sine": -0.05, "ripple_periods": 9}, 16)
    needed = MotionFeedforward(hand_kinematics(spec).inverse_dynamics, spec.actuation)
    told = replace(needed, stray=partial(parasitic_torque.torque, drive))(path, 0.35)
    angle = 9.0 * path(0.35).position
    given = told * (1.0 + 0.1 * np.cos(angle) - 0.05 * np.sin(angle))
    np.testing.assert_allclose(given, needed(path, 0.35), rtol=0.015)  # To the first order.
    assert np.abs(told / needed(path, 0.35) - 1.0).max() > 0.08


def rms(config: RunConfig, moves: Moves) -> float:
    """Of a run along moves, after the first of them, by the encoders, mrad."""
    rig = assemble(config)
    assert isinstance(rig.controller, PD | PID)
    controller: Controller[Any] = replace(rig.controller, reference=moves)
    path = moves.begin(rig.backend.reset().position)
    error = list[Vector]()
    for sample in until(path.seconds, run(rig.backend, controller)):
        if sample.state.t > path.times[1]:
            error.append(sample.state.position - path(sample.state.t).position)
    rig.backend.close()
    return 1e3 * float(np.sqrt(np.square(error).mean()))


@pytest.mark.parametrize("kind", ["pd", "pid"])
def test_a_hand_that_is_as_its_file_says_follows_five_times_closer(kind: str) -> None:
    config = RunConfig.model_validate({"backend": {"kind": "sim"}, "controller": {"kind": kind}})
    moves = rehearsal_trajectory(load_spec(), 1.0)
    fed = config.changed(controller={"inverse_dynamics": True})
    assert rms(fed, moves) < rms(config, moves) / 5.0


@pytest.mark.slow
def test_cables_and_cogging_of_the_hands_own_file_are_fed_forward(tmp_path: FilePath) -> None:
    file = tmp_path / "own.yaml"
    drive = {"bias_torque": 0.02, "cogging_cosine": 0.01, "cogging_periods": 9, "delay": 0.004}
    file.write_text(yaml.safe_dump({"model": "allegro", "drive": drive}))
    moves, found = rehearsal_trajectory(load_spec(), 1.0), {}
    for serial in ("", str(file)):
        config = load_config("can_virtual").changed(
            hand={"serial": serial}, task={"posture": "home"}, controller={"kind": "pd", "inverse_dynamics": True},
            backend={"scene": {"kind": "sim", "truth": {"drive": drive}}},
        )  # fmt: skip
        found[serial] = rms(config, moves)
    assert found[str(file)] < found[""] / 3.0


def test_who_cannot_have_it_is_told_so() -> None:
    config = RunConfig.model_validate(
        {"backend": {"kind": "sim"}, "controller": {"kind": "pd", "inverse_dynamics": True}}
    )
    with pytest.raises(ConfigError, match="controls force, .*leave out inverse_dynamics"):
        assemble(config.changed(task={"scenario": "scenarios/force/envelop.yaml"}))
    with pytest.raises(ConfigError, match="coupled joints"):
        hand_kinematics(load_spec("model_o")).inverse_dynamics(np.zeros(4), np.zeros(4), np.zeros(4))
