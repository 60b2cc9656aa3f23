"""What is wrong is said in one line, with the nearest right name."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from pydantic import ValidationError

import allegro_twin.gym  # noqa: F401  # Registers the ids.
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.mpc.settings import MpcSettings
from allegro_twin.pick.env import ArmPick

LEMON: dict[str, Any] = {"objects": ("lemon",)}


@pytest.mark.parametrize(
    ("task", "kwargs", "message"),
    [
        ("Lfit", {}, "no task named 'Lfit'; did you mean 'Lift'?"),
        ("Lift", {"objekts": ("lemon",)}, "environment: objekts: unknown key; did you mean 'objects'?"),
        ("Lift", {"objects": ("lemmon",)}, "no object named 'lemmon'; did you mean 'lemon'"),
        ("Lift", {"objects": ("mug",)}, "mug is grasped from its side; the slide serves apple"),
        ("Lift", {"side": "lefft"}, "side: input should be 'right' or 'left', not 'lefft'"),
        ("Lift", {"randomise": "defualt"}, "no randomisation named 'defualt'; did you mean 'default'"),
        ("Lift", {"randomise": {"mas": (1, 2)}}, "randomise.mas: unknown key; did you mean 'mass'"),
        ("Lift", {"randomise": {"mass": (2.0, 1.0)}}, "the smallest comes first"),
        ("Lift", {"period": 0.0025}, "period 0.0025 s is not a whole number of physics steps of 0.001 s"),
        ("Reach", {"objects": ("lemon",)}, "Reach has no objects to choose"),
        ("Lift", {"objects": ()}, "objects: tuple should have at least 1 item"),
        ("Lift", {"randomise": {"mass": (300.0, 300.0)}}, "mass: .*at most 10 times its mass"),
        ("Lift", {"randomise": {"friction": (5.0, 5.0)}}, "friction: .*more than 0, and at most 1"),
        ("Lift", {"randomise": {"mass": (0.0, 0.0)}}, "both must be greater than 0: a factor"),
        ("Lift", {"randomise": {"sensor_delay": (0, 9)}}, "at most 4"),
        ("Grasp", {"decimation": 2000}, r"2000 periods of 0\.003 s takes 6 s, and an episode of Grasp 4\.3 s"),
        ("Grasp", {"period": 0.05}, r"actions of 0\.65 s \(decimation 13\) are too long"),
        ("Lift", {"goals": "yaw"}, "Lift has no goals to choose"),
        ("Reach", {"level": "easy"}, "Reach has no level to choose"),
        ("Reach", {"position_noise": 0.01}, "Reach has no position_noise to choose"),
        ("Rotate", {"position_noise": 0.01}, "Rotate has no position_noise to choose"),
        ("Reorient", {"position_noise": 0.02}, "Reorient has no position_noise to choose"),
        ("HoldDisturbed", {"position_noise": 0.01}, "HoldDisturbed has no position_noise to choose"),
        ("Reach", {"reach": 0.2}, "Reach has no reach to choose"),
        ("Rotate", {"reach": 0.1}, "Rotate has no reach to choose"),
        ("Reach", {"width": 0}, "width is a whole number of pixels from 1 to 8192, not 0"),
        ("Reach", {"height": 3.5}, "height is a whole number of pixels from 1 to 8192, not 3.5"),
        ("Reach", {"policy": 3}, "policy is the path of a policy's file, or the name of one that ships, not 3"),
        ("Reach", {"policy": ""}, "policy is the path of a policy's file, or the name of one that ships, not ''"),
        ("Reach", {"observe": ("rgb",), "cameras": ("tpo",)}, "^camera tpo: auto, front, side, top, palm, or AZIMUTH"),
        ("Reach", {"decimation": True}, "decimation: input should be a number, not True"),
        ("Reach", {"randomise": {"mass": (0.5, 1.0)}}, "randomise.mass is of an object, and Reach has none: leave it"),
        ("Reach", {"render_mode": "rgb"}, "render_mode 'rgb' is none of rgb_array"),
    ],
)
def test_a_wrong_keyword_is_named(task: str, kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message.replace("?", r"\?")):
        HandEnv(task, **kwargs)


@pytest.mark.parametrize("threads", [-1, 1.5, "2", True])
def test_a_number_of_threads_that_is_none_is_refused(threads: Any) -> None:
    with pytest.raises(ConfigError, match=f"threads is a whole number, 0 for one per processor, not {threads!r}"):
        HandVectorEnv("Reach", 2, threads=threads)


@pytest.mark.parametrize("picture", ["rgb", "depth"])
def test_a_closed_environment_with_pictures_says_that_it_is_closed(picture: str) -> None:
    one, many = HandEnv("Reach", observe=(picture,)), HandVectorEnv("Reach", 1, observe=(picture,))
    for env, action in ((one, np.zeros(16, np.float32)), (many, np.zeros((1, 16), np.float32))):
        env.reset(seed=0)
        env.close()
        with pytest.raises(CommandError, match="the environment is closed, and takes no more pictures: make a new"):
            env.step(action)


def test_the_pick_says_where_a_vector_of_it_takes_its_autoreset_mode() -> None:
    with pytest.raises(ConfigError, match="gymnasium.make_vec takes its autoreset_mode in vector_kwargs"):
        ArmPick(autoreset_mode="same_step")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"objekt": "lemon"}, "no option named 'objekt'; did you mean 'object'"),
        ({"object": "lemmon"}, "no object named 'lemmon'; did you mean 'lemon'"),
        ({"grasp": "quadpot"}, "no grasp named 'quadpot'; did you mean 'quadpod'"),
        ({"posture": "hom"}, "no posture named 'hom'; did you mean 'home'"),
        ({"size": -1.0}, "size: input should be greater than 0"),
        ({"size": 2.5}, r"lemon at 2\.5 times its size is too large for tripod_lemon: it would begin \d+ mm inside"),
        ({"friction": 3.0}, "friction: input should be less than or equal to 1"),
    ],
)
def test_a_wrong_option_is_named(options: dict[str, Any], message: str) -> None:
    env = HandEnv("Lift", **LEMON)
    with pytest.raises(ConfigError, match=message):
        env.reset(seed=0, options=options)


def test_an_option_that_a_task_has_no_use_for_is_refused() -> None:
    with pytest.raises(ConfigError, match="Reach has no object to choose; its options: posture"):
        HandEnv("Reach").reset(options={"object": "lemon"})


def test_an_action_with_a_nan_is_refused_with_its_joint_and_its_step() -> None:
    env = HandEnv("Reach")
    env.reset(seed=0)
    env.step(np.zeros(16, np.float32))
    action = np.zeros(16, np.float32)
    action[3] = np.nan
    with pytest.raises(CommandError, match=r"the action for joint_3\.0 at step 1 is nan; every value must be finite"):
        env.step(action)


@pytest.mark.parametrize("size", [1e308, -1e308])
def test_an_action_of_any_size_is_clipped(size: float) -> None:
    env, other = HandEnv("Reach"), HandEnv("Reach")
    for each in (env, other):
        each.reset(seed=0)
    huge = np.full(16, size)
    seen, same = env.step(huge)[0], other.step(np.sign(huge))[0]
    assert isinstance(seen, dict)
    assert isinstance(same, dict)
    np.testing.assert_array_equal(seen["observation"], same["observation"])


def test_an_action_of_words_is_refused() -> None:
    env = HandEnv("Reach")
    env.reset(seed=0)
    with pytest.raises(CommandError, match="actions are numbers, not"):
        env.step(np.full(16, "left"))


@pytest.mark.parametrize("options", ["lemon", [1], 3])
def test_options_are_a_mapping(options: Any) -> None:
    with pytest.raises(ConfigError, match="options are a mapping such as {'object': …}, not"):
        HandEnv("Lift", **LEMON).reset(options=options)


@pytest.mark.parametrize(
    ("keyword", "message"),
    [
        (
            {"threads": 2},
            r"threads 2 is no keyword of an environment: it is of many simulations, gymnasium.make_vec or H",
        ),
        (
            {"autoreset_mode": "disabled"},
            "autoreset_mode 'disabled' is no keyword of an environment: it is of many simu",
        ),
        ({"seed": 1}, r"seed 1 is no keyword of an environment: it goes to reset\(seed=…\)"),
    ],
)
def test_a_keyword_that_belongs_elsewhere_says_where(keyword: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        gymnasium.make("AllegroTwin/Rotate-v0", **keyword)


def test_a_tilt_of_the_palm_that_loses_the_object_by_itself_is_refused() -> None:
    for tilt in ((0.0, 1.0), (0.62, 0.62)):
        with pytest.raises(
            ConfigError, match=r"wrist_tilt up to .* rad about each axis leans the palm .*: at most 0.61 r"
        ):
            HandEnv("Rotate", randomise={"wrist_tilt": tilt}, timestep=0.003)
    with pytest.warns(
        UserWarning, match="up to 49°; Rotate pays nothing while an object leans by 25° or more, which is"
    ):
        HandEnv("Rotate", randomise={"wrist_tilt": (0.0, 0.61)}, timestep=0.003)
    HandEnv("Reach", randomise={"wrist_tilt": (0.0, 1.0)}, timestep=0.003)


def test_a_tilt_of_the_palm_with_which_no_episode_begins_where_anything_is_paid_is_refused() -> None:
    for tilt in ((0.5, 0.5), (0.32, 0.4)):
        with pytest.raises(ConfigError, match=r"pays nothing .* by 25° or more: begin the range at 0.3 rad or less"):
            HandEnv("Rotate", randomise={"wrist_tilt": tilt}, timestep=0.003)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        HandEnv("Rotate", randomise={"wrist_tilt": (0.3, 0.3)}, timestep=0.003)


@pytest.mark.parametrize("steps", [0, -3, 2.5, "a", True])
def test_an_episode_has_a_whole_number_of_steps(steps: Any) -> None:
    with pytest.raises(ConfigError, match="max_episode_steps is a whole number from 1 on, not .*; an episode has 51"):
        HandVectorEnv("Reach", 2, max_episode_steps=steps)


def test_a_batch_takes_a_seed_of_numpy_and_refuses_what_is_none() -> None:
    envs, others = HandVectorEnv("Reach", 2), HandVectorEnv("Reach", 2)
    seen: Any = envs.reset(seed=np.int64(3))[0]  # type: ignore[arg-type]
    same: Any = others.reset(seed=3)[0]
    np.testing.assert_array_equal(seen["observation"], same["observation"])
    with pytest.raises(ConfigError, match=r"seed is a whole number or a list of such, not 1\.5"):
        envs.reset(seed=1.5)  # type: ignore[arg-type]


def test_a_mesh_has_a_batch_of_its_own_and_leaves_this_one_as_it_was() -> None:
    env, other = HandEnv("Rotate", timestep=0.003), HandEnv("Rotate", timestep=0.003)
    for each in (env, other):
        each.reset(seed=0)
    with pytest.raises(ConfigError, match=r"hex_nut are not of one environment .*: make one environment for each"):
        env.reset(options={"object": "hex_nut"})
    seen, same = env.reset(seed=1)[0], other.reset(seed=1)[0]
    np.testing.assert_array_equal(seen, same)


def test_an_action_of_another_length_is_refused_in_the_shape_of_one_action() -> None:
    env = HandEnv("Reach")
    env.reset(seed=0)
    with pytest.raises(CommandError, match=r"^an action must have shape \(16,\), not \(15,\)$"):
        env.step(np.zeros(15, np.float32))


def test_in_a_batch_the_simulation_is_named_too() -> None:
    envs = HandVectorEnv("Reach", 3)
    envs.reset(seed=0)
    actions = np.zeros((3, 16), np.float32)
    actions[2, 0] = np.inf
    with pytest.raises(CommandError, match="the action of simulation 2 for .* at step 0 is inf"):
        envs.step(actions)
    with pytest.raises(CommandError, match=r"actions must have shape \(3, 16\), not \(2, 16\)"):
        envs.step(actions[:2])


@pytest.mark.parametrize("mask", [np.zeros(3, bool), np.ones(2, bool), np.ones(3)])
def test_a_reset_mask_must_name_somebody(mask: np.ndarray[Any, Any]) -> None:
    envs = HandVectorEnv("Reach", 3, autoreset_mode="disabled")
    with pytest.raises(ConfigError, match="reset_mask must be 3 truth values with at least one true"):
        envs.reset(options={"reset_mask": mask})


def test_a_vector_environment_needs_a_mode_and_somebody_in_it() -> None:
    with pytest.raises(ConfigError, match="render_mode 'ansi' is none of rgb_array, depth_array"):
        HandVectorEnv("Reach", 2, render_mode="ansi")
    with pytest.raises(ConfigError, match="autoreset_mode 'never' is none of next_step, same_step, disabled"):
        HandVectorEnv("Reach", 2, autoreset_mode="never")
    with pytest.raises(ConfigError, match="num_envs must be a whole number from 1 on, not 0"):
        HandVectorEnv("Reach", 0)


def test_a_simulation_that_diverges_ends_its_episode_and_no_other() -> None:
    envs = HandVectorEnv("Reach", 2)
    envs.reset(seed=0)
    envs.engine.worlds.velocity[1] = 1e30
    observation, reward, terminated, _, info = envs.step(np.zeros((2, 16), np.float32))
    assert terminated.tolist() == [False, True]
    assert info["diverged"].tolist() == [False, True]
    assert reward[1] == 0.0
    assert observation in envs.observation_space


@pytest.mark.parametrize(
    ("options", "what", "value"),
    [({"object": "apple"}, "object", "apple"), ({"grasp": "tripod"}, "grasp", "tripod")],
)
def test_what_an_option_chooses_is_what_the_episode_has(options: dict[str, Any], what: str, value: str) -> None:
    env = HandEnv("Lift", **LEMON)
    _, info = env.reset(seed=0, options=options)
    assert info[what] == value
    _, info = env.reset(seed=0)
    assert info["object"] == "lemon"
    assert info["grasp"] == "tripod_lemon"


def test_size_and_friction_reach_the_physics_and_are_gone_with_the_next_reset() -> None:
    env = HandEnv("Lift", level="easy", **LEMON)
    env.reset(seed=0)
    thing = env.engine.task.object_body
    assert thing is not None

    def physics() -> tuple[float, float, float, float]:
        model = env.engine.worlds.snapshot(0).model
        geom = thing.geoms.start
        return (float(model.geom_size[geom, 0]), float(model.geom_friction[geom, 0]),
                float(model.body_inertia[thing.id, 0]), float(model.body_invweight0[thing.id, 1]))  # fmt: skip

    before = physics()
    _, info = env.reset(seed=0, options={"size": 1.1, "friction": 0.5})
    assert info["randomised"] == {"size": 1.1, "friction": 0.5}
    changed = physics()
    np.testing.assert_allclose(np.divide(changed, before), [1.1, 0.5 / 0.8, 1.21, 1 / 1.21], rtol=1e-9)
    env.reset(seed=0)
    assert physics() == before


def test_an_id_of_one_side_refuses_the_other() -> None:
    import gymnasium

    with pytest.raises(ConfigError, match="is the left hand's, and side is 'right': take the id without"):
        gymnasium.make("allegro_twin.gym:AllegroTwin/ReachLeft-v0", side="right")
    env = gymnasium.make("AllegroTwin/ReachLeft-v0", side="left")
    assert env.unwrapped.engine.task.spec.side == "left"  # type: ignore[attr-defined]  # Ours.


def test_nobody_steps_before_the_first_reset_of_all() -> None:
    envs = HandVectorEnv("Reach", 3, autoreset_mode="disabled")
    with pytest.raises(CommandError, match=r"a step before the first reset: call reset\(\) first"):
        envs.step(np.zeros((3, 16), np.float32))
    with pytest.raises(ConfigError, match="the first reset is of all 3 simulations, not of 2"):
        envs.reset(seed=0, options={"reset_mask": np.array([True, False, True])})


def test_only_tasks_with_goals_compute_rewards() -> None:
    assert hasattr(HandEnv("Reach"), "compute_reward")
    assert not hasattr(HandEnv("Lift", **LEMON), "compute_reward")


CORNERS = [(x, y, z) for x in (-0.025, 0.025) for y in (-0.025, 0.025) for z in (-0.025, 0.025)]
FACES = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
CUBE = "\n".join([*(f"v {x} {y} {z}" for x, y, z in CORNERS), *(f"f {a} {b} {c} {d}" for a, b, c, d in FACES)])


def test_two_meshes_in_one_batch_are_refused_instead_of_one_standing_for_both(tmp_path: Path) -> None:
    meshes = []
    for name, high in (("low", 0.03), ("high", 0.05)):
        corners = f"v 0 0 {high}\nv 0.02 0.02 0\nv -0.02 0.02 0\nv -0.02 -0.02 0\nv 0.02 -0.02 0\n"
        file = tmp_path / f"{name}.obj"
        file.write_text(corners + "f 1 2 3\nf 1 3 4\nf 1 4 5\nf 1 5 2\nf 2 5 4\nf 2 4 3\n")
        meshes.append({"name": name, "shape": "mesh", "file": file, "like": "golf_ball"})
    refused = "objects low and high are not of one environment .*: make one environment for each mesh"
    for task in ("Grasp", "Lift", "Rotate"):
        with pytest.raises(ConfigError, match=refused):
            HandVectorEnv(task, 2, objects=tuple(meshes))
    HandEnv("Grasp", objects=(meshes[0],))


@pytest.mark.parametrize("task", ["Grasp", "Lift", "Pinch", "HoldDisturbed", "Rotate"])
def test_a_mesh_and_another_object_in_one_environment_are_refused_by_name(task: str, tmp_path: Path) -> None:
    (tmp_path / "die.obj").write_text(CUBE)
    die = {"name": "die", "shape": "mesh", "file": str(tmp_path / "die.obj"), "mass": 0.1, "like": "rubiks_cube"}
    soap = {"name": "soap", "shape": "box", "size": [0.05, 0.05, 0.05], "mass": 0.1, "like": "rubiks_cube"}
    for objects, first, second in (((soap, die), "soap", "die"), ((die, "golf_ball"), "die", "golf_ball")):
        refused = f"objects {first} and {second} are not of one environment .*: make one environment for each mesh"
        with pytest.raises(ConfigError, match=refused):
            HandEnv(task, objects=objects)


def test_more_simulations_than_there_is_memory_for_are_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise ValueError("std::bad_alloc")  # As MuJoCo's Batch says it.

    monkeypatch.setattr("mujoco.batch.Batch", full)
    with pytest.raises(ConfigError, match="100,000,000 simulations side by side have no room in this"):
        HandVectorEnv("Reach", 100_000_000)
    with pytest.raises(ValidationError, match="less than or equal to 100000"):
        MpcSettings(samples=100_000_000)


def test_simulations_that_a_mask_leaves_alone_report_no_object() -> None:
    env = HandVectorEnv("Lift", 2, autoreset_mode="disabled", **LEMON)
    env.reset(seed=0)
    _, info = env.reset(options={"reset_mask": np.array([True, False])})
    assert list(info["object"]) == ["lemon", None]


def test_physics_in_steps_that_a_hand_does_not_bear_is_refused() -> None:
    """At 3 ms the SoftHand's motor shook at 105 rad/s without any action."""
    for task in ("Reach", "HoldDisturbed", "Grasp"):
        with pytest.raises(ConfigError, match="^timestep 0.003 s: qb_softhand_right is simulated truly in steps of at"):
            HandVectorEnv(task, 2, hand="qb_softhand", timestep=0.003)
    env = HandVectorEnv("Reach", 2, hand="qb_softhand", timestep=0.0015, autoreset_mode="disabled")
    env.reset(seed=0)
    for _ in range(env.limit):
        env.step(np.zeros((2, 1), np.float32))
        assert abs(env.engine.worlds.velocity).max() < 10.0
