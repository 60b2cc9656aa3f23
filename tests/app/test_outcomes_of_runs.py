"""A run says whether it did what it was for, by where the joints truly are, and refuses a period that cannot do it."""

from __future__ import annotations

from pathlib import Path

import pytest

from allegro_twin.app import assemble, references
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.session import REACHED, Outputs, perform
from allegro_twin.backend import torque_of
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.batch.trials import TrialRunner
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_posture
from allegro_twin.hands.limits import check_period
from allegro_twin.recording.reader import load
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import Array, Command
from tests.surfaces.cli.conftest import Run, command

__all__ = ["command"]
TORQUE = ("allegro",)
OWN_LOOP = ("leap", "model_o", "sih", "qb_softhand")
POSE = "backend: {kind: sim}\ntask: {posture: home}\ncontroller: {kind: pid}\n"


def outcome(config: RunConfig) -> str:
    return perform(assemble(config), config, Outputs()).missed


@pytest.mark.parametrize("config", ["sim_right", "sim_left", "can_virtual", "sim_leap", "sim_model_o", "sim_sih"])
def test_a_posture_that_is_reached_is_a_run_that_did_what_it_was_for(config: str) -> None:
    assert outcome(load_config(config)) == ""


def from_fist_to_rock() -> RunConfig:
    """Their straight line leads the thumb through the index finger."""
    config = load_config("sim_right")
    return config.changed(backend={"start": "fist"}, task={"posture": "rock"}, seconds=None)


def test_a_replay_is_not_recorded_over_the_recording_that_it_plays(tmp_path: Path, recording_path: Path) -> None:
    whole = recording_path.read_bytes()
    config = RunConfig.model_validate(
        {"backend": {"kind": "replay", "file": recording_path}, "controller": {"kind": "torque"}}
    )
    with pytest.raises(ConfigError, match=r"--record .*: that is the recording itself; name another file"):
        perform(assemble(config), config, Outputs(record=recording_path))
    assert recording_path.read_bytes() == whole
    perform(assemble(config), config, Outputs(record=tmp_path / "other.arrow"))
    assert len(load(tmp_path / "other.arrow"))


def test_a_planned_posture_that_is_not_reached_is_one_when_seconds_end_it_too() -> None:
    content = {
        "backend": {"kind": "sim"}, "seconds": 0.2,
        "task": {"posture": "ok", "episode": {"task": "Reach", "environment": {"timestep": 0.003}}},
        "controller": {"kind": "mpc", "planning": {"samples": 4, "iterations": 1}},
    }  # fmt: skip
    config = RunConfig.model_validate(content)
    assert perform(assemble(config), config, Outputs()).failed


def test_fingers_go_around_each_other_to_a_posture() -> None:
    assert outcome(from_fist_to_rock()) == ""


