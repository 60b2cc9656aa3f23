"""A hand's own drive, as its file knows it, is what episodes draw: per joint, as wide as the intervals."""

from __future__ import annotations

import logging
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
import yaml

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.posterior import NORMAL, WIDE
from allegro_twin.learning.environments.settings import EnvSettings, read_settings
from allegro_twin.learning.environments.tensors import TensorVectorEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.tasks.scenes import compile_task_scene
from allegro_twin.learning.training.progress import input_fingerprints
from allegro_twin.learning.training.report import as_shipped
from allegro_twin.learning.training.settings import load_recipe
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.scene import Stage
from allegro_twin.types import Array, TorqueCommand

N = 500
SURE = 4.5
"""Standard errors: with fixed seeds a bound that is met stays met."""
K = np.linspace(0.8, 1.2, 16)
"""N·m at full PWM."""
PER_PWM = {"armature": 0.003, "damping": 0.07, "frictionloss": 0.02, "bias_torque": 0.004}
HALF = {"torque_constant": 0.1, "armature": 3e-4, "damping": 0.01, "frictionloss": 0.004, "offset": 0.01,
        "load_friction": 0.02, "bias_torque": 0.001}  # fmt: skip
OPEN, WRITTEN_NOMINAL = "middle_1", "ring_2"
"""A joint whose damping and offset are not determined, and one whose values are nominal."""


def table(**drive: Any) -> dict[str, Any]:
    """A hand's file as `identify` writes it."""
    labels = load_spec().joint_labels
    return {
        "wire": {"version": "v4", "side": "right", "torque_constant": K.tolist(), "encoder_offset": [3] * 16},
        "actuation": {name: (PER_PWM[name] * K).tolist() for name in ("armature", "damping", "frictionloss")},
        "drive": {"delay": 0.005, "load_friction": 0.1, "bias_torque": (PER_PWM["bias_torque"] * K).tolist()} | drive,
        "identified": {
            "interval": {name: [half] * 16 for name, half in HALF.items()} | {"delay": [0.002]},
            "not_determined": {"damping": {OPEN: "record more"}, "offset": {OPEN: "record more"}},
            "written": {label: "nominal" if label == WRITTEN_NOMINAL else "all" for label in labels},
            "noise": [2e-4] * 16,
        },
    }


def known(**drive: Any) -> dict[str, Any]:
    """A hand that is known exactly, and reports without noise."""
    content = table(**drive)
    nothing = {name: [0.0] * len(half) for name, half in content["identified"]["interval"].items()}
    return content | {"identified": {"interval": nothing}}


def write(content: dict[str, Any]) -> str:
    path = Path(mkdtemp()) / "my_hand.yaml"
    path.write_text(yaml.safe_dump(content))
    return str(path)


def made(content: dict[str, Any], n: int = 3, task: str = "Reach", **kwargs: Any) -> HandVectorEnv:
    randomise = {"twin": write(content)} | kwargs.pop("randomise", {})
    return HandVectorEnv(task, n, threads=1, autoreset_mode="disabled", randomise=randomise, **kwargs)


@cache
def draws() -> dict[str, Array]:
    """Draws of many episodes."""
    found: dict[str, Array] = made(table(), N).reset(seed=0)[1]["randomised"]["twin"]
    return {name: value for name, value in found.items() if not name.startswith("_")}


def column(label: str) -> int:
    return load_spec().joint_labels.index(label)


def usual() -> Array:
    """Joints whose values are all determined."""
    left = [column(OPEN), column(WRITTEN_NOMINAL)]
    return np.delete(np.arange(16), left)


def joints_seen(observation: Any) -> Array:
    """What a goal task shows of the joints."""
    found: Array = observation["observation"]
    return found


def assert_normal(values: Array, centre: Array, deviation: Array) -> None:
    np.testing.assert_array_less(np.abs(values.mean(axis=0) - centre), SURE * deviation / np.sqrt(N))
    np.testing.assert_allclose(values.std(axis=0) / deviation, 1.0, atol=SURE / np.sqrt(2 * N))
    beyond = (np.abs(values - centre) > NORMAL * deviation).mean()
    assert 0.03 < beyond < 0.07  # 5 % lie outside of a 95 % interval.


def test_strength_has_the_file_s_value_as_its_centre_and_its_interval_as_its_width() -> None:
    some = usual()
    assert_normal(draws()["strength"][:, some], np.ones(len(some)), HALF["torque_constant"] / K[some] / NORMAL)


