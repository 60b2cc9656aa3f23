"""The rehearsal: hidden hands are unlike each other and unlike our drives, and what they are judged by is the truth."""

from __future__ import annotations

import json
import subprocess
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from allegro_twin import ConfigError, HandFault, TorqueCommand
from allegro_twin.app import Rig, assemble
from allegro_twin.files import find_file, read_yaml
from allegro_twin.gym import EnvSettings
from allegro_twin.hands import load_spec
from allegro_twin.learning import load_recipe
from allegro_twin.twin.identify import find_pose
from allegro_twin.twin.rehearsal import RehearsedTwin, hidden_scores, hold_posture, lead_to_ends, program, steady_error
from allegro_twin.twin.rehearsal.measures import Following
from studies.rehearsal import __main__ as study
from studies.rehearsal import planned, sessions
from studies.rehearsal.__main__ import PROTOCOL, REGISTRATION, contents
from studies.rehearsal.films import film_grasps, write_page
from studies.rehearsal.hidden_hand import STEP, VERSIONS, HiddenHand, draw_hand
from studies.rehearsal.motor_laws import HandPhysics, MotorLaws
from studies.rehearsal.policies import POLICIES, HiddenEpisode, policy_file, predicted
from studies.rehearsal.rehearse import drawn_objects
from studies.rehearsal.report import planned_table, policy_table, scores, table, trajectory_table
from studies.rehearsal.sessions import RehearsedHiddenHand

SEED = 5  # Not that of the protocol.


def plain(offset: float = 0.0, **more: Any) -> HandPhysics:
    """As our own nominal drive, with an encoder offset."""
    constant, armature, damping, friction = (np.full(16, value) for value in (1.0, 0.003, 0.07, 0.005))
    return HandPhysics(constant, armature, damping, friction, offset=np.full(16, offset), delay=STEP, **more)


def hand(physics: HandPhysics, version: str = "v4", side: Any = "right") -> HiddenHand:
    return HiddenHand(0, side, version, physics, np.zeros(3), 0.005, 1.0, 0.01, 100.0, ())


def test_hands_are_drawn_by_number_and_no_two_are_alike() -> None:
    drawn = [draw_hand(k, SEED) for k in range(20)]
    np.testing.assert_array_equal(drawn[3].physics.constant, draw_hand(3, SEED).physics.constant)
    assert len({each.physics.delay for each in drawn}) == 20
    assert {each.version for each in drawn} == {*VERSIONS}
    assert {each.side for each in drawn} == {"left", "right"}
    traits = {trait for each in drawn for trait in each.traits}
    assert len(traits) == 9
    assert all(each.physics.constant.min() > 0.5 for each in drawn)


def errors(own: HiddenHand, serial: str) -> Any:
    """How far the true joints are from a posture, rad."""
    twin = RehearsedTwin("host", serial, np.zeros(16))
    found = hold_posture(RehearsedHiddenHand(own), "palm-up", twin, "ok", "pd")
    return steady_error(found, found.known)


@pytest.mark.slow
def test_an_encoder_that_is_off_puts_every_posture_off_until_the_ends_of_the_joints_tell(tmp_path: Path) -> None:
    own = hand(plain(0.02), side="left")
    np.testing.assert_allclose(errors(own, ""), -0.02, atol=0.003)
    ends = lead_to_ends(RehearsedHiddenHand(own), "up", "")
    assert ends.seconds < 100.0
    file = tmp_path / "mine.yaml"
    wire = {"version": "v4", "side": "left", "encoder_offset": list(ends.encoder_offsets().offset)}
    file.write_text(yaml.safe_dump({"wire": wire}))
    assert np.abs(errors(own, str(file))).max() < 0.002


def opened(own: HiddenHand, serial: str = "", torque: float = 0.0) -> tuple[Rig, RehearsedHiddenHand]:
    """A session in which the joints get a constant torque."""
    subject = RehearsedHiddenHand(own)
    config, physics = subject.placed(find_pose("palm-up", "right"))
    blocks = {"hand": {"serial": serial}, "controller": {"kind": "torque", "torque": torque}}
    return assemble(config.changed(**blocks), physics), subject


def test_a_host_that_knows_the_torque_constants_asks_for_that_much_less_of_full_pwm(tmp_path: Path) -> None:
    file = tmp_path / "strong.yaml"
    file.write_text("wire: {version: v4, torque_constant: 2.0}\n")
    duties = []
    for serial in ("", str(file)):
        rig, subject = opened(hand(plain()), serial, 0.1)
        with closing(rig.backend):
            state = rig.backend.reset()
            for _ in range(5):
                rig.backend.write(rig.controller(state, rig.controller.start(state))[0])
                state = rig.backend.read()
            assert subject.hidden is not None
            duties.append(subject.hidden._duty.copy())
    np.testing.assert_allclose(duties[0], 0.1, rtol=0.02)
    np.testing.assert_allclose(duties[1], duties[0] / 2.0, rtol=0.02)