def test_a_live_hand_is_limp_until_its_path_is_known_and_has_as_much_time_as_any(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    config, torques = from_fist_to_rock(), list[Array]()
    monkeypatch.setattr(SimBackend, "live", True)
    rig = assemble(config)
    assert rig.seconds is not None
    write = SimBackend.write

    def seen(backend: SimBackend, command: Command) -> None:
        torques.append(torque_of(command, rig.spec))
        write(backend, command)

    monkeypatch.setattr(SimBackend, "write", seen)
    found = perform(rig, config, Outputs(record=tmp_path / "r.arrow"))
    limp = next(k for k, torque in enumerate(torques) if torque.any())
    assert limp > 0
    first, *_, last = load(tmp_path / "r.arrow").columns["t"]
    assert first == pytest.approx(0.003 * limp, abs=0.004)
    assert last - first == pytest.approx(rig.seconds, abs=0.004)
    assert found.missed == ""


def test_a_motion_that_takes_longer_than_a_straight_one_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(references, "_longest", lambda spec, speed: 0.0)
    config = from_fist_to_rock()
    assert outcome(config) == ""
    assert outcome(config.changed(seconds=1.0)).startswith("rock is not reached at 1.0 s")


def test_a_posture_that_the_hand_cannot_have_is_refused_before_it_moves(command: Run, tmp_path: Path) -> None:
    crossed = load_posture("rock", load_spec()).tolist()
    crossed[12:] = load_posture("fist", load_spec()).tolist()[12:]
    crossed[0:4] = [0.0, 1.5, 1.6, 1.6]
    (tmp_path / "p.yaml").write_text(POSE.replace("home", str(crossed)))
    code, _, said = command("run", tmp_path / "p.yaml", "--record", tmp_path / "r.arrow")
    assert (code, said.count("\n")) == (2, 1)
    assert "mm inside each other" in said


def test_a_hand_without_the_torque_for_it_misses_its_posture_and_the_joints_are_named() -> None:
    config = load_config("sim_right").changed(limits={"torque": 0.01})
    said = outcome(config)
    assert said.startswith("home is not reached at 3.0 s: rad short: ")
    assert "thumb_0 " in said
    assert f"(more than {REACHED:g})" in said


def test_a_joint_that_reports_another_position_than_it_has_is_judged_by_the_one_it_has() -> None:
    """An encoder that drifts by 6° while the hand moves: what it reports is where it was to be."""
    config = load_config("can_virtual").changed(
        backend={"faults": {"script": [{"at": 0.5, "what": "encoder_drift", "which": 6, "amount": 0.05}]}}
    )
    assert "middle_2 0.1" in outcome(config)


def test_the_command_line_ends_with_5_and_one_line(command: Run, tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(POSE + "seconds: 0.3\n")
    code, _, said = command("run", tmp_path / "p.yaml", "--out", tmp_path / "f")
    assert code == 5
    assert said.count("\n") == 1
    assert "p, right hand: home is not reached at 0.3 s: rad short: " in said
    assert "; the motion takes " in said
    assert (tmp_path / "f" / "p.arrow").exists()  # It was what it was.
    (tmp_path / "p.yaml").write_text(POSE + "seconds: 3.0\n")
    assert command("run", tmp_path / "p.yaml")[0] == 0


def test_a_run_that_the_command_line_ends_before_its_motion_is_over_is_not_judged(command: Run) -> None:
    code, _, said = command("run", "sim_right", "--seconds", "0.3")
    assert (code, said) == (0, "sim_right, right hand: --seconds ended the motion at 0.3 s; it takes 1.6 s\n")


def test_a_recording_is_played_whatever_happened_in_it(command: Run, tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(POSE + "seconds: 0.3\n")
    assert command("run", tmp_path / "p.yaml", "--record", tmp_path / "r.arrow")[0] == 5
    (tmp_path / "again.yaml").write_text(POSE.replace("kind: sim", f"kind: replay, file: {tmp_path}/r.arrow"))
    assert command("run", tmp_path / "again.yaml")[0] == 0


def test_a_trial_without_its_end_is_refused_before_anything_is_recorded(command: Run, tmp_path: Path) -> None:
    for where in (["--record", tmp_path / "x.arrow"], ["--out", tmp_path / "f"]):
        code, _, said = command("run", "lemon", "--seconds", "0.3", *where)
        assert (code, said.count("\n")) == (2, 1)
        assert "the trial takes 12.5 s, and without its end there is no verdict" in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("model", TORQUE + OWN_LOOP)
@pytest.mark.parametrize("period", [0.2, 0.5, 3, 20, 1000])
def test_a_period_that_cannot_drive_a_hand_is_refused(model: str, period: float) -> None:
    with pytest.raises(ConfigError, match=rf"period {period:g} s: {model}_right needs .* at least"):
        check_period(period, load_spec(model))


@pytest.mark.parametrize(("model", "period"), [("allegro", 3.0), ("allegro", 4.0), ("leap", 20.0), ("sih", 33.0)])
def test_a_period_in_milliseconds_has_the_hint(model: str, period: float) -> None:
    with pytest.raises(ConfigError, match=rf"in seconds: {period:g} ms is {period / 1000:g}"):
        check_period(period, load_spec(model))


def test_given_torques_close_no_loop_and_may_come_more_slowly() -> None:
    check_period(0.02, load_spec(), "torque")
    with pytest.raises(ConfigError, match=r"period 0\.2 s: allegro_right needs torques every 0\.1 s at least"):
        check_period(0.2, load_spec(), "torque")
    with pytest.raises(ConfigError, match=r"needs its joints' loop every 0\.01 s"):
        check_period(0.02, load_spec(), "gravity")


def test_every_door_refuses_it(tmp_path: Path) -> None:
    for name in ("sim_right", "can_virtual", "leap_virtual", "sih_virtual", "sim_qb_softhand"):
        with pytest.raises(ConfigError, match=r"it is in seconds: 3 ms is 0\.003"):
            assemble(load_config(name).changed(period=3.0))
    with pytest.raises(ConfigError, match=r"4 ms is 0\.004"):
        TrialRunner(load_spec(), period=4.0)


@pytest.mark.parametrize("name", ["sim_right", "leap_virtual", "qb_softhand_virtual", "sih_virtual"])
def test_the_periods_that_are_shipped_are_taken(name: str) -> None:
    config = load_config(name)
    check_period(config.period, load_spec(config.hand.model))