@pytest.mark.parametrize("name", list(PER_PWM))
def test_what_a_recording_tells_per_torque_constant_is_drawn_so(name: str) -> None:
    some = usual()
    drawn = draws()
    per_pwm = drawn[name] / (K * drawn["strength"])
    width = np.full(len(some), HALF[name] / NORMAL)
    assert_normal(per_pwm[:, some], np.full(len(some), PER_PWM[name]), width)
    # More torque goes with more of it: a motion stays the recorded one.
    assert (drawn[name][:, some].std(axis=0) > (per_pwm * K)[:, some].std(axis=0)).all()


@pytest.mark.parametrize(
    ("name", "half", "centre"), [("encoder_offset", "offset", 0.0), ("load_friction",) * 2 + (0.1,)]
)
def test_offsets_and_friction_by_load_are_drawn_about_the_file_s(name: str, half: str, centre: float) -> None:
    some = usual()
    assert_normal(draws()[name][:, some], np.full(len(some), centre), np.full(len(some), HALF[half] / NORMAL))


def test_the_delay_is_one_for_the_whole_hand() -> None:
    delay = draws()["delay"]
    assert delay.shape == (N,)
    assert_normal(delay[:, None], np.array([0.005]), np.array([0.002 / NORMAL]))


def test_joints_are_drawn_apart_and_so_are_values() -> None:
    drawn = {name: value.reshape(N, -1) for name, value in draws().items() if name not in PER_PWM}
    drawn |= {name: draws()[name] / draws()["strength"] for name in PER_PWM}
    columns = np.concatenate(list(drawn.values()), axis=1).T
    correlation = np.corrcoef(columns)[np.triu_indices(len(columns), 1)]
    assert np.abs(correlation).max() < 5.0 / np.sqrt(N)  # Of 6000 pairs.
    assert len(columns) == 16 * 7 + 1


TOGETHER = {"of": ["torque_constant", "armature", "damping", "frictionloss", "offset", "bias_torque"]}


def correlated(below: list[float]) -> dict[str, Any]:
    """A file that tells how a joint's values hang together."""
    content = table()
    content["identified"]["correlation"] = TOGETHER | dict.fromkeys(load_spec().joint_labels, below)
    return content


def between(drawn: dict[str, Array], first: str, second: str, joint: int) -> float:
    per = {name: drawn[name][:, joint] / drawn["strength"][:, joint] for name in PER_PWM}
    one, other = (per.get(name, drawn[name][:, joint]) for name in (first, second))
    return float(np.corrcoef(one, other)[0, 1])


def test_values_of_a_joint_are_drawn_together_where_the_file_tells_their_correlations() -> None:
    below = np.zeros((6, 6))
    below[3, 2], below[4, 0], below[5, 1] = -0.9, 0.5, 0.7
    drawn = made(correlated(below[np.tril_indices(6, -1)].tolist()), N).reset(seed=0)[1]["randomised"]["twin"]
    joint, wide = column("index_1"), SURE / np.sqrt(N)
    assert between(drawn, "damping", "frictionloss", joint) == pytest.approx(-0.9, abs=0.19 * wide)
    assert between(drawn, "strength", "encoder_offset", joint) == pytest.approx(0.5, abs=0.75 * wide)
    assert between(drawn, "armature", "bias_torque", joint) == pytest.approx(0.7, abs=0.51 * wide)
    for first, second in (("armature", "damping"), ("strength", "damping"), ("encoder_offset", "bias_torque")):
        assert abs(between(drawn, first, second, joint)) < wide
    across = np.corrcoef(drawn["damping"][:, joint], drawn["frictionloss"][:, column("index_2")])[0, 1]
    assert abs(across) < wide  # Of another joint.
    for name, half in (("strength", HALF["torque_constant"] / K), ("encoder_offset", np.full(16, HALF["offset"]))):
        some, centre = usual(), 1.0 if name == "strength" else 0.0
        assert_normal(drawn[name][:, some], np.full(len(some), centre), half[some] / NORMAL)
    # A wide range says nothing of what goes with what.
    assert abs(between(drawn, "damping", "frictionloss", column(OPEN))) < wide
    damping, friction = (
        drawn[name][:, column(OPEN)] / drawn["strength"][:, column(OPEN)]
        for name in PER_PWM
        if name in ("damping", "frictionloss")
    )
    assert abs(np.corrcoef(damping, np.square(friction - friction.mean()))[0, 1]) < wide  # Nor of how far it is off.
    np.testing.assert_array_equal(drawn["load_friction"], draws()["load_friction"])


