"""The simulated hand: its clock, its clip, its gravity, and the errors of a scene."""

from __future__ import annotations

import os

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from allegro_twin.control.controllers import ConstantTorque
from allegro_twin.errors import ConfigError, HandFault
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.orientation import matrix_facing, quaternion_facing
from allegro_twin.loop import run, until
from allegro_twin.sim.batch.cpu import CpuBatch
from allegro_twin.sim.engine.backend import SimBackend, substeps
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import TorqueCommand
from tests.conftest import MakeSim


@given(st.integers(1, 50))
def test_a_period_of_whole_physics_steps_is_accepted(count: int) -> None:
    assert substeps(count * 0.001, 0.001) == count


@pytest.mark.parametrize("period", [0.0, -0.003, 0.0025, 0.0005, float("nan"), float("inf")])
def test_any_other_period_is_refused_with_the_rule(period: float) -> None:
    with pytest.raises(ConfigError, match=r"is not a whole number of physics steps of 0\.001 s"):
        substeps(period, 0.001)


def test_no_torque_exceeds_the_clip_whatever_is_commanded(spec: HandSpec, make_sim: MakeSim) -> None:
    for sample in until(0.3, run(make_sim(spec), ConstantTorque(np.full(16, 50.0)))):
        assert (np.abs(sample.state.torque) <= spec.actuation.torque_limit + 1e-12).all()


def test_a_motor_runs_no_faster_than_its_back_emf_allows(spec: HandSpec, make_sim: MakeSim) -> None:
    fastest = (spec.actuation.torque_limit + 0.15) / spec.actuation.damping  # 0.15 N·m: more than any gravity torque.
    for sample in until(0.5, run(make_sim(spec), ConstantTorque(np.full(16, 50.0)))):
        assert (np.abs(sample.state.velocity) <= fastest).all()


@pytest.mark.parametrize(
    ("look", "fingers", "gravity"),
    [
        ((1, 0, 0), (0, 0, 1), (0, 0, -9.81)),
        ((0, 0, 1), (1, 0, 0), (-9.81, 0, 0)),
        ((0, 0, -1), (1, 0, 0), (9.81, 0, 0)),
        ((1, 0, 0), (0, 1, 0), (0, 9.81, 0)),
    ],
)
def test_gravity_is_reported_in_the_palm_frame(
    look: tuple[float, float, float],
    fingers: tuple[float, float, float],
    gravity: tuple[float, float, float],
    spec: HandSpec,
    make_sim: MakeSim,
) -> None:
    np.testing.assert_allclose(make_sim(spec, facing=look, fingers=fingers).reset().gravity, gravity, atol=1e-12)


def test_a_palm_cannot_look_where_its_fingers_point() -> None:
    with pytest.raises(ConfigError, match="must not be parallel"):
        matrix_facing((0, 0, 1), (0, 0, 2))
    np.testing.assert_allclose(quaternion_facing((1, 0, 0), (0, 0, 1)), [1, 0, 0, 0], atol=1e-12)


def test_a_hand_on_its_own_starts_inside_its_limits(side: Side, make_sim: MakeSim) -> None:
    spec = load_spec(side=side)
    position = make_sim(spec).reset().position
    assert ((position >= spec.lower) & (position <= spec.upper)).all()


def test_a_simulation_that_diverges_is_a_fault_and_not_a_quiet_restart(spec: HandSpec, make_sim: MakeSim) -> None:
    backend = make_sim(spec)
    backend.reset()
    backend.data.qvel[:] = 1e30
    with pytest.raises(HandFault, match=r"the simulation diverged at .* s"):
        for _ in range(5):
            backend.read()


def test_closing_leaves_the_hand_limp(spec: HandSpec, make_sim: MakeSim) -> None:
    backend = make_sim(spec)
    backend.reset()
    backend.write(TorqueCommand(np.full(16, 0.1)))
    backend.close()
    assert not backend.data.ctrl.any()


def test_every_scene_uses_the_options_that_were_measured(spec: HandSpec) -> None:
    option = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0, 0, 0]))).opt
    assert (option.timestep, option.impratio, option.noslip_iterations) == (0.001, 100.0, 2)
    assert int(option.cone) == int(mujoco.mjtCone.mjCONE_ELLIPTIC)
    assert int(option.integrator) == int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    assert int(option.jacobian) == int(mujoco.mjtJacobian.mjJAC_DENSE)


def test_the_files_actuation_reaches_the_compiled_model(spec: HandSpec, make_sim: MakeSim) -> None:
    model = make_sim(spec).model
    for name, values in (
        ("dof_damping", "damping"),
        ("dof_armature", "armature"),
        ("dof_frictionloss", "frictionloss"),
    ):
        np.testing.assert_array_equal(getattr(model, name).reshape(-1)[:16], getattr(spec.actuation, values))
    np.testing.assert_array_equal(model.actuator_forcerange[:, 1], spec.actuation.torque_limit)


def test_the_model_hash_of_a_recording_tells_models_apart(spec: HandSpec, make_sim: MakeSim) -> None:
    def identity(backend: SimBackend) -> str:
        return backend.meta()["model"]

    assert identity(make_sim(spec)) == identity(make_sim(spec))
    assert identity(make_sim(spec)) != identity(make_sim(load_spec(side="left")))


def test_a_batch_has_a_thread_for_each_processor_that_the_program_is_bound_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo's own count is of all that the computer has, whatever `taskset` or a scheduler of jobs says."""
    spec = load_spec()
    model = compile_scene(spec, Stage(np.zeros(3), quaternion_facing((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))))
    for bound in ({3}, {0, 2, 5}):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, bound=bound: bound)
        assert CpuBatch(spec, model, 4)._batch.nthread == len(bound)
    assert CpuBatch(spec, model, 4, threads=2)._batch.nthread == 2