def test_a_mount_that_leans_turns_the_palm_and_nothing_that_it_says() -> None:
    own = replace(hand(plain()), lean=np.array([0.0, 0.03, 0.0]))
    bodies = []
    for each in (hand(plain()), own):
        rig, subject = opened(each)
        with closing(rig.backend):
            state = rig.backend.reset()
            assert subject.hidden is not None
            bodies.append(subject.hidden.data.body("palm_link").xquat.copy())
            np.testing.assert_allclose(state.gravity, find_pose("palm-up", "right").gravity)
    between = np.zeros(3)
    mujoco.mju_subQuat(between, bodies[1], bodies[0])
    np.testing.assert_allclose(between, [0.0, 0.03, 0.0], atol=1e-9)


def test_bristles_hold_a_joint_until_it_breaks_away_and_let_it_slide_with_less() -> None:
    laws = MotorLaws(plain(ratio=np.full(16, 1.5), bristle=8e-4), 1e-4)
    position, speed = np.zeros(16), np.zeros(16)
    for pull, moves in ((0.0065, False), (0.009, True)):
        laws.reset(np.zeros(16))
        position, speed = np.zeros(16), np.zeros(16)
        for k in range(4000):
            torque, _ = laws.step(np.full(16, pull), position, speed, 1e-4 * k)
            speed = speed + 1e-4 * torque / 0.003
            position = position + 1e-4 * speed
        assert (np.abs(position) > 0.004).all() == moves, pull


def test_teeth_leave_a_link_free_within_their_play_and_carry_it_beyond() -> None:
    laws = MotorLaws(plain(play=np.full(16, 0.006), spring=30.0), 1e-4)
    laws.reset(np.zeros(16))
    for apart, passed in ((0.0, 0.0), (0.002, 0.0), (0.0031, -30.0 * 0.0001), (-0.005, 30.0 * 0.002)):
        laws.reset(np.zeros(16))
        torque, _ = laws.step(np.zeros(16), np.full(16, apart), np.zeros(16), 0.0)
        np.testing.assert_allclose(torque, passed, atol=1e-9)


@pytest.mark.slow
def test_a_grasp_of_a_strong_hand_holds_and_one_of_a_hand_without_motors_does_not() -> None:
    assert RehearsedHiddenHand(hand(plain())).trial("foam_brick", "").held
    weak = plain()
    weak.constant *= 0.05
    assert not RehearsedHiddenHand(hand(weak)).trial("foam_brick", "").held


@pytest.mark.slow
def test_grasps_of_a_result_are_performed_again_and_filmed_with_a_page_of_what_was_lost_first(tmp_path: Path) -> None:
    protocol = read_yaml(PROTOCOL)
    grasps = [{"scenario": "golf_ball", "held": True}, {"scenario": "mug", "held": False}]
    row = {"number": 5, "file": "", "nominal": {"grasps": grasps}, "identified": {"grasps": grasps}}
    (lost,) = film_grasps(row, protocol | {"twins": ["nominal"]}, tmp_path / "films", lost=True)
    assert (lost.path.name, lost.held, lost.as_before) == ("05_nominal_mug.mp4", False, True)
    held = lost._replace(path=tmp_path / "films" / "05_nominal_lemon.mp4", held=True, as_before=False)
    write_page(tmp_path / "films.html", {"Hand 5": [held, lost]})
    page = (tmp_path / "films.html").read_text()
    assert page.index("films/05_nominal_mug.mp4") < page.index("films/05_nominal_lemon.mp4")
    assert "held (otherwise than in the result)" in page
    assert lost.reason in page
    assert lost.path.stat().st_size > 10_000