def test_correlations_of_zero_draw_what_a_file_without_them_draws() -> None:
    found = made(correlated([0.0] * 15), N).reset(seed=0)[1]["randomised"]["twin"]
    for name, value in draws().items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


def test_correlations_that_rounding_made_impossible_are_drawn_as_near_as_can_be() -> None:
    below = np.zeros((6, 6))
    below[1, 0] = below[2, 0] = 1.0
    below[2, 1] = 0.999
    drawn = made(correlated(below[np.tril_indices(6, -1)].tolist()), 50).reset(seed=0)[1]["randomised"]["twin"]
    assert between(drawn, "armature", "damping", 0) > 0.99


@pytest.mark.parametrize("given", [[0.1] * 14, [0.1] * 14 + [1.5], "none"])
def test_correlations_that_are_none_are_refused(given: Any) -> None:
    content = correlated([0.0] * 15)
    content["identified"]["correlation"][OPEN] = given
    with pytest.raises(ConfigError, match=rf"correlation\.{OPEN} needs 15 numbers from -1 to 1"):
        made(content)


def test_what_is_not_determined_is_drawn_from_the_wide_range() -> None:
    offset, joint = draws()["encoder_offset"][:, column(OPEN)], column(OPEN)
    damping = draws()["damping"][:, joint] / (K[joint] * draws()["strength"][:, joint])
    for values, centre, half in ((offset, 0.0, WIDE["encoder_offset"]), (damping, 0.07, 0.3 * 0.07)):
        assert np.abs(values - centre).max() <= half * (1 + 1e-9)
        assert np.abs(values - centre).max() > 0.98 * half
        np.testing.assert_allclose(values.std(), half / np.sqrt(3.0), rtol=0.1)


def test_a_joint_that_stayed_nominal_has_wide_ranges_for_all_its_values() -> None:
    k, drawn = column(WRITTEN_NOMINAL), draws()
    assert 0.24 < np.abs(drawn["strength"][:, k] - 1.0).max() <= 0.25
    armature = drawn["armature"][:, k] / (K[k] * drawn["strength"][:, k])
    assert 0.98 < np.abs(armature / PER_PWM["armature"] - 1.0).max() * 1.5 <= 1.0 + 1e-9


def test_what_the_file_has_no_interval_for_is_drawn_from_the_wide_range() -> None:
    content = table()
    del content["identified"]["interval"]["frictionloss"], content["identified"]["interval"]["load_friction"]
    drawn = made(content, 200).reset(seed=0)[1]["randomised"]["twin"]
    friction = drawn["frictionloss"] / (K * drawn["strength"])
    assert 0.0098 < np.abs(friction - 0.02).max() <= 0.01 + 1e-9
    np.testing.assert_array_equal(drawn["load_friction"], 0.1)  # What somebody wrote by hand is what it says.


def test_nothing_drawn_is_beyond_what_is_physical() -> None:
    content = table()
    content["identified"]["interval"] |= {"torque_constant": [3.0] * 16, "frictionloss": [0.2] * 16, "delay": [0.02]}
    drawn = made(content, 200).reset(seed=0)[1]["randomised"]["twin"]
    assert drawn["strength"].min() == pytest.approx(0.1)
    for name in ("frictionloss", "delay", "load_friction"):
        assert drawn[name].min() >= 0.0, name
    assert drawn["frictionloss"].min() == 0.0
    assert drawn["armature"].min() > 0.0


def test_models_have_what_was_drawn_and_a_new_episode_has_other_values() -> None:
    env = made(table())
    worlds, dofs = env.engine.worlds, [env.engine.worlds.model.joint(name).dofadr[0] for name in load_spec().joints]
    first: dict[str, Array] = {}
    for seed in (0, 7):
        drawn = env.reset(seed=seed)[1]["randomised"]["twin"]
        for row in range(3):
            model, strength = worlds.snapshot(row).model, drawn["strength"][row]
            for name in ("armature", "damping", "frictionloss"):
                np.testing.assert_array_equal(getattr(model, f"dof_{name}")[dofs], drawn[name][row])
            np.testing.assert_array_equal(model.actuator_gainprm[worlds.motors, 0], strength)
            limit = env.engine.task.spec.actuation.torque_limit * strength
            np.testing.assert_array_equal(model.actuator_forcerange[worlds.motors], np.stack([-limit, limit], axis=1))
        assert not first or not np.array_equal(first["strength"], drawn["strength"])
        first = drawn
    np.testing.assert_allclose(env.engine.task.spec.actuation.torque_limit[0], 0.8 * 375 / 1200)


