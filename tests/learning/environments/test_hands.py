"""Environments of hands that close their own loop: as many actions as motors, and what such a hand senses, no more."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import allegro_twin.gym  # noqa: F401  # Registers the ids.
from allegro_twin.control.controllers import PositionControl
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_posture
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.episode import EpisodeBackend
from allegro_twin.learning.environments.settings import EnvSettings, read_settings
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.policy.card import PolicyCard
from allegro_twin.learning.policy.controller import PolicyController
from allegro_twin.learning.policy.interface import Observation
from allegro_twin.learning.policy.script import closing_moves
from allegro_twin.learning.tasks import start_states
from allegro_twin.learning.tasks.scripted_closing import ScriptedClosingTask
from allegro_twin.loop import run, until
from allegro_twin.sim.engine.backend import SimBackend
from tests.learning.environments.test_batch import rows_of, same

MOTORS = {"leap": 16, "model_o": 4, "sih": 5, "qb_softhand": 1}
HANDS = list(MOTORS)
ON_TENDONS = ["model_o", "sih", "qb_softhand"]
TASKS = ("Reach", "Grasp", "Lift", "HoldDisturbed")
KEPT = {"leap": "mug", "model_o": "apple", "sih": "lemon", "qb_softhand": "mug"}
"""Objects that the hands keep when nothing pushes."""
EACH = [
    pytest.param(
        task, hand, marks=[] if hand == "model_o" else [pytest.mark.slow if task == "Grasp" else pytest.mark.long]
    )
    for task in TASKS
    for hand in HANDS
]
BARE = {"leap": 4 * 16, "model_o": 4 * 4, "sih": 4 * 5, "qb_softhand": 4}


def given(task: str, hand: str, **more: Any) -> dict[str, Any]:
    """One object, so that a test compiles no others."""
    objects = {} if task == "Reach" else {"objects": (KEPT[hand],)}
    return {"hand": hand, **objects, **more}


def test_the_hands_have_what_their_makers_say() -> None:
    for hand, motors in MOTORS.items():
        assert load_spec(hand).n_actuators == motors


@pytest.mark.parametrize(("task", "hand"), EACH)
def test_every_task_of_every_hand_passes_the_checkers_without_a_warning(task: str, hand: str) -> None:
    with gymnasium.make(f"AllegroTwin/{task}-v0", render_mode="rgb_array", **given(task, hand)) as env:
        check_env(env.unwrapped, skip_render_check=task != "Grasp")
        assert env.action_space.shape == (MOTORS[hand],)
        seen = env.observation_space
        shape = (seen["observation"] if isinstance(seen, gymnasium.spaces.Dict) else seen).shape
        assert shape == (BARE[hand] + (task != "Reach"),)


@pytest.mark.parametrize(("task", "hand"), EACH)
def test_stable_baselines3_finds_nothing_wrong_with_them(task: str, hand: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="extra rl")
    checker.check_env(HandEnv(task, **given(task, hand)))


# Without draws one of them before each push, and every task of the Allegro Hand: test_batch.py.
@pytest.mark.parametrize(
    ("task", "hand", "randomise"),
    [pytest.param(*each.values, "default", marks=each.marks) for each in EACH]
    + [
        pytest.param(*each.values, "off", marks=[] if each.values == ("Lift", "model_o") else [pytest.mark.long])
        for each in EACH
    ],
)
def test_a_simulation_in_a_batch_is_the_single_environment_to_the_bit(task: str, hand: str, randomise: str) -> None:
    more = given(task, hand, randomise=randomise, touch=True, state=True, history=2)
    batch = HandVectorEnv(task, 3, threads=2, **more)
    single = HandEnv(task, **more)
    seen, _ = batch.reset(seed=7)
    same(rows_of(seen, 2), single.reset(seed=9)[0])
    actions = np.random.default_rng(3).uniform(-0.5, 0.5, (30, 3, MOTORS[hand])).astype(np.float32)
    for action in actions:
        seen, rewards, ended, _, _ = batch.step(action)
        own, reward, its_end, _, _ = single.step(action[2])
        same(rows_of(seen, 2), own)
        assert (rewards[2], ended[2]) == (reward, its_end)
        if its_end:
            return


@pytest.mark.parametrize("hand", HANDS)
def test_doing_nothing_is_the_scripted_player(hand: str) -> None:
    """The set-points of every period are those that the library's grasp has on a hand's own loop."""
    env = HandEnv("Lift", **given("Lift", hand))
    env.reset(seed=0)
    task = env.engine.task
    assert isinstance(task, ScriptedClosingTask)
    scene = task.scenes[0]
    path = PositionControl(closing_moves(scene.grasp, task.wait, task.squeeze)).reference.begin(scene.grasp.preshape)
    told: list[Any] = []
    task.worlds.command = lambda values: told.append(np.array(values[0]))  # type: ignore[method-assign]  # To listen.
    for _ in range(60):
        env.step(np.zeros(MOTORS[hand], np.float32))
    wanted = [path(k * env.engine.settings.period).position for k in range(len(told))]
    np.testing.assert_array_equal(told, np.clip(wanted, task.spec.lower, task.spec.upper))
    assert np.ptp(told, axis=0).max() > 0.2, "the script stood still"


@pytest.mark.parametrize("hand", HANDS)
def test_a_policy_on_a_backend_sees_what_it_saw_in_training(hand: str) -> None:
    env, m = HandEnv("Reach", hand=hand), MOTORS[hand]
    first, _ = env.reset(seed=2)
    assert isinstance(first, dict)
    snapshot = env.engine.worlds.snapshot(0)
    backend = SimBackend(snapshot.spec, snapshot.model, posture=load_posture("home", snapshot.spec))
    seen: list[Any] = []

    def swinging(observation: Observation) -> Any:
        assert isinstance(observation, dict)
        seen.append(observation)
        return np.tanh(np.float32(0.3) - np.float32(1.2) * observation["observation"][:m])

    episode = [first]
    for _ in range(30):
        episode.append(env.step(swinging(episode[-1]))[0])  # type: ignore[arg-type]  # A dictionary, as above.
    assert np.ptp([each["observation"][:m] for each in episode], axis=0).max() > 0.1, "the hand stood still"
    seen.clear()
    controller = PolicyController(swinging, env.engine.task.interface, first["desired_goal"].astype(np.float64))
    for _ in until(30 * env.engine.task.interface.seconds, run(backend, controller)):
        pass
    assert len(seen) == 31
    for ours, its in zip(episode, seen, strict=True):
        same(ours, its)


@pytest.mark.parametrize("hand", ["leap", "model_o"])
def test_an_episode_as_a_backend_is_the_one_of_the_environment(hand: str) -> None:
    more = given("Grasp", hand)
    env, episode = HandEnv("Grasp", **more), EpisodeBackend("Grasp", EnvSettings(**more), seed=5)
    seen = [env.reset(seed=5)[0]]
    rows: list[Any] = []

    def leaning(observation: Observation) -> Any:
        rows.append(observation)
        return np.full(MOTORS[hand], 0.3, np.float32)

    for _ in range(20):
        seen.append(env.step(np.full(MOTORS[hand], 0.3, np.float32))[0])
    controller = PolicyController(leaning, episode.engine.task.interface, episode.goal, episode.script)
    for _ in until(20 * env.engine.task.interface.seconds, run(episode, controller)):
        pass
    np.testing.assert_array_equal(rows, seen)


@pytest.mark.parametrize("hand", HANDS)
def test_torque_is_refused_by_a_hand_that_takes_none_with_what_it_takes(hand: str) -> None:
    with pytest.raises(ConfigError, match=f"{hand}_right closes its own loop.*control is delta or absolute"):
        HandEnv("Grasp", control="torque", **given("Grasp", hand))
    HandEnv("Grasp", control="absolute", **given("Grasp", hand))


@pytest.mark.parametrize(
    ("task", "missing"),
    [
        ("Rotate", "no grasp of the fingertips of model_o was found that holds cube above the palm"),
        ("Reorient", "no grasp of the fingertips of model_o was found that holds cube above the palm"),
        ("Pinch", "no pinches of small balls with model_o"),
    ],
)
def test_tasks_that_need_what_a_hand_has_not_name_it_in_one_line(
    task: str, missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(start_states, "AT_ONCE", 2)
    monkeypatch.setattr(start_states, "survives_noise", lambda *_: np.zeros(1, bool))
    monkeypatch.setattr(start_states, "OPPOSED_MOST", 1)
    with pytest.raises(ConfigError, match=missing) as error:
        HandEnv(task, hand="model_o")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"hand": "model_oo"}, "model_o"),
        ({"side": "left"}, "is a right hand"),
        ({"objects": ("chips_can",)}, "no object named 'chips_can'"),
        (
            {"objects": (str(data_root() / "scenarios/demo/apple.yaml"),)},
            "for the hand allegro, and this one is model_o",
        ),
        ({"randomise": {"armature": (0.001, 0.005)}}, "randomise.armature is of joints that a motor turns each"),
        ({"randomise": {"frictionloss": (0.01, 0.03)}}, "randomise.frictionloss is of joints"),
        ({"gains": "soft"}, "closes its own loop: leave out the gains 'soft'"),
        ({"device": "warp:cpu"}, "closes its own loop, which is simulated on cpu only"),
    ],
)
def test_what_does_not_fit_a_hand_is_refused_in_one_line(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        HandEnv("Grasp", **({"hand": "model_o", "objects": ("apple",)} | kwargs))
    assert "\n" not in str(error.value)


def test_an_id_that_says_left_refuses_a_hand_that_is_right_only() -> None:
    with pytest.raises(ConfigError, match="is a right hand; hand.side is left"):
        gymnasium.make("AllegroTwin/GraspLeft-v0", hand="sih")


def test_who_presents_lets_go_and_fingers_that_are_coupled_stay_so() -> None:
    env = HandEnv("Grasp", **given("Grasp", "model_o"))
    env.reset(seed=0)
    names = [env.engine.worlds.model.equality(k).name for k in range(env.engine.worlds.model.neq)]
    held = names.index("presenter")
    assert len(names) > 1, "no fingers of this hand are coupled"
    assert env.engine.worlds.snapshot(0).data.eq_active.all()
    for _ in range(75):
        env.step(np.zeros(4, np.float32))
    active = env.engine.worlds.snapshot(0).data.eq_active
    assert not active[held]
    assert active.sum() == len(names) - 1


@pytest.mark.parametrize(("hand", "side"), [*((hand, "right") for hand in HANDS), ("leap", "left")])
def test_the_script_holds_what_is_where_it_should_be(hand: str, side: str) -> None:
    env = HandEnv("Grasp", side=side, position_noise=0.0, **given("Grasp", hand, level="easy"))
    env.reset(seed=0)
    for _ in range(env.engine.limit):
        _, _, failed, _, info = env.step(np.zeros(MOTORS[hand], np.float32))
        assert not failed
    assert info["is_success"]


def test_by_default_only_that_is_randomised_what_a_hand_has() -> None:
    ours, direct = (read_settings({"hand": hand, "randomise": "default"}).randomise for hand in ("model_o", "leap"))
    own = read_settings({"randomise": "default"}).randomise
    assert own.quantisation is not None
    assert own.armature is not None
    assert direct.quantisation is None
    assert direct.armature == own.armature
    assert ours.armature is ours.frictionloss is ours.quantisation is None
    assert ours.gains == own.gains
    assert ours.strength == own.strength


@pytest.mark.parametrize("hand", HANDS)
def test_gains_and_strength_are_those_of_the_hands_own_loop(hand: str) -> None:
    ranges = {"gains": (1.5, 1.5), "strength": (0.5, 0.5), "damping": (2.0, 2.0)}
    env = HandEnv("Grasp", randomise=ranges, **given("Grasp", hand))
    env.reset(seed=0)
    worlds, model = env.engine.worlds, env.engine.worlds.model
    ids, dofs = worlds.motors, worlds.dofs
    np.testing.assert_allclose(worlds.expand("actuator_gainprm")[0, ids, 0], 1.5 * model.actuator_gainprm[ids, 0])
    np.testing.assert_allclose(worlds.expand("actuator_biasprm")[0, ids, :3], 1.5 * model.actuator_biasprm[ids, :3])
    np.testing.assert_allclose(worlds.expand("actuator_forcerange")[0, ids], 0.5 * model.actuator_forcerange[ids])
    np.testing.assert_allclose(worlds.expand("dof_damping")[0, dofs], 2.0 * model.dof_damping[dofs])
    assert model.dof_damping[dofs].all()


def test_a_weaker_loop_closes_less_far() -> None:
    def closed(strength: float) -> float:
        env = HandEnv("Grasp", hand="model_o", objects=("apple",), randomise={"strength": (strength, strength)})
        env.reset(seed=0)
        for _ in range(55):
            env.step(np.zeros(4, np.float32))
        return float(env.engine.worlds.position[0, 1])

    assert closed(0.01) < closed(1.0) - 0.1


@pytest.mark.parametrize("hand", ON_TENDONS)
def test_a_motor_feels_along_the_free_way_what_touches_its_fingers(hand: str) -> None:
    env = HandEnv("Grasp", touch=True, **given("Grasp", hand, level="easy"))
    seen, _ = env.reset(seed=0)
    m = MOTORS[hand]
    assert not np.asarray(seen)[-m:].any()
    felt = [np.asarray(env.step(np.zeros(m, np.float32))[0])[-m:] for _ in range(80)]
    friction = 0.2  # The Model O's two hinges that spread fingers have a sixth of what that motor gives.
    assert np.abs(felt[10]).max() < friction, "something is felt while nothing touches"
    assert min(row.min() for row in felt[40:]) < -friction, "the object was not felt"


@pytest.mark.parametrize("hand", ON_TENDONS)
def test_the_speed_of_what_follows_is_the_slope_of_where_it_is(hand: str) -> None:
    spec, step = load_spec(hand), 1e-6
    q = np.random.default_rng(0).uniform(spec.lower + 1e-3, spec.upper - 1e-3, (50, spec.n_joints))
    slope = (spec.coupled_positions(q + step) - spec.coupled_positions(q - step)) / (2 * step)
    np.testing.assert_allclose(spec.coupled_rates(q), slope, rtol=1e-5, atol=1e-5)


def test_a_radian_of_a_tendon_is_a_part_of_its_motors_range() -> None:
    env = HandEnv("Grasp", control="absolute", hand="model_o", objects=("apple",))
    spec = env.engine.task.spec
    np.testing.assert_allclose(env.engine.task.interface.span, 0.3 * (spec.upper - spec.lower) / (np.pi / 2))
    np.testing.assert_array_equal(HandEnv("Grasp", **given("Grasp", "leap")).engine.task.interface.span, 0.3)


def test_an_object_that_a_hand_does_not_keep_is_not_disturbed() -> None:
    with pytest.raises(ConfigError, match="does not keep|keeps none of pudding_box"):
        HandEnv("HoldDisturbed", hand="qb_softhand", objects=("pudding_box",)).reset(seed=0)


@pytest.mark.long
def test_by_default_those_are_disturbed_that_a_hand_keeps() -> None:
    env = HandVectorEnv("HoldDisturbed", 40, hand="leap", autoreset_mode="disabled")
    _, info = env.reset(seed=0)
    assert {"lemon", "mug"} <= {*info["object"]}
    assert "golf_ball" not in info["object"]


def test_a_slow_hand_has_longer_episodes() -> None:
    slow = HandEnv("Grasp", hand="qb_softhand", objects=("apple",)).engine
    assert slow.task.seconds == pytest.approx(5.1)
    assert HandEnv("Grasp", objects=("apple",)).engine.task.seconds == 4.3


def test_a_card_of_ones_own_is_a_hand_too(tmp_path: Path) -> None:
    path = data_root() / "conf" / "hands" / "model_o.yaml"
    env = HandEnv("Grasp", hand=str(path), objects=("apple",))
    assert env.reset(seed=0)[0].shape == (17,)  # type: ignore[union-attr]  # An array.
    named = tmp_path / "gripper.yaml"
    named.write_text(path.read_text().replace("../../models", str(data_root() / "models")))
    with pytest.raises(
        ConfigError, match=r"no scenarios of gripper: give objects=.*a recipe with `environment: \{objects: "
    ):
        HandEnv("Grasp", hand=str(named))
    HandEnv("Reach", hand=str(named)).reset(seed=0)


def test_a_policy_for_another_hand_is_refused_in_one_line() -> None:
    card = HandEnv("Grasp", **given("Grasp", "leap")).engine.task.card()
    assert card.hand == "leap"
    with pytest.raises(ConfigError, match="for a hand of the model leap; this one is allegro"):
        card.interface(load_spec())
    assert card.interface(load_spec("leap")).n_observation == 65


def test_a_card_without_a_hand_is_of_the_hand_that_cards_were_of_before_they_said_it() -> None:
    card = HandEnv("Reach").engine.task.card()
    old = PolicyCard.model_validate(card.model_dump(exclude={"hand"}))
    assert old == card