def test_policies_are_tried_once_on_hands_that_were_learnt_and_no_results_are_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = list[tuple[int, str]]()

    def try_policies(hand: HiddenHand, file: Path, seed: int) -> list[Any]:
        tried.append((hand.number, file.read_text()))
        return []

    monkeypatch.setattr(study, "try_policies", try_policies)
    learnt, nothing = "wire: {}\nidentified: {}\n", "wire: {}\n"
    for number, file in ((2, learnt), (4, nothing), (6, learnt)):
        (tmp_path / f"{number:02d}.json").write_text(json.dumps({"number": number, "file": file}))
    study.policies(tmp_path, "2,4")
    study.policies(tmp_path)
    assert tried == [(2, learnt), (6, learnt)]
    assert json.loads((tmp_path / "02.json").read_text())["policies"] == []
    for folder, hands, why in ((tmp_path / "none", None, "has no such results"), (tmp_path, "3", "has no such results"),
                               (tmp_path, "two", "not 'two'")):  # fmt: skip
        with pytest.raises(ConfigError, match=why):
            study.policies(folder, hands)


def test_trajectories_are_followed_with_the_learnt_file_where_a_result_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, learnt = list[tuple[str, str, float, bool]](), "wire: {}\nidentified: {}\n"

    def follow(hand: Any, pose: str, twin: Any, speed: float, kind: str, *_: Any, feedforward: bool) -> Following:
        file = Path(twin.serial).read_text() if twin.serial else ""
        asked.append((twin.name, file, speed, feedforward))
        t = np.arange(0.0, 1.0, 0.003)
        rows = np.repeat(t[:, None], 16, axis=1)
        return Following(load_spec(), t, rows, 1.0 + 0.0 * rows, rows, None, np.array([0.0, 0.1, 1.0]), 0.0 * rows)

    monkeypatch.setattr(program, "follow_trajectory", follow)
    empty: dict[str, Any] = {"postures": [], "grasps": []}
    path = tmp_path / "02.json"
    path.write_text(json.dumps({"number": 2, "file": learnt, "nominal": empty, "identified": empty}))
    study.trajectories(tmp_path)
    study.trajectories(tmp_path)
    ways = [(speed, fed) for fed in (False, True) for speed in (0.5, 3.0)]
    assert asked == [(twin, file, *way) for twin, file in (("nominal", ""), ("identified", learnt)) for way in ways]
    row = json.loads(path.read_text())
    assert [(each["level"], each["feedforward"]) for each in row["identified"]["trajectories"]] == [
        ("slow", False), ("fast", False), ("slow", True), ("fast", True),
    ]  # fmt: skip
    told = trajectory_table([row])
    assert "| identified | slow | 0.0 (0.0); 1 of 1; 0.0 ms | 0.0 (0.0); 1 of 1; 0.0 ms |" in told
    assert trajectory_table([{"nominal": empty, "identified": empty}]) == ""


class FakePlan:
    """Stands in for `allegro-twin plan`: writes a grasp, or ends with an exit code."""

    def __init__(self, ends: int = 0) -> None:
        self.ends = ends
        self.commands = list[list[str]]()

    def __call__(self, command: list[str], **_: Any) -> Any:
        self.commands.append(command)
        if not self.ends:
            place, thing = Path(command[command.index("--out") + 1]), command[command.index("plan") + 1]
            (place / "grasps").mkdir(parents=True)
            (place / f"{thing}_1.yaml").write_text("")
            proof = {"entries": {f"{thing}_1": {"planned": {"held": 19, "draws": 20}}}}
            (place / "grasps" / f"{thing}_1.yaml").write_text(yaml.safe_dump(proof))
        return subprocess.CompletedProcess(command, self.ends, "", "it is too large")


def test_planned_grasps_are_made_once_for_all_nominal_hands_and_for_each_learnt_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, performed = FakePlan(), list[tuple[str, str, str]]()
    monkeypatch.setattr(subprocess, "run", plan)

    def trial(own: RehearsedHiddenHand, scenario: str, serial: str) -> Any:
        learnt = Path(serial).read_text() if serial else ""
        assert list(own._draws) == [scenario]  # What the host is not told of the object.
        performed.append((Path(scenario).relative_to(tmp_path / "plans").as_posix(), own.hand.version, learnt))
        if learnt:
            raise HandFault("thumb_0 is too fast")
        return SimpleNamespace(held=True, reason="")

    monkeypatch.setattr(RehearsedHiddenHand, "trial", trial)
    learnt = "wire: {}\nidentified: {}\n"
    results = ((2, "right", learnt), (3, "left", learnt), (6, "right", learnt), (8, "right", ""))
    for number, side, file in results:
        (tmp_path / f"{number:02d}.json").write_text(json.dumps({"number": number, "side": side, "file": file}))
    study.planned(tmp_path, None, 60)
    study.planned(tmp_path, None, 60)
    protocol = read_yaml(PROTOCOL)
    things = [name for k in (2, 6) for name in drawn_objects(draw_hand(k, protocol["seed"]), protocol)]
    serials = ["--twin" in command for command in plan.commands]
    assert (serials.count(False), serials.count(True)) == (len(set(things)), 6)
    assert performed[1] == (f"02/{things[0]}/{things[0]}_1.yaml", draw_hand(2, protocol["seed"]).version, learnt)
    rows = json.loads((tmp_path / "06.json").read_text())["planned"]
    about = {"object": things[3], "foretold": 19, "of": 20}
    assert rows[:2] == [about | {"twin": "nominal", "held": True, "reason": ""},
                        about | {"twin": "identified", "held": False, "reason": "thumb_0 is too fast"}]  # fmt: skip
    assert all("planned" not in json.loads((tmp_path / f"{k:02d}.json").read_text()) for k in (3, 8))