def test_the_single_environment_draws_what_its_row_of_a_batch_does_and_sees_the_same() -> None:
    twin = {"twin": write(table())}
    batch = HandVectorEnv("Reach", 4, threads=1, randomise=twin)
    alone = HandEnv("Reach", randomise=twin)
    whole, report = batch.reset(seed=5)
    seen, one = alone.reset(seed=8)
    for name, value in one["randomised"]["twin"].items():
        np.testing.assert_array_equal(value, report["randomised"]["twin"][name][3])
    action = np.linspace(-1, 1, 16, dtype=np.float32)
    for _ in range(5):
        np.testing.assert_array_equal(joints_seen(seen), joints_seen(whole)[3])
        seen, *_ = alone.step(action)
        whole, *_ = batch.step(np.tile(action, (4, 1)))
    again = alone.reset(seed=8)[1]["randomised"]["twin"]
    np.testing.assert_array_equal(again["strength"], one["randomised"]["twin"]["strength"])
    assert np.isfinite(joints_seen(seen)).all()


def test_the_other_draws_of_a_seed_are_those_without_a_twin() -> None:
    ranges = {"mass": (0.5, 2.0), "friction": (0.4, 1.0)}
    kwargs: dict[str, Any] = {"objects": ("lemon", "apple"), "level": "easy"}
    env = made(table(), 2, "Lift", randomise=ranges, **kwargs)
    plain = HandVectorEnv("Lift", 2, threads=1, randomise=ranges, autoreset_mode="disabled", **kwargs)
    with_twin, without = (each.reset(seed=3)[1] for each in (env, plain))
    for name in ranges:
        np.testing.assert_array_equal(with_twin["randomised"][name], without["randomised"][name])
    np.testing.assert_array_equal(with_twin["object"], without["object"])
    things = [each.engine.task.object_body for each in (env, plain)]
    assert things[0] is not None
    assert things[1] is not None
    np.testing.assert_array_equal(things[0].pose, things[1].pose)
    assert "twin" not in without["randomised"]
    for _ in range(3):
        observation, *_ = env.step(np.zeros((2, 16), np.float32))
    assert np.isfinite(observation).all()  # type: ignore[arg-type]


def open_loop(content: dict[str, Any], periods: int = 60) -> tuple[Array, Array]:
    """Reported positions under the same torques, in an environment and in the simulated hand of the file,
    (periods, 16) each, rad."""
    env = made(content, 1)
    env.reset(seed=0)
    engine = env.engine
    spec = load_spec(serial=str(engine.settings.randomise.twin))
    stage = Stage(np.zeros(3), quaternion_facing((1, 0, 0), (0, 0, 1)))
    hand = SimBackend(spec, compile_task_scene(spec, stage, engine.settings), posture=engine.worlds.position[0].copy())
    hand.reset()
    seen: list[tuple[Array, Array]] = []
    for tick in range(periods):
        torque = 0.5 * spec.actuation.torque_limit * np.sin(0.15 * tick + np.arange(16))
        engine.step_period(torque[None], np.array([tick]), tick % 13)
        hand.write(TorqueCommand(torque))
        position, _ = engine.measure(np.array([tick + 1]))
        seen.append((position[0].copy(), hand.read().position))
    one, other = (np.array(each) for each in zip(*seen, strict=True))
    return one, other


def test_a_hand_that_is_known_exactly_moves_as_its_own_simulation_does() -> None:
    drive = {"load_friction": 0.0, "bias_torque": 0.003, "delay": 0.006, "strength": 0.9, "encoder_offset": 0.01,
             "mass_scale": 1.2, "tip_mass": [0.0, 0.0, 0.0, 0.01] * 4, "tilt": [0.02, -0.03, 0.01],
             "quantisation": 1e-4}  # fmt: skip
    ours, own = open_loop(known(**drive))
    assert np.ptp(own, axis=0).max() > 0.05
    np.testing.assert_allclose(ours, own, atol=1e-9)


