"""In the fingertips palm and proximal links end an episode, and `info` tells by which links an object was carried."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.learning.environments.env import HandEnv
from allegro_twin.learning.environments.vector import HandVectorEnv
from allegro_twin.learning.tasks import start_states
from allegro_twin.learning.tasks.in_hand import OBJECTS, OF_OTHERS, InHandTask, in_hand_object, palm_clearance
from allegro_twin.learning.tasks.scenes import FACING, palm_height
from allegro_twin.learning.tasks.start_states import (
    CRADLE,
    FINGERTIPS,
    TEST,
    TRAIN,
    OpposedSearch,
    Search,
    StartStates,
    file_name,
    load_start_states,
)
from allegro_twin.learning.training.report import evaluation_sets
from allegro_twin.learning.training.settings import load_recipe
from allegro_twin.types import Array

PALM, ROOT = palm_height(load_spec()), Path(__file__).resolve().parents[3]

N = 24
ALL = (*OBJECTS, "hex_nut")
STILL = np.zeros((N, 16), np.float32)


def batch(task: str = "Rotate", **more: Any) -> HandVectorEnv:
    env = HandVectorEnv(task, N, autoreset_mode="disabled", timestep=0.003, decimation=20, **more)
    env.reset(seed=11)
    return env


@pytest.mark.parametrize(
    ("starts", "side", "grip"),
    [("train", "right", "pinch"), ("test", "right", "pinch"), ("train", "left", "pinch"), ("test", "left", "pinch"),
     ("train", "left", "cradle"), ("test", "right", "cradle")],
)  # fmt: skip
def test_fingertips_alone_hold_every_object_at_the_beginning(starts: str, side: str, grip: str) -> None:
    for objects in (OBJECTS, ("hex_nut",)):
        env = batch(starts=starts, side=side, objects=objects, grip=grip)
        _, report = env.reset(seed=11)
        assert {*report["object"]} == {*objects}
        inside = np.abs(report["randomised"]["size"] - 1.0) <= 0.1
        assert (inside == (starts == "train" or objects == ("hex_nut",))).all()
        failed = np.zeros(N, bool)
        for _ in range(10):
            *_, end, _, info = env.step(STILL)
            failed |= end
        assert failed.sum() <= 1  # The noise of the start shakes a few loose.
        assert (info["by_tips"][~failed] > 0.75).all()
        assert (info["by_palm"][~failed] == 0.0).all()


@pytest.mark.parametrize("search", [FINGERTIPS, CRADLE])
def test_states_of_tests_are_no_states_of_a_training_and_have_other_sizes(search: Search) -> None:
    for name in ALL:
        thing = in_hand_object(name)
        train, test = (load_start_states(thing, "right", search, states) for states in (TRAIN, TEST))
        assert len(train.size) > 0.7 * TRAIN.most, name
        assert len(test.size) > 0.7 * TEST.most, name
        apart = np.abs(train.position[:, None] - test.position[None]).max(axis=-1)
        assert apart.min() > 0.01, name
        if name != "hex_nut":  # A mesh has one size.
            assert 0.9 <= train.size.min() < train.size.max() <= 1.1
            assert ((test.size < 0.9) | (test.size > 1.1)).all()


@pytest.mark.parametrize("hand", ["allegro", "leap"])
def test_every_state_ships(hand: str) -> None:
    spec = load_spec(hand)
    for name in ALL if hand == "allegro" else OF_OTHERS:
        for search, states in itertools.product((FINGERTIPS.of(spec), CRADLE.of(spec)), (TRAIN, TEST)):
            file = data_root() / "conf" / "starts" / file_name(in_hand_object(name), search, states, spec)
            assert file.is_file(), f"{hand}, {name}: python -m benchmarks.starts makes {file.name}"


def over_the_tips(env: HandVectorEnv) -> Array:
    """Height of the object's middle over the mean of the fingertips, (N,), m, at rest."""
    task = env.engine.task
    assert isinstance(task, InHandTask)
    assert task.object_body is not None
    upturned = matrix_from_quaternion(np.array(FACING)).T
    tips = hand_kinematics(task.spec).batch_fingertips()(task.worlds.position) @ upturned
    found: Array = task.object_body.pose[:, 2] - tips[..., 2].mean(axis=1)
    return found


