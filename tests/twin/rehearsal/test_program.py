"""The program of a rehearsal: its order, what it says when something fails, and how it goes on."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.config import load_config
from allegro_twin.errors import ConfigError, HandFault, RecordingError, WrongPose
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.twin.identify.joint_ends import JointEnds
from allegro_twin.twin.identify.motions.excitation import ExcitationPose
from allegro_twin.twin.identify.motions.limits import FoundLimits
from allegro_twin.twin.rehearsal import Conversation, HandRehearsal, RehearsalProtocol, RehearsedHand
from allegro_twin.twin.rehearsal import program as steps_of
from allegro_twin.twin.rehearsal.measures import Following
from allegro_twin.twin.rehearsal.page import NO_HANDS, rehearsal_page, score_rows
from allegro_twin.twin.rehearsal.score import HiddenScores, hidden_scores, rank, score_of
from allegro_twin.twin.rehearsal.sessions import RehearsedTwin
from allegro_twin.types import frozen

SPEC = load_spec()
SHORT = RehearsalProtocol(poses={"up": 4.0, "palm-up": 4.0}, postures=("ok", "fist"), controllers=("pd",))
NAMES = [
    "checkup", "ends", "excite up", "excite palm-up", "identify",
    *(f"{twin} palm-up {what}" for twin in ("nominal", "identified")
      for what in ("ok pd", "fist pd", "trajectory slow pd", "trajectory fast pd", "trajectory slow pd feedforward",
                   "trajectory fast pd feedforward")),
]  # fmt: skip


class Sessions:
    """In place of every session; each name leads to what is to happen there."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[str] = []
        self.at: dict[str, Callable[[], None]] = {}
        self.error, self.shaken = {"nominal": 0.006, "identified": 0.002}, 0.0
        for name in ("lead_to_ends", "excite_in_pose", "hold_posture", "follow_trajectory"):
            monkeypatch.setattr(steps_of, name, getattr(self, name))
        monkeypatch.setattr(HandRehearsal, "_identify", lambda own: self.identify())
        monkeypatch.setattr(RehearsedHand, "check_link", lambda own: self.check_link())

    def identify(self) -> dict[str, Any]:
        self.note("identify")
        return {"lines": ["It has a cable."]}

    def check_link(self) -> str:
        self.note("checkup")
        return "limp"

    def note(self, name: str) -> None:
        self.at.get(name, lambda: None)()
        self.done.append(name)

    def lead_to_ends(self, hand: RehearsedHand, pose: str, serial: str, file: Path, advance: Any) -> JointEnds:
        advance(50.0)
        self.note("ends")
        codec = steps_of_codec()
        return JointEnds(SPEC, FoundLimits(frozen(SPEC.lower + 0.01), frozen(SPEC.upper + 0.01)), 50.0, codec)

    def excite_in_pose(self, hand: RehearsedHand, pose: str, *rest: Any) -> list[Path]:
        rest[-1](16.0)
        self.note(f"excite {pose}")
        return [rest[2] / f"{pose}_1.arrow"]

    def hold_posture(self, hand: RehearsedHand, pose: str, twin: RehearsedTwin, posture: str, *rest: Any) -> Following:
        self.note(f"{twin.name} {pose} {posture}")
        return self._motion(twin)

    def follow_trajectory(
        self, hand: RehearsedHand, pose: str, twin: RehearsedTwin, *rest: Any, feedforward: bool
    ) -> Following:
        self.note(f"{twin.name} trajectory {rest[0]:g}{' feedforward' if feedforward else ''}")
        return self._motion(twin)

    def _motion(self, twin: RehearsedTwin) -> Following:
        t = np.arange(0.0, 1.0, 0.003)
        rows = np.repeat(t[:, None], 16, axis=1)
        begins, found = np.array([0.0, 0.1, 1.0]), rows + self.error[twin.name]
        found[:, 0] += self.shaken * np.sin(2.0 * np.pi * 30.0 * t)
        return Following(SPEC, t, rows, np.ones_like(rows), found, None, begins, 0.0 * rows)


def steps_of_codec() -> Any:
    from allegro_twin.drivers.can.codec.versions import make_codec
    from allegro_twin.hands.description.calibration import load_wiring

    return make_codec("v4", load_wiring().calibration)


@pytest.fixture
def sessions(monkeypatch: pytest.MonkeyPatch) -> Sessions:
    return Sessions(monkeypatch)


def rehearsal(folder: Path, protocol: RehearsalProtocol = SHORT, talk: Conversation | None = None) -> HandRehearsal:
    return HandRehearsal(RehearsedHand(load_config("can_virtual")), protocol, folder, "2026-11-26", talk)