@pytest.mark.parametrize(("version", "scenario", "carried"), [
    ("v3", "golf_ball", False), ("v4", "golf_ball", True), ("v3", "forceful", True), ("v4", "forceful", True),
])  # fmt: skip
def test_who_controls_force_carries_the_hand_s_weight_without_an_imu_that_of_the_palm_as_the_trial_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: str, scenario: str, carried: bool
) -> None:
    asked = list[Any]()
    monkeypatch.setattr(sessions, "grasp_trial", lambda config, *_: asked.append(config))
    content = read_yaml(find_file("golf_ball", "scenario", "scenarios", below=True)) | {"grasp": "pinch_index"}
    (tmp_path / "forceful.yaml").write_text(yaml.safe_dump(content))
    named = scenario if scenario == "golf_ball" else str(tmp_path / "forceful.yaml")
    RehearsedHiddenHand(hand(plain(), version)).trial(named, "")
    (config,) = asked
    assert config.controller.compensate == carried
    assert (config.backend.imu > 0.0) == (version == "v4")
    if version == "v3":  # x where the palm looks, z along the fingers.
        along, fingers = (content["wrist"][name][2] for name in ("facing", "fingers"))
        np.testing.assert_allclose(
            np.array(config.backend.gravity)[[0, 2]], [-9.81 * along, -9.81 * fingers], atol=0.05
        )
        assert np.linalg.norm(config.backend.gravity) == pytest.approx(9.81)


def test_a_plan_that_finds_nothing_is_a_grasp_that_does_not_hold_and_one_that_fails_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = FakePlan(planned.NOTHING_HOLDS)
    monkeypatch.setattr(subprocess, "run", plan)
    assert planned.plan_grasp("anvil", "", tmp_path / "anvil", 60) is None
    assert planned.plan_grasp("anvil", "", tmp_path / "anvil", 60) is None
    assert len(plan.commands) == 1
    plan.ends = 2
    with pytest.raises(ConfigError, match="plan piano failed with 2: it is too large"):
        planned.plan_grasp("piano", "", tmp_path / "piano", 60)


def test_planned_grasps_stand_beside_what_their_plans_foretold() -> None:
    def row(twin: str, held: bool, foretold: int | None) -> dict[str, Any]:
        told = {} if foretold is None else {"foretold": foretold, "of": 20}
        return {"object": "mug", "twin": twin, "held": held, "reason": "" if held else "it fell"} | told

    rows = [
        row("nominal", True, 20),
        row("nominal", False, 10),
        row("identified", True, 20),
        row("identified", False, None),
    ]
    told = planned_table([{"number": 4, "planned": rows}, {"number": 5}])
    assert "| nominal | 1 of 2: 50 % (9–91 %) | 75 % |" in told
    assert "| identified | 1 of 2: 50 % (9–91 %) | 100 % |" in told
    assert "| 4 | 1 of 2 | 1 of 2 | mug, nominal: it fell; mug, identified: it fell |" in told
    assert planned_table([{"number": 5}]) == ""


def test_a_hand_s_objects_are_its_own_and_the_same_again() -> None:
    protocol = read_yaml(PROTOCOL)
    first, again, other = (
        drawn_objects(hand_, protocol) for hand_ in (draw_hand(1, 5), draw_hand(1, 5), draw_hand(2, 5))
    )
    assert first == again
    assert list(first) == protocol["grasps"][3:6]
    assert list(other) == protocol["grasps"][6:9]
    assert len({each.x for each in (*first.values(), *other.values())}) == 6