@pytest.mark.parametrize("hand", ["allegro", "leap"])
def test_in_a_cradle_an_object_lies_on_the_fingertips_and_in_a_pinch_it_hangs_between_them(hand: str) -> None:
    pinched, cradled = (batch(hand=hand, grip=grip) for grip in ("pinch", "cradle"))
    assert (over_the_tips(cradled) > 0.006).all()  # The noise of a start moves both by some millimetres.
    assert np.median(over_the_tips(pinched)) < 0.004


@pytest.mark.slow
def test_a_search_for_cradles_keeps_what_lies_on_the_fingertips(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_states, "AT_ONCE", 192)
    spec = load_spec()
    position, target, pose, _ = start_states.try_candidates(
        spec, in_hand_object("ball"), CRADLE, TRAIN, np.random.default_rng(4)
    )
    tips = hand_kinematics(spec).batch_fingertips()(position) @ matrix_from_quaternion(np.array(FACING)).T
    assert len(position) >= 9  # Of 192; few without `raised`.
    assert (pose[:, 2] - tips[..., 2].mean(axis=1) > CRADLE.above).all()
    assert ((target >= spec.lower) & (target <= spec.upper)).all()


@pytest.mark.slow
def test_a_finger_that_steps_loses_a_cradled_object_less_often_than_a_pinched_one() -> None:
    lost = {"pinch": 0, "cradle": 0}
    for grip in lost:
        for flexion in (5, 14):  # The middle finger's, and the thumb's.
            env, opened, failed = batch(grip=grip), STILL.copy(), np.zeros(N, bool)
            opened[:, flexion] = -1.0
            for k in range(14):
                failed |= env.step(opened if k < 6 else STILL)[2]
            lost[grip] += int(failed.sum())
    assert lost["cradle"] < 0.7 * lost["pinch"], lost


def test_a_grip_is_of_what_the_fingertips_hold() -> None:
    with pytest.raises(ConfigError, match="grip: cradle is of palm: forbidden"):
        HandVectorEnv("Rotate", 1, grip="cradle", palm="allowed")
    with pytest.raises(ConfigError, match="grip"):
        HandVectorEnv("Lift", 1, grip="cradle")


@pytest.mark.parametrize(("side", "grip"), [("right", "pinch"), ("left", "pinch"), ("left", "cradle")])
def test_another_hand_holds_a_cube_in_its_fingertips_too(side: str, grip: str) -> None:
    env = batch(hand="leap", side=side, grip=grip)
    failed = np.zeros(N, bool)
    for _ in range(10):
        *_, end, _, info = env.step(STILL)
        failed |= end
    assert failed.sum() <= 1
    assert (info["by_tips"][~failed] > 0.75).all()
    assert (info["by_palm"][~failed] == 0.0).all()


def test_what_a_hand_that_closes_its_own_loop_pays_for_torque_is_for_what_its_motors_give() -> None:
    env = batch(hand="leap", objects=("cube",))
    *_, info = env.step(STILL)
    torque = env.engine.worlds.applied_torque
    limit = env.engine.task.spec.actuation.torque_limit
    np.testing.assert_allclose(info["torque"], -0.01 * (np.clip(torque, -limit, limit) ** 2).sum(axis=-1), atol=1e-9)
    assert (np.abs(torque) <= limit + 1e-9).all()


def test_the_clearance_is_over_the_palm_of_the_hand_that_it_is() -> None:
    env = batch(hand="leap", objects=("cube",))
    *_, info = env.step(STILL)
    task: Any = env.engine.task
    up = np.tile([0.0, 0.0, 1.0], (N, 1))
    expected = palm_clearance(task.object_body.pose, task._shapes, task.kind, task._factor, up, 0.0158)
    np.testing.assert_allclose(info["clearance"], expected, atol=1e-6)


def test_the_palm_of_another_hand_is_no_place_for_an_object() -> None:
    with pytest.raises(ConfigError, match="Rotate with palm: allowed is a task of allegro; leap has it in the"):
        HandEnv("Rotate", hand="leap", palm="allowed")


def test_the_palms_surface_is_the_top_of_what_touches() -> None:
    assert palm_height(load_spec()) == pytest.approx(0.0111)
    assert palm_height(load_spec("leap")) == pytest.approx(0.0158)