def test_part_of_a_period_of_delay_and_what_changes_within_one_are_nearly_as_in_its_own_simulation() -> None:
    drive = {"delay": 0.004, "load_friction": 0.1, "uneven_damping": 0.01, "cogging_sine": 0.005, "cogging_periods": 20,
             "stiffness": 0.02, "ripple_sine": 0.1, "ripple_periods": 9}  # fmt: skip
    ours, own = open_loop(known(**drive))
    assert 1e-6 < np.abs(ours - own).max() < 0.002  # 0.8 mrad of 70.
    for without in (
        {"load_friction": 0.0}, {"uneven_damping": 0.0}, {"cogging_sine": 0.0}, {"delay": 0.006}, {"stiffness": 0.0},
        {"ripple_sine": 0.0},
    ):  # fmt: skip
        other, _ = open_loop(known(**(drive | without)))
        assert np.abs(other - ours).max() > 0.001, without


def test_no_command_of_the_episode_before_is_on_its_way() -> None:
    env = made(known(delay=0.006, load_friction=0.0), 1)
    limit, engine = env.engine.task.spec.actuation.torque_limit, env.engine
    for _ in range(2):
        env.reset(seed=0)
        for tick in range(5):
            engine.step_period(0.5 * limit[None], np.array([tick]), tick)
            np.testing.assert_array_equal(engine.worlds.control[0], (tick >= 2) * 0.5 * limit)


def test_a_hand_begins_an_episode_anywhere_between_cold_and_warm() -> None:
    env = made(known(cold_friction=0.3, warm_up=20.0), 200)
    drawn = env.reset(seed=0)[1]["randomised"]["twin"]
    assert drawn["warmth"].min() < 0.05
    assert drawn["warmth"].max() > 0.95
    dof = env.engine.worlds.model.joint(load_spec().joints[0]).dofadr[0]
    rows = env.engine.worlds.expand("dof_damping")[:, dof]
    np.testing.assert_allclose(rows, drawn["damping"][:, 0] * (1.0 + 0.3 * drawn["warmth"]), rtol=1e-12)


def test_reported_positions_have_the_hand_s_own_noise() -> None:
    env = made(known() | {"identified": {"interval": known()["identified"]["interval"], "noise": [2e-4] * 16}}, 1)
    env.reset(seed=0)
    true, engine = env.engine.worlds.position, env.engine
    errors = np.array([engine.measure(np.array([tick]))[0] - true for tick in range(400)])
    np.testing.assert_allclose(errors.std(), 2e-4, rtol=0.05)
    assert np.abs(errors).max() <= 2e-4 * np.sqrt(3.0) * (1 + 1e-9)


def test_what_environments_do_not_represent_is_said_in_one_line(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        made(table(backlash=0.004, bristle=0.002, stiction=1.2), 1)
    (line,) = caplog.messages
    assert "drive.stiction, drive.bristle, drive.backlash" in line
    caplog.clear()
    made(table(), 1)
    assert not caplog.messages


def of_other_joint_count() -> dict[str, Any]:
    content = table()
    content["actuation"]["damping"] = [0.07] * 12
    return content


def with_short_interval() -> dict[str, Any]:
    content = table()
    content["identified"]["interval"]["offset"] = [0.01] * 12
    return content


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({key: value for key, value in table().items() if key != "identified"}, "no `identified` block"),
        (of_other_joint_count(), "randomise.twin: no allegro hand: .*actuation.damping needs one number or 16"),
        (with_short_interval(), "identified.interval.offset needs 16 numbers"),
        (table() | {"wire": {"side": "left"}}, "is of a left hand.*side='left'"),
        (table() | {"driven": [], "wire": {}}, "not the file of one allegro hand"),
        (table() | {"identified": {"interval": [1.0]}}, "identified.interval must hold keys and values"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_in_one_line(content: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said) as error:
        made(content, 1)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ({"intervals": {}}, "identified: no key named 'intervals'; did you mean 'interval'"),
        (
            {"interval": {"armture": [1e-4] * 16}},
            "identified.interval: no value named 'armture'; did you mean 'armature'",
        ),
        (
            {"not_determined": {"armatur": {}}},
            "identified.not_determined: no value named 'armatur'; did you mean 'armature'",
        ),
        (
            {"not_determined": {"armature": {"index9": "x"}}},
            "not_determined.armature: no joint named 'index9'; did you mean",
        ),
        ({"not_determined": {"armature": ["index_3"]}}, "identified.not_determined.armature must hold keys and values"),
        ({"written": {"index_7": "nominal"}}, "identified.written: no joint named 'index_7'; did you mean"),
        ({"written": {"index_1": "nominall"}}, "identified.written: no word named 'nominall'; did you mean 'nominal'"),
        (
            {"correlation": {"of": ["dampin"]}},
            "identified.correlation.of: no value named 'dampin'; did you mean 'damping'",
        ),
        ({"interval": {"armature": True}}, "identified.interval.armature needs 16 numbers"),
        (
            {"interval": {"armature": 1e9}},
            "identified.interval.armature has half-widths of up to 1e[+]09, more than 10 times",
        ),
    ],
)
def test_what_is_mistyped_in_what_was_identified_is_refused_with_the_nearest_name(block: Any, said: str) -> None:
    content = table()
    content["identified"] |= block
    with pytest.raises(ConfigError, match=said) as error:
        made(content, 1)
    assert "\n" not in str(error.value)