def stop(error: BaseException) -> Callable[[], None]:
    def happen() -> None:
        raise error

    return happen


def read(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return content


def test_everything_is_done_in_order_and_a_person_is_asked_once_for_each_pose(
    tmp_path: Path, sessions: Sessions
) -> None:
    placed: list[str] = []
    result = rehearsal(tmp_path, talk=Conversation(place=lambda pose: placed.append(pose.name))).run()
    assert list(result["states"]) == NAMES
    assert set(result["states"].values()) == {"done"}
    assert placed == ["up", "palm-up"]
    assert result["problems"] == []
    assert result["hand_s"] == pytest.approx(82.0)
    assert read(tmp_path) == json.loads(json.dumps(result))
    assert [row["posture"] for row in result["identified"]["postures"]] == ["ok", "fist"]
    assert score_of(result["identified"])["pd"] == pytest.approx(2.0)
    assert "encoder_offset" in (tmp_path / "hand.yaml").read_text()
    assert "It has a cable." in (tmp_path / "report.html").read_text()


def test_what_an_identification_ends_with_is_said_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rms = {"nominal": 0.2, "written": 0.03, "determined": 0.4, "all": 0.04}
    errors = {name: np.full(16, each) for name, each in rms.items()}
    written = SimpleNamespace(errors=errors, seconds=3.5, is_nominal=False, source=("all",) * 16)
    fit = SimpleNamespace(spread=SimpleNamespace(residual=np.full(16, 9.0)))
    constant = SimpleNamespace(value=np.ones(16), half=np.ones(16))
    found = SimpleNamespace(fit=fit, written=written, values={"torque_constant": constant}, motions=())
    for name, made in (("identify_hand", found), ("write_hand_file", ""), ("report_page", ""), ("advice_on_gains", ""),
                       ("describe_terms", ["A lean."])):  # fmt: skip
        monkeypatch.setattr(steps_of, name, lambda *args, made=made, **options: made)
    said: list[str] = []
    own = rehearsal(tmp_path, talk=Conversation(say=said.append))
    own.steps = {f"excite {pose}": {"recordings": []} for pose in SHORT.poses}
    lines = own._identify()["lines"]
    assert lines == ["A lean.", *said]
    assert "nominal 200.0 mrad, written 30.0," in said[0]
    assert said[1].startswith("Not explained, 16 of 16 joints")


def test_encoders_are_read_with_the_offsets_that_the_ends_have_shown(tmp_path: Path, sessions: Sessions) -> None:
    own = rehearsal(tmp_path)
    own.run()
    np.testing.assert_allclose(own._twin("nominal").shift, -0.01, atol=1e-4)
    assert own._twin("identified").serial == str(tmp_path / "hand.yaml")
    assert not own._twin("identified").shift.any()


def test_an_interrupted_rehearsal_keeps_what_it_has_and_goes_on_there(tmp_path: Path, sessions: Sessions) -> None:
    sessions.at["excite palm-up"] = stop(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        rehearsal(tmp_path).run()
    found = read(tmp_path)
    assert [found["states"][name] for name in NAMES[2:5]] == ["done", "interrupted", "not begun"]
    assert "excite palm-up: interrupted: it was interrupted after 16.0 s of motion" in found["problems"]
    assert "excite palm-up: interrupted" in (tmp_path / "report.html").read_text()
    sessions.at.clear()
    sessions.done.clear()
    assert rehearsal(tmp_path).run()["problems"] == []
    assert sessions.done[:3] == ["checkup", "excite palm-up", "identify"]


def test_a_killed_rehearsal_says_which_step_it_was_in(tmp_path: Path, sessions: Sessions) -> None:
    def look() -> None:
        seen.update(read(tmp_path)["states"])

    seen: dict[str, str] = {}
    sessions.at["excite up"] = look
    rehearsal(tmp_path).run()
    assert (seen["ends"], seen["excite up"], seen["identify"]) == ("done", "interrupted", "not begun")


def test_what_is_done_is_not_done_again_but_for_the_checkup(tmp_path: Path, sessions: Sessions) -> None:
    rehearsal(tmp_path).run()
    sessions.done.clear()
    rehearsal(tmp_path).run()
    assert sessions.done == ["checkup"]


def test_a_hand_that_cannot_be_learned_is_still_judged_as_it_is_believed_to_be(
    tmp_path: Path, sessions: Sessions
) -> None:
    said: list[str] = []
    sessions.at["ends"] = stop(ConfigError("ring_0 did not move"))
    result = rehearsal(tmp_path, talk=Conversation(say=said.append)).run()
    assert said == ["ends: ring_0 did not move"]
    assert result["problems"][0] == "ends: failed: ring_0 did not move"
    assert result["problems"][1] == "excite up to excite palm-up (2 steps): skipped: it needs: ends"
    assert len(result["nominal"]["postures"]) == 2
    assert result["identified"]["postures"] == []
    assert result["states"]["identified palm-up fist pd"] == "skipped"


def test_a_hand_in_another_pose_moves_no_further_in_it(tmp_path: Path, sessions: Sessions) -> None:
    said: list[str] = []
    sessions.at["excite palm-up"] = stop(WrongPose("the hand's IMU is 90° off the pose 'palm-up'"))
    result = rehearsal(tmp_path, talk=Conversation(say=said.append)).run()
    assert said == ["excite palm-up: the hand's IMU is 90° off the pose 'palm-up'"]
    assert sessions.done == ["checkup", "ends", "excite up"]
    assert result["problems"][1:3] == [
        "identify: skipped: it needs: excite palm-up",
        "nominal palm-up ok pd to nominal palm-up trajectory fast pd feedforward (6 steps): "
        "skipped: the hand does not lie in the pose 'palm-up'",
    ]


def test_a_person_is_asked_to_lay_the_hand_anew_until_its_imu_agrees(tmp_path: Path, sessions: Sessions) -> None:
    asked: list[str] = []

    def lay(pose: ExcitationPose) -> bool:
        asked.append(pose.name)
        if len(asked) == 2:
            sessions.at.clear()
        return True

    sessions.at["ends"] = stop(WrongPose("the hand's IMU is 90° off the pose 'up'"))
    assert rehearsal(tmp_path, talk=Conversation(again=lay)).run()["problems"] == []
    assert asked == ["up", "up"]
    assert sessions.done[:3] == ["checkup", "ends", "excite up"]


def test_a_guard_that_trips_ends_the_session_and_is_named(tmp_path: Path, sessions: Sessions) -> None:
    sessions.at["nominal palm-up fist"] = stop(HandFault("stopped: thumb_1 moves at 13 rad/s"))
    with pytest.raises(HandFault, match="13 rad/s"):
        rehearsal(tmp_path).run()
    found = read(tmp_path)
    assert "nominal palm-up fist pd: failed: stopped: thumb_1 moves at 13 rad/s" in found["problems"]
    assert found["states"]["nominal palm-up trajectory slow pd"] == "not begun"
    assert len(found["nominal"]["postures"]) == 1


def test_a_posture_that_is_not_reached_is_named_with_its_joints(tmp_path: Path, sessions: Sessions) -> None:
    sessions.error["nominal"] = 0.05
    problems = rehearsal(tmp_path).run()["problems"]
    assert len(problems) == 2
    assert problems[0].startswith("nominal palm-up ok pd: not reached: rad off: index_0 +0.05, ")


def test_a_posture_in_which_a_joint_oscillates_is_named_though_it_is_reached_on_average(
    tmp_path: Path, sessions: Sessions
) -> None:
    sessions.shaken = 0.01
    problems = rehearsal(tmp_path).run()["problems"]
    assert (
        "nominal palm-up ok pd: oscillates: index_0 ±10.0 mrad at 30 Hz; less damping may calm it, as of `gains: loose`"
        in (problems)
    )
    assert "±10.0 mrad at 30 Hz" in (tmp_path / "report.html").read_text()


def test_a_folder_of_another_config_or_protocol_is_refused(tmp_path: Path, sessions: Sessions) -> None:
    rehearsal(tmp_path).run()
    with pytest.raises(ConfigError, match="of another protocol"):
        rehearsal(tmp_path, RehearsalProtocol())
    with pytest.raises(ConfigError, match="of another config"):
        HandRehearsal(RehearsedHand(load_config("can_hidden")), SHORT, tmp_path)
    (tmp_path / "result.json").write_text("{}")
    with pytest.raises(RecordingError, match="no result of a rehearsal"):
        rehearsal(tmp_path)


def test_films_of_grasps_stand_on_the_page_and_what_was_lost_comes_first(
    tmp_path: Path, sessions: Sessions, monkeypatch: pytest.MonkeyPatch
) -> None:
    films, full = list[Path | None](), set[str]()

    def trial(own: RehearsedHand, scenario: str, serial: str, film: Path | None = None) -> TrialReport:
        films.append(film)
        if film is not None and scenario not in full:
            film.parent.mkdir(exist_ok=True)
            film.touch()
        return TrialReport(scenario != "mug", "", (), 0.0, 0.0, 0.0, {})

    monkeypatch.setattr(RehearsedHand, "trial", trial)
    wanted = replace(SHORT, grasps=("lemon", "mug"))
    hand = RehearsedHand(load_config("can_virtual"))
    result = HandRehearsal(hand, wanted, tmp_path / "filmed", films=True).run()
    names = [f"films/{twin}_{what}.mp4" for twin in ("nominal", "identified") for what in ("lemon", "mug")]
    assert films == [tmp_path / "filmed" / name for name in names]
    assert [row["film"] for twin in ("nominal", "identified") for row in result[twin]["grasps"]] == names
    page = (tmp_path / "filmed" / "report.html").read_text()
    assert page.index("nominal_mug.mp4") < page.index("identified_mug.mp4") < page.index("identified_lemon.mp4")
    HandRehearsal(hand, wanted, tmp_path / "plain").run()
    assert films[4:] == [None] * 4
    assert "<video" not in (tmp_path / "plain" / "report.html").read_text()
    later = HandRehearsal(hand, wanted, tmp_path / "plain", films=True).run()
    assert films[8:] == [tmp_path / "plain" / name for name in names], "what is done is done again for its film"
    assert later["states"] == result["states"]
    full.add("mug")  # Its disk is.
    later = HandRehearsal(hand, wanted, tmp_path / "full", films=True).run()
    lemon, mug = later["nominal"]["grasps"]
    assert (mug["held"], mug["text"], "film" in mug) == (False, "its film could not be written", False)
    assert "film" in lemon


def test_postures_are_held_in_poses_that_the_hand_can_have() -> None:
    assert RehearsalProtocol().tracking_poses() == ("palm-up", "side")
    assert RehearsalProtocol(poses={"up": 9.0}).tracking_poses() == ("up",)
    assert RehearsalProtocol(poses={"up": 9.0, "side": 9.0}).tracking_poses() == ("side",)


def test_the_page_says_when_there_are_no_hidden_hands_and_where_a_hand_stands_among_them(
    tmp_path: Path, sessions: Sessions
) -> None:
    result = rehearsal(tmp_path).run()
    assert NO_HANDS in rehearsal_page(result, None)
    hands = tuple({"identified": {"pd": value}} for value in (1.0, 3.0, 4.0))
    hidden = HiddenScores("Three hands.", hands)
    page = rehearsal_page(result, hidden)
    assert "Three hands." in page
    assert NO_HANDS not in page
    assert score_rows(result, hidden)[0] == [
        "postures under PD, mrad rms", "6.0", "2.0", "3.0 (1.0–4.0)", "better than 2 of 3",
    ]  # fmt: skip


def test_gains_without_an_integral_are_not_compared_under_pid(tmp_path: Path, sessions: Sessions) -> None:
    both = replace(SHORT, controllers=("pd", "pid"))
    config = load_config("can_virtual").changed(controller={"kind": "pd", "gains": "v4"})
    own = HandRehearsal(RehearsedHand(config), both, tmp_path / "v4")
    result = own.run()
    assert list(result["states"]) == NAMES
    assert "pid" not in score_of(result["identified"])
    assert own.notes == result["notes"]
    assert "the gains `v4` have no integral, so PID is PD with them" in (tmp_path / "v4" / "report.html").read_text()
    assert rehearsal(tmp_path / "own", both).run()["notes"] == []


def test_more_is_better_only_of_grasps() -> None:
    assert rank(2.0, [1.0, 3.0], "pd") == "better than 1 of 2"
    assert rank(100.0, [60.0, 100.0, 80.0], "held") == "better than 2 of 3"


def test_a_score_has_what_was_measured_and_nothing_else() -> None:
    rows: dict[str, Any] = {"postures": [{"controller": "pd", "error": [0.003, 0.004]}], "trajectories": [],
            "grasps": [{"held": True}, {"held": False}, {"closing_s": 1.0}]}  # fmt: skip
    assert score_of(rows) == {"pd": pytest.approx(1e3 * np.sqrt(12.5e-6)), "held": 50.0}
    rows = {"trajectories": [{"level": "slow", "rms": [0.002] * 16, "lag": 0.01}]}
    assert score_of(rows) == {"slow": pytest.approx(2.0), "lag_slow": pytest.approx(10.0)}


def test_scores_of_hidden_hands_are_read_or_absent(tmp_path: Path) -> None:
    path = tmp_path / "hands.json"
    assert hidden_scores(path) is None
    path.write_text('{"about": "One.", "hands": [{"identified": {"pd": 1.5}}]}')
    assert hidden_scores(path) == HiddenScores("One.", ({"identified": {"pd": 1.5}},))
    path.write_text("[]")
    with pytest.raises(RecordingError, match="has no scores"):
        hidden_scores(path)