@pytest.mark.slow
def test_a_hand_that_was_never_searched_for_is_searched_for_by_where_its_fingertips_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(start_states, "AT_ONCE", 96)
    monkeypatch.setattr(start_states, "OPPOSED_MOST", 1)
    spec, ball = load_spec("leap"), in_hand_object("ball")
    found = start_states.search_start_states(ball, OpposedSearch(tips=3), TRAIN._replace(most=24), spec)
    assert len(found.size) >= 2
    assert ((spec.lower - 0.03 <= found.position) & (found.position <= spec.upper + 0.03)).all()
    height = 2.0 * found.size * ball.half_extents()[2]
    assert (found.pose[:, 2] > palm_height(spec) + height / 2).all()
    kept = start_states.survives_noise(spec, ball, found, np.random.default_rng(99))
    assert kept.mean() > 0.5, "most survive other draws than those that they were chosen by"


@pytest.mark.slow
def test_a_hand_from_a_stranger_s_file_holds_a_ball_in_its_fingertips(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A card as `hand new` writes it: fingers and their names are guesses."""
    mjcf = data_root() / "models" / "mjcf" / "leap_right.xml"
    words = [sys.executable, "-m", "allegro_twin", "hand", "new", str(mjcf), "--out", str(tmp_path / "mine")]
    subprocess.run(words, check=True, capture_output=True, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)})
    monkeypatch.setattr(start_states, "AT_ONCE", 96)
    monkeypatch.setattr(start_states, "OPPOSED_MOST", 1)
    monkeypatch.setattr(start_states, "cache_folder", lambda kind, what: tmp_path)
    card = tmp_path / "mine" / "leap_right.yaml"
    for _ in range(2):  # Searched for once.
        env = HandEnv("Rotate", hand=str(card), objects=("ball",), timestep=0.003, decimation=20)
        monkeypatch.setattr(start_states, "try_candidates", lambda *_: pytest.fail("they are in the cache"))
    env.reset(seed=0)
    for _ in range(5):
        *_, info = env.step(STILL[0])
    assert info["by_tips"] > 0.75
    assert info["by_palm"] == 0.0


def test_where_nothing_survives_the_noise_of_a_start_the_hand_and_the_object_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = StartStates(np.zeros((1, 16)), np.zeros((1, 16)), np.zeros((1, 7)), np.ones(1))
    held = one.position, one.target, one.pose, one.size
    monkeypatch.setattr(start_states, "try_candidates", lambda *_: held)
    monkeypatch.setattr(start_states, "survives_noise", lambda *_: np.zeros(1, bool))
    with pytest.raises(ConfigError, match="of the fingertips of leap was found that holds ball above the palm"):
        start_states.search_start_states(
            in_hand_object("ball"), OpposedSearch(tips=3), TRAIN._replace(most=1), load_spec("leap")
        )


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[int | None], None]:
    """Every batch of a search holds three states, of random numbers; the one of that number is interrupted."""
    cube = in_hand_object("cube")
    shipped = load_start_states(cube, "right", start_states.FINGERTIPS, TRAIN)
    monkeypatch.setattr(start_states, "cache_folder", lambda *_: tmp_path)
    monkeypatch.setattr(
        start_states, "survives_noise", lambda spec, thing, states, rng: np.ones(len(states.size), bool)
    )

    def until(batch: int | None) -> None:
        tried = iter(range(1000))

        def held(spec: Any, thing: Any, search: Any, wanted: Any, rng: np.random.Generator) -> tuple[Array, ...]:
            if next(tried) == batch:
                raise KeyboardInterrupt
            rows = rng.integers(len(shipped.size), size=3)
            some = shipped.of(rows)
            return some.position, some.target, some.pose, rng.uniform(0.9, 1.1, 3)

        monkeypatch.setattr(start_states, "try_candidates", held)

    return until


def test_the_search_for_start_states_says_for_what_it_searches_how_far_it_is_and_that_it_happens_once(
    drawn: Callable[[int | None], None], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mine, wanted = replace(in_hand_object("cube"), name="mine", mass=0.2), TRAIN._replace(most=60)
    drawn(None)
    load_start_states(mine, "right", start_states.FINGERTIPS, wanted)
    assert caplog.messages == [
        "mine: searching for 60 start states, in which the fingers of allegro hold it; that takes some minutes, "
        f"happens once, and is kept in {tmp_path}",
        "mine: 6 of 60 start states, after 1,024 tries, are found",
        "mine: 12 of 60 start states, after 2,048 tries, are found",
        "mine: 24 of 60 start states, after 4,096 tries, are found",
        "mine: 48 of 60 start states, after 8,192 tries, are found",
    ]
    caplog.clear()
    load_start_states(mine, "right", start_states.FINGERTIPS, wanted)
    assert not caplog.messages


def test_an_interrupted_search_for_start_states_goes_on_and_finds_what_one_without_a_break_finds(
    drawn: Callable[[int | None], None], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mine, wanted = replace(in_hand_object("cube"), name="mine", mass=0.2), TRAIN._replace(most=60)
    drawn(None)
    whole = start_states.search_start_states(mine, start_states.FINGERTIPS, wanted)
    caplog.clear()
    for batch in (0, 7):
        drawn(batch)
        with pytest.raises(KeyboardInterrupt):
            load_start_states(mine, "right", start_states.FINGERTIPS, wanted)
    drawn(None)
    found = load_start_states(mine, "right", start_states.FINGERTIPS, wanted)
    for name in ("position", "target", "pose", "size"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name).astype(np.float32))
    told = [line for line in caplog.messages if "searching" not in line and "interrupt" in line]
    assert told == [
        "mine: interrupted: 0 of 60 start states, after 0 tries, are found; nothing is kept",
        "mine: interrupted: 21 of 60 start states, after 3,584 tries, are found; they are kept, and the next search "
        "goes on from them",
        "mine: 21 of 60 start states, after 3,584 tries, are there from an interrupted search, which goes on",
    ]
    assert len(list(tmp_path.iterdir())) == 1


def test_a_search_that_finds_nothing_leaves_nothing(
    drawn: Callable[[int | None], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn(None)
    monkeypatch.setattr(start_states, "survives_noise", lambda *_: np.zeros(60, bool))
    mine = replace(in_hand_object("cube"), name="mine", mass=0.2)
    with pytest.raises(ConfigError, match="was found that holds mine above the palm"):
        load_start_states(mine, "right", start_states.FINGERTIPS, TRAIN._replace(most=60))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("task", ["Rotate", "Reorient"])
@pytest.mark.parametrize("palm", ["forbidden", "allowed"])
def test_an_object_on_the_palm_ends_the_episode_unless_that_is_allowed(task: str, palm: str) -> None:
    env = HandEnv(task, timestep=0.003, decimation=1, palm=palm, objects=("cube",))
    env.reset(seed=0)
    in_hand: Any = env.engine.task
    in_hand.object_body.pose[0] = -0.02, 0.0, PALM + 0.0285 * in_hand._factor[0] - 0.0005, 1.0, 0.0, 0.0, 0.0
    in_hand.place[0] = in_hand.object_body.pose[0, :3]
    in_hand.object_body.velocity[:] = in_hand.object_body.spin[:] = 0.0
    _, reward, failed, _, info = env.step(STILL[0])
    assert info["by_palm"] > 0.1
    assert failed == (palm == "forbidden")
    assert (reward < -15.0) == failed


def test_a_touch_between_two_decisions_counts() -> None:
    env = HandEnv("Rotate", timestep=0.003, decimation=20, objects=("cube",))
    env.reset(seed=0)
    in_hand: Any = env.engine.task
    contacts, palm = in_hand.contacts, in_hand.contacts.links.index("palm_link")
    real, add, count = in_hand.worlds.contact_steps, contacts.add_period, []

    def once() -> None:
        count.append(1)
        in_hand.worlds.contact_steps = np.array(real)
        in_hand.worlds.contact_steps[0, 0, palm, 2] = 0.5 if len(count) == 7 else 0.0
        add()

    contacts.add_period = once
    *_, info = env.step(STILL[0])
    assert len(count) == 20
    assert info["dropped"] == -20.0


def test_a_touch_within_a_control_period_counts() -> None:
    env = HandEnv("Rotate", period=0.02, decimation=2)
    env.reset(seed=9)
    worlds: Any = env.engine.worlds
    step, rng, action, palm = worlds.step, np.random.default_rng(9), np.zeros(16), list[float]()

    def watched(rows: Any, count: int) -> None:
        before = worlds.state(0)
        palm.extend(each[2] for each in forces(worlds, 0, before, count))
        step(rows, count)

    worlds.step = watched
    failed = False
    while not failed:
        palm.clear()
        action = (0.95 * action + rng.normal(0.0, 0.15, 16)).clip(-1.0, 1.0)
        _, _, failed, truncated, _ = env.step(action.astype(np.float32))
        assert failed == (max(palm) > 1e-9)
        assert not truncated
    assert len(palm) == 40
    assert palm[19] == palm[39] == 0.0  # At the end of a period nothing of it is left.


@pytest.mark.parametrize("timestep", [0.003, 0.001])
def test_shares_are_those_of_mujocos_own_contact_forces(timestep: float) -> None:
    env = HandVectorEnv("Rotate", N, autoreset_mode="disabled", timestep=timestep, decimation=1, palm="allowed")
    env.reset(seed=11)
    sums = np.zeros((N, 3))
    rng, worlds = np.random.default_rng(0), env.engine.worlds
    for _ in range(12):
        before = [worlds.state(row) for row in range(N)]
        info = env.step(rng.normal(0.0, 0.3, (N, 16)).clip(-1.0, 1.0).astype(np.float32))[4]
        for row in range(N):
            sums[row] += sum(forces(worlds, row, before[row], round(0.003 / timestep)))
    shares = np.stack([info["by_tips"], info["by_middle"], info["by_palm"]], axis=-1)
    assert (sums.sum(axis=-1) > 0.1).all()
    np.testing.assert_allclose(shares, sums / sums.sum(axis=-1, keepdims=True), atol=1e-6)
    assert shares[:, 1].max() > 0.02  # Something was carried by other links.
    assert shares[:, 2].max() > 0.02


def forces(worlds: Any, row: int, before: Any, steps: int) -> list[Any]:
    """Sizes of the net forces of each group of links on the object at each physics step from a state, (3,) each, N."""
    model = worlds._batch.get_model(row)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, before, mujoco.mjtState.mjSTATE_INTEGRATION)
    data.ctrl[:] = worlds._ctrl[row]
    found = []
    for _ in range(steps):
        mujoco.mj_step(model, data)
        found.append(group_forces(model, data))
    return found


def group_forces(model: Any, data: Any) -> Any:
    body = model.body("object").id
    net: dict[str, Any] = {}
    for k, contact in enumerate(data.contact[: data.ncon]):
        bodies = model.geom_bodyid[contact.geom]
        if body not in bodies or contact.efc_address < 0:
            continue
        force = np.zeros(6)
        mujoco.mj_contactForce(model, data, k, force)
        link = model.body(int(bodies[bodies != body][0])).name
        sign = 1.0 if bodies[1] == body else -1.0
        net[link] = net.get(link, 0.0) + sign * contact.frame.reshape(3, 3).T @ force[:3]
    group = {f"link_{k}.0": 0 if k % 4 == 3 else 1 if k % 4 == 2 else 2 for k in range(16)} | {"palm_link": 2}
    found = np.zeros(3)
    for link, each in net.items():
        found[group[link]] += np.linalg.norm(each)
    return found


def test_a_size_that_no_start_state_has_is_refused_and_of_others_the_state_decides() -> None:
    env, tested = HandEnv("Rotate", objects=("cube",)), HandEnv("Rotate", objects=("cube",), starts="test")
    for size in (0.9, 1.0, 1.1):
        _, info = env.reset(seed=1, options={"size": size})
        assert info["randomised"]["size"] == pytest.approx(size, abs=0.01)
        assert info["randomised"]["size"] == env.engine.task._factor[0]  # type: ignore[attr-defined]  # Of Rotate.
    for other, size, known in ((env, 1.103, "0.9 to 1.1"), (tested, 1.0, "0.85 to 0.9 or 1.1 to 1.15")):
        with pytest.raises(ConfigError, match=f"size {size:g}: start states have cube at {known} times its size"):
            other.reset(seed=1, options={"size": size})


def test_start_states_keep_a_range_of_sizes_that_is_asked_for() -> None:
    envs = HandVectorEnv("Rotate", 400, randomise={"size": (0.99, 1.01)})
    size = envs.reset(seed=0)[1]["randomised"]["size"]
    assert (size >= 0.99).all()
    assert (size <= 1.01).all()


def test_test_states_are_of_the_fingertips_only() -> None:
    with pytest.raises(ConfigError, match="starts: test is of palm: forbidden"):
        HandEnv("Rotate", palm="allowed", starts="test")
    with pytest.raises(ConfigError, match="Grasp has no palm to choose"):
        HandEnv("Grasp", palm="allowed")


def test_an_evaluation_in_the_fingertips_has_sizes_and_objects_of_no_training() -> None:
    sets = evaluation_sets(load_recipe("rotate"))
    assert list(sets) == ["trained on", "unseen sizes", "held out"]
    assert [each.starts for each in sets.values()] == ["train", "test", "test"]
    assert sets["held out"].objects == ("hex_nut",)
    assert list(evaluation_sets(load_recipe("rotate_on_palm"))) == ["trained on"]
