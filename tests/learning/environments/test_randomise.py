"""Each range does what it says, to each simulation by what that one drew, and is gone when it is not asked for."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from allegro_twin.learning.environments.randomise import RANGES, Randomise
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.types import Array

N = 5
STILL = np.zeros((N, 16), np.float32)


def made(task: str = "Reach", **ranges: Any) -> tuple[HandVectorEnv, dict[str, Any]]:
    """Simulations of which one range, or a few, are drawn, and what was drawn."""
    kwargs: dict[str, Any] = {} if task == "Reach" else {"objects": ("lemon",), "level": "easy"}
    env = HandVectorEnv(task, N, threads=1, autoreset_mode="disabled", randomise=ranges, **kwargs)
    return env, env.reset(seed=11)[1]["randomised"]


def field(env: HandVectorEnv, name: str) -> Array:
    """A model field of every simulation."""
    return np.array([np.array(getattr(env.engine.worlds.snapshot(row).model, name)) for row in range(N)])


def dofs(env: HandVectorEnv) -> list[int]:
    worlds = env.engine.worlds
    return [int(worlds.model.joint(name).dofadr[0]) for name in worlds.spec.joints]


def test_what_was_drawn_lies_in_its_range_differs_between_simulations_and_is_reported() -> None:
    default = Randomise.default()
    env = HandVectorEnv("Lift", 64, threads=1, objects=("lemon",), randomise="default", touch=True)
    report = env.reset(seed=0)[1]["randomised"]
    names = set(RANGES)
    assert {name for name in report if not name.startswith("_")} == names
    for name in names:
        low, high = getattr(default, name)
        size = np.abs(report[name])  # A tilt goes either way.
        assert (size >= low).all()
        assert (size <= high).all()
        spread = np.ptp(size)
        assert spread > 0.8 * (high - low) or low == high, name
        assert report[f"_{name}"].all()
    assert set(report["actuator_delay"]) == {0.0, 1.0, 2.0}
    assert set(report["sensor_delay"]) == {0.0, 1.0}


def test_the_mass_of_the_object_and_its_inertia_follow_and_no_other_body_s() -> None:
    plain, _ = made("Lift")
    env, drawn = made("Lift", mass=(0.5, 2.0))
    thing = env.engine.task.object_body
    assert thing is not None
    for name in ("body_mass", "body_inertia"):
        ratio = field(env, name)[:, 1:] / field(plain, name)[:, 1:]
        ratio = ratio.reshape(N, ratio.shape[1], -1)
        np.testing.assert_allclose(ratio[:, thing.id - 1], np.tile(drawn["mass"][:, None], ratio.shape[2]), rtol=1e-12)
        np.testing.assert_array_equal(np.delete(ratio, thing.id - 1, axis=1), 1.0)
    # What MuJoCo derives from them is derived anew.
    weights = field(env, "body_invweight0")[:, thing.id, 0] * field(env, "body_mass")[:, thing.id]
    np.testing.assert_allclose(weights, 1.0, rtol=1e-9)


def test_the_size_of_the_object_follows_at_the_same_mass() -> None:
    plain, _ = made("Lift")
    env, drawn = made("Lift", size=(0.8, 1.2))
    thing = env.engine.task.object_body
    assert thing is not None
    geom = thing.geoms.start
    for name, power in (("geom_size", 1), ("geom_aabb", 1), ("geom_rbound", 1)):
        now, before = (field(e, name)[:, geom].reshape(N, -1) for e in (env, plain))
        np.testing.assert_allclose(now, before * drawn["size"][:, None] ** power, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(field(env, "body_mass"), field(plain, "body_mass"))
    inertia = field(env, "body_inertia")[:, thing.id] / field(plain, "body_inertia")[:, thing.id]
    np.testing.assert_allclose(inertia, np.tile(drawn["size"][:, None] ** 2, 3), rtol=1e-12)
    # A larger object stands higher on the table.
    heights = thing.pose[:, 2] / plain.engine.task.object_body.pose[:, 2]  # type: ignore[union-attr]  # It is there.
    np.testing.assert_allclose(heights, drawn["size"], rtol=1e-12)


def test_friction_is_that_of_every_contact() -> None:
    env, drawn = made(friction=(0.3, 0.9))
    np.testing.assert_array_equal(field(env, "geom_friction")[:, :, 0], np.tile(drawn["friction"][:, None], 63))


@pytest.mark.parametrize(("name", "where"), [("armature", "dof_armature"), ("frictionloss", "dof_frictionloss")])
def test_what_the_joints_have_is_that_of_every_joint(name: str, where: str) -> None:
    env, drawn = made("Reach", **{name: (0.01, 0.02)})
    np.testing.assert_array_equal(field(env, where)[:, dofs(env)], np.tile(drawn[name][:, None], 16))


def test_damping_is_a_factor_on_the_hand_s() -> None:
    env, drawn = made(damping=(0.5, 2.0))
    ratio = field(env, "dof_damping")[:, dofs(env)] / env.engine.task.spec.actuation.damping
    np.testing.assert_allclose(ratio, np.tile(drawn["damping"][:, None], 16), rtol=1e-12)


def test_the_palm_leans_by_what_was_drawn_about_its_own_axes() -> None:
    plain, _ = made()
    env, drawn = made(wrist_tilt=(0.01, 0.05))
    palm = env.engine.worlds.model.body("palm_link").id
    before, now = field(plain, "body_quat")[:, palm], field(env, "body_quat")[:, palm]
    np.testing.assert_allclose(np.linalg.norm(now, axis=1), 1.0, rtol=1e-12)
    for row in range(N):
        turn, inverse, between = np.zeros(3), np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(inverse, before[row])
        mujoco.mju_mulQuat(between, inverse, now[row])
        mujoco.mju_quat2Vel(turn, between, 1.0)
        np.testing.assert_allclose(turn, drawn["wrist_tilt"][row], atol=1e-4)  # (0.05)³ / 12 of the small angles.


def first_torque(env: HandVectorEnv) -> Array:
    """What the motors are told in each period of a step in which no time passes, (periods, n, joints), N·m."""
    env.reset(seed=11)
    position, velocity = (np.array(x) for x in (env.engine.worlds.position, env.engine.worlds.velocity))
    told: list[Array] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(env.engine.worlds, "step", lambda rows, count: told.append(np.array(env.engine.worlds.control)))
        env.step(STILL + 0.5)
    assert np.array_equal(position, env.engine.worlds.position)
    assert np.array_equal(velocity, env.engine.worlds.velocity)
    return np.array(told)


def test_gains_are_factors_on_kp_and_kd() -> None:
    plain, _ = made()
    env, drawn = made(gains=(0.5, 2.0))
    interface = env.engine.task.interface
    torque, before = first_torque(env), first_torque(plain)
    kp, kd = drawn["gains"][:, :1], drawn["gains"][:, 1:]
    # The targets travel at one rate: that is kd's part of every torque, and kp's grows from period to period.
    np.testing.assert_allclose(torque[5] - torque[0], kp * (before[5] - before[0]), rtol=1e-9)
    of_rate = interface.gains.kd * interface.step * 0.5 / interface.seconds
    np.testing.assert_allclose(torque[0] - kp * (before[0] - of_rate), kd * np.tile(of_rate, (N, 1)), rtol=1e-9)


def test_strength_is_a_factor_on_the_torque_that_a_motor_can_give() -> None:
    plain, _ = made()
    env, drawn = made(strength=(0.5, 1.5))
    limit = env.engine.task.spec.actuation.torque_limit
    wished = np.clip(first_torque(plain), -limit, limit)
    np.testing.assert_allclose(first_torque(env), wished * drawn["strength"][:, None], rtol=1e-12)


def test_a_torque_acts_as_many_periods_late_as_was_drawn() -> None:
    plain, _ = made()
    env, drawn = made(actuator_delay=(0, 3))
    torque, late = first_torque(plain), first_torque(env)
    assert len(set(drawn["actuator_delay"])) > 1
    for row, delay in enumerate(drawn["actuator_delay"].astype(int)):
        np.testing.assert_array_equal(late[:delay, row], 0.0)
        np.testing.assert_array_equal(late[delay:, row], torque[: len(torque) - delay, row])


def test_a_measurement_arrives_as_many_periods_late_as_was_drawn() -> None:
    env, drawn = made(sensor_delay=(0, 3))
    assert len(set(drawn["sensor_delay"])) > 1
    engine = env.engine
    engine.worlds.velocity[:] = 0.0
    marks = np.arange(1.0, 8.0)
    for tick, mark in enumerate(marks):
        engine.worlds.position[:] = mark
        seen, _ = engine._sensing.measure(np.full(N, tick))
        for row, delay in enumerate(drawn["sensor_delay"].astype(int)):
            if tick >= delay:
                np.testing.assert_array_equal(seen[row], marks[tick - delay])


@pytest.mark.parametrize(("name", "which"), [("encoder_noise", 0), ("velocity_noise", 1)])
def test_noise_is_as_wide_as_was_drawn_and_other_at_every_period(name: str, which: int) -> None:
    env, drawn = made("Reach", **{name: (0.01, 0.1)})
    engine = env.engine
    true = (engine.worlds.position, engine.worlds.velocity)
    errors = np.array([engine._sensing.measure(np.full(N, tick))[which] - true[which] for tick in range(200)])
    np.testing.assert_array_equal(engine._sensing.measure(np.zeros(N, np.int64))[1 - which], true[1 - which])
    widest = np.abs(errors).max(axis=(0, 2))
    assert (widest <= drawn[name] * (1 + 1e-9)).all()
    np.testing.assert_allclose(widest, drawn[name], rtol=0.01)  # Of 3200 uniform numbers.
    np.testing.assert_allclose(errors.mean(axis=(0, 2)), 0.0, atol=4 * 0.1 / np.sqrt(3 * 3200))
    assert len(np.unique(errors)) == errors.size


def test_positions_are_told_in_whole_steps() -> None:
    env, drawn = made(quantisation=(0.01, 0.05))
    seen, _ = env.engine._sensing.measure(np.zeros(N, np.int64))
    steps = seen / drawn["quantisation"][:, None]
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    error = np.abs(seen - env.engine.worlds.position)
    assert (error <= drawn["quantisation"][:, None] / 2 + 1e-12).all()
    assert error.max() > 0


def test_an_episode_that_draws_leaves_nothing_to_one_whose_range_is_a_point() -> None:
    env, _ = made("Lift", mass=(0.5, 2.0), size=(0.8, 1.2), friction=(0.3, 0.9))
    first = {name: field(env, name) for name in ("body_mass", "body_inertia", "geom_size", "geom_friction")}
    env.reset(seed=99)
    assert not np.array_equal(first["body_mass"], field(env, "body_mass"))
    env.reset(seed=11)
    for name, values in first.items():
        np.testing.assert_array_equal(field(env, name), values)