def test_older_files_that_say_in_a_sentence_what_was_written_load() -> None:
    content = table()
    content["identified"] |= {"written": "what is not determined as it was", "date": "2026-11-20", "kept_back": {}}
    made(content, 1)


def test_a_hand_without_torque_commands_and_a_file_that_is_none_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"environment's hand is leap: leave out randomise\.twin"):
        HandEnv("Reach", hand="leap", randomise={"twin": write(table())})
    with pytest.raises(ConfigError, match="no such hand file"):
        HandEnv("Reach", randomise={"twin": "nowhere/my_hand.yaml"})
    with pytest.raises(ConfigError, match="not the file of one"):
        HandEnv("Reach", randomise={"twin": str(data_root() / "conf" / "hands" / "leap.yaml")})


def test_a_typo_and_a_range_that_the_twin_gives_are_refused() -> None:
    with pytest.raises(ConfigError, match="twin"):
        read_settings({"randomise": {"twn": "my_hand.yaml"}})
    with pytest.raises(ConfigError, match="armature, sensor_delay comes from the twin: leave it out"):
        read_settings({"randomise": {"twin": "my_hand.yaml", "armature": (0.001, 0.002), "sensor_delay": (0, 1)}})


def test_nothing_of_a_twin_is_there_without_the_key() -> None:
    observations = []
    for env in (HandVectorEnv("Reach", 2, threads=1), HandVectorEnv("Reach", 2, threads=1, randomise={"twin": None})):
        assert "twin" not in env.reset(seed=1)[1]["randomised"]
        assert "actuator_gainprm" not in env.engine.worlds._rows
        assert env.engine._sensing.ideal
        observations.append(joints_seen(env.step(np.full((2, 16), 0.5, np.float32))[0]))
    np.testing.assert_array_equal(observations[0], observations[1])


def test_an_evaluation_of_a_training_with_a_twin_is_of_that_hand() -> None:
    path = write(table())
    settings = EnvSettings(randomise={"twin": path, "friction": (0.4, 1.0)}, timestep=0.003)  # type: ignore[arg-type]
    assert as_shipped(settings) == EnvSettings(randomise={"twin": path})  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_training_in_a_folder_whose_twin_has_changed_is_another_one() -> None:
    path = write(table())
    settings = EnvSettings(randomise={"twin": path})  # type: ignore[arg-type]
    recipe = load_recipe("Reach").model_copy(update={"environment": settings})
    first = input_fingerprints(recipe)
    content = table()
    content["identified"]["interval"]["offset"][0] = 0.02
    Path(path).write_text(yaml.safe_dump(content))
    second = input_fingerprints(recipe)
    assert {name for name in first if first[name] != second[name]} == {"twin"}


def test_environments_for_learners_go_on_from_a_snapshot_as_if_nothing_had_happened() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'allegro-twin[rsl]'")
    first, second = (
        TensorVectorEnv("Reach", 16, seed=seed, randomise={"twin": write(table())}, timestep=0.003) for seed in (0, 1)
    )
    action = torch.full((16, 16), 0.5)
    for env in (first, second):
        env.reset()
        env.step(action)
    assert second.load(first.state_dict())
    for _ in range(3):
        one, other = (env.step(action)[0]["observation"] for env in (first, second))
        assert torch.equal(one, other)


def test_a_reset_of_the_same_seed_draws_the_same_drive() -> None:
    env = made(table())
    one, two = (env.reset(seed=4)[1]["randomised"]["twin"] for _ in range(2))
    for name, value in one.items():
        np.testing.assert_array_equal(value, two[name])
    assert not np.array_equal(one["strength"], env.reset()[1]["randomised"]["twin"]["strength"])