def test_the_table_counts_hands_and_grasps() -> None:
    def twin(error: float, held: bool) -> dict[str, Any]:
        postures = [{"controller": kind, "error": [error] * 16} for kind in ("pd", "pid")]
        return {"postures": postures, "grasps": [{"held": held}, {"held": True}]}

    about = {"side": "right", "version": "v4", "traits": [], "learnt": {"bus_s": 98.0, "cpu_s": 200.0}}
    rows = [about | {"number": k, "nominal": twin(0.006, False), "identified": twin(0.001, True)} for k in range(3)]
    told = table(json.loads(json.dumps(rows)))
    assert "| nominal | 6.0 (6.0) | 6.0 (6.0) | 0 of 3, 0 of 3 | –; – | 3 of 6: 50 % (19–81 %) |" in told
    assert "| identified | 1.0 (1.0) | 1.0 (1.0) | 3 of 3, 3 of 3 | –; – | 6 of 6: 100 % (61–100 %) |" in told
    assert "| 0 | right v4: as our drives | 6.0, 6.0; 1 of 2 | 1.0, 1.0; 2 of 2 | 98 s, 200 CPU s |" in told


def test_trajectories_stand_in_the_table_and_scores_are_what_the_command_compares_with(tmp_path: Path) -> None:
    moves = [{"level": "slow", "rms": [0.004] * 16, "lag": 0.012}, {"level": "fast", "rms": [0.03] * 16, "lag": 0.011}]
    twin = {"postures": [{"controller": "pd", "error": [0.002] * 16}], "trajectories": moves, "grasps": []}
    about = {"side": "right", "version": "v4", "traits": [], "learnt": {"bus_s": 98.0}, "number": 0}
    rows = [about | {"nominal": twin, "identified": twin}]
    assert "| nominal | 2.0 (2.0) | – | 1 of 1, 0 of 0 | 4.0 (4.0), 12.0 ms; 30.0 (30.0), 11.0 ms | – |" in table(rows)
    path = tmp_path / "hands.json"
    path.write_text(json.dumps(scores(rows, "One hand.")))
    found = hidden_scores(path)
    assert found is not None
    assert found.hands[0]["identified"]["lag_fast"] == pytest.approx(11.0)


def test_policies_stand_beside_what_was_foretold_of_them() -> None:
    def said(successes: int, low: int, high: int, **more: Any) -> dict[str, Any]:
        return {"successes": successes, "of": 96, "low": low, "high": high, "covers": low <= 9 <= high} | more

    row = {"policy": "grasp_right", "episodes": 12, "nominal": {"successes": 7}, "identified": {"successes": 9},
           "simulated": said(94, 10, 12), "posterior": said(72, 6, 12)}  # fmt: skip
    told = policy_table([{"number": 4, "policies": [row]}, {"number": 5}])
    assert "| grasp_right | 4 | 7 of 12 | 9 of 12 | 98 %, 10–12 | 75 %, 6–12 | yes |" in told
    assert "covers 1 of 1" in told
    failed = row | {"posterior": {"error": "no twin"}}
    assert "| no twin | – |" in policy_table([{"number": 4, "policies": [failed]}])
    assert policy_table([{"number": 5}]) == ""


def test_the_policies_that_are_tried_ship_with_their_recipes() -> None:
    tasks = [load_recipe(each.recipe).task for each in POLICIES]
    assert tasks == ["Grasp", "Lift", "Rotate"]
    assert all(policy_file(each).is_file() for each in POLICIES)


def test_a_prediction_is_wider_for_few_episodes_and_holds_its_share() -> None:
    assert predicted(96, 96, 12) == (11, 12)
    low, high = predicted(48, 96, 12)
    assert (low, high) == (2, 10)
    assert predicted(0, 96, 6) == (0, 1)


def test_a_hidden_hand_in_an_episode_obeys_its_own_motors() -> None:
    """A hand without motors falls where a strong one is pushed; the encoders say where it is, and are off."""
    settings = EnvSettings(timestep=STEP)
    ends = []
    for constant in (1.0, 0.0):
        own = plain(0.02)
        own.constant[:] = constant
        episode = HiddenEpisode(hand(own), "Reach", settings, 7)
        state = episode.reset()
        true = episode.engine.worlds.position[0].copy()
        np.testing.assert_allclose(state.position, true + 0.02, atol=0.001)
        for _ in range(20):
            episode.write(TorqueCommand(np.full(16, 0.3)))
            state = episode.read()
        ends.append(episode.engine.worlds.position[0] - true)
    assert (ends[0] > ends[1] + 0.01).all()


def test_the_registration_is_of_the_protocol_that_is_there() -> None:
    registered, now = json.loads(REGISTRATION.read_text()), contents()
    assert registered.keys() <= now.keys()
    assert registered["protocol"] == now["protocol"]
    assert read_yaml(PROTOCOL)["hands"] == 20
