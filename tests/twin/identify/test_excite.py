"""Excitations: what they show, what they avoid, how the hand must lie, and how they go on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import ArrayLike

from allegro_twin.app import assemble
from allegro_twin.app.config import load_config
from allegro_twin.app.rig import SimulatedScene
from allegro_twin.app.serve_can import virtual_hands
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics import hand_kinematics
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.spec import Side
from allegro_twin.twin.identify import record_excitation
from allegro_twin.twin.identify.motions.excitation import find_pose, rehearse
from allegro_twin.twin.identify.motions.following import UnfollowedJoint, unfollowed_joints
from allegro_twin.twin.identify.pipeline import _motions
from allegro_twin.twin.identify.record_excitation import (
    describe_loss,
    numbered_files,
    pose_config,
    record_run,
    remaining_run,
    served_pose,
)
from allegro_twin.twin.identify.results.findings import describe_unfollowed
from allegro_twin.twin.identify.results.uncertainty import motion_coverage
from allegro_twin.types import HandState, Sample, TorqueCommand
from tests.surfaces.cli.conftest import Run
from tests.twin.identify import hidden


@pytest.mark.slow
def test_every_joint_creeps_and_runs_both_ways(side: Side) -> None:
    speed = rehearse(load_spec(side=side), find_pose("side", side), 0, 16.0).speed
    assert (speed.max(axis=0) > 0.5).all()
    assert (speed.min(axis=0) < -0.5).all()
    for sign in (-1.0, 1.0):
        creeping = (sign * speed > 0.005) & (sign * speed < 0.05)
        assert (creeping.sum(axis=0) * 0.003 > 0.2).all()


@pytest.mark.long
@pytest.mark.parametrize(("seed", "lies", "side"), [(500, "up", "right"), (11401, "palm-up", "left"),
                                                    (11802, "side", "left")])  # fmt: skip
def test_a_motion_that_touches_nothing_is_found_where_the_first_ones_touch(seed: int, lies: str, side: Side) -> None:
    """Three of 160 in which none of the first nine would do."""
    assert len(rehearse(load_spec(side=side), find_pose(lies, side), seed, 16.0).speed) > 5000


def test_a_pose_is_where_gravity_is_in_the_palm() -> None:
    assert find_pose("up", "right").gravity == (0.0, 0.0, -9.81)
    assert find_pose("palm-up", "left").gravity == (-9.81, 0.0, 0.0)
    right, left = find_pose("side", "right").gravity, find_pose("side", "left").gravity
    assert right == (0.0, -left[1], 0.0)
    with pytest.raises(ConfigError, match="did you mean 'palm-up'"):
        find_pose("palm-upp", "right")


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_instruction_of_a_pose_says_what_is_up_and_down_of_the_models_hand(side: Side) -> None:
    tips = {name: pose[0] for name, pose in hand_kinematics(load_spec(side=side)).fingertips(np.zeros(16)).items()}
    fingers = np.mean([tips[name] for name in ("index", "middle", "ring")], axis=0)
    across = tips["thumb"] - tips["ring"]  # From the little finger's side to the thumb's.

    def lower(pose: str, direction: ArrayLike) -> float:
        return float(np.array(find_pose(pose, side).gravity) @ np.asarray(direction))

    assert "the thumb's side down" in find_pose("side", side).instruction
    assert lower("side", across) > 0.0
    assert "its fingers pointing up" in find_pose("up", side).instruction
    assert lower("up", fingers) < 0.0
    assert "the palm looking up" in find_pose("palm-up", side).instruction
    assert lower("palm-up", [1.0, 0.0, 0.0]) < 0.0
    assert "the palm looking down" in find_pose("palm-down", side).instruction
    assert lower("palm-down", [1.0, 0.0, 0.0]) > 0.0


def test_a_hand_that_lies_otherwise_is_not_moved() -> None:
    find_pose("up", "right").check(np.array([0.5, 0.0, -9.7]))
    find_pose("up", "right").check(np.full(3, np.nan))
    with pytest.raises(ConfigError, match="IMU is 90° off the pose 'up': stand the hand upright"):
        find_pose("up", "right").check(np.array([-9.81, 0.0, 0.0]))


@pytest.mark.slow
def test_the_virtual_hand_lies_as_the_pose_says() -> None:
    for path, name in zip(hidden.recordings(), hidden.POSES, strict=True):
        gravity = load(path).columns["gravity"]
        np.testing.assert_allclose(gravity[-1], find_pose(name, "right").gravity, atol=0.01)
        assert load(path).meta["excitation"]["pose"] == name
        assert load(path).meta["calibration"]["torque_constant"] == [1.0] * 16


def test_what_was_interrupted_goes_on_in_a_file_of_its_own(tmp_path: Path) -> None:
    config = hidden.config()
    first = remaining_run(config, "up", 9.0, 0, tmp_path)
    assert first is not None

    def interrupt(t: float) -> None:
        if t > 2.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record_run(pose_config(config, first.pose), first, interrupt)
    rest = remaining_run(config, "up", 9.0, 0, tmp_path)
    assert rest is not None
    assert (rest.file.name, rest.seed != first.seed) == ("up_2.arrow", True)
    assert rest.seconds == pytest.approx(first.seconds - 2.0, abs=0.01)
    assert remaining_run(config, "up", 2.0, 0, tmp_path) is None
    for seconds in (2.0, 9.0):
        with pytest.raises(
            ConfigError, match=r"up_1.arrow has the motion of seed 0, not 5: give --seed 0, or another --out"
        ):
            remaining_run(config, "up", seconds, 5, tmp_path)


def kept(folder: Path, ticks: Iterable[int], side: Side = "right", serial: str = "", version: str = "v4") -> None:
    """A recording of the pose up that has these periods."""
    spec, still = replace(load_spec(side=side), serial=serial), np.zeros(16)
    samples = (
        Sample(HandState(0.003 * k, k, still, still, still, still, np.zeros(3)), TorqueCommand(still)) for k in ticks
    )
    meta = {"calibration": {"version": version}, "excitation": {"asked": 0}}
    for _ in record(samples, folder / "up_1.arrow", spec, 0.003, meta=meta):
        pass


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"side": "left"}, "a left v4 allegro hand, and this is a right v4 allegro hand"),
        ({"version": "v3"}, "a right v3 allegro hand, and this is a right v4 allegro hand"),
        ({"serial": "b"}, r"a right v4 allegro hand \(b\), and this is a right v4 allegro hand"),
    ],
)
def test_recordings_of_another_hand_are_not_taken_for_its_own(tmp_path: Path, other: dict[str, Any], said: str) -> None:
    kept(tmp_path, range(1500), **other)
    with pytest.raises(ConfigError, match=rf"up_1.arrow is of {said}: give another folder with -o"):
        remaining_run(hidden.config(), "up", 4.0, 0, tmp_path)


@pytest.mark.parametrize(
    ("ticks", "lost"),
    [
        (range(1500), ""),
        ([k for k in range(1500) if k % 25], ""),
        ([k for k in range(1500) if k % 10], "149 of 1499 periods are missing, up to 1 in a row"),
        ([k for k in range(1500) if not 700 <= k < 710], ""),
        ([k for k in range(1500) if not 700 <= k < 711], "11 of 1500 periods are missing, up to 11 in a row"),
    ],
)
def test_a_recording_that_lacks_too_many_periods_is_recorded_again(
    tmp_path: Path, ticks: Iterable[int], lost: str
) -> None:
    kept(tmp_path, ticks)
    assert describe_loss(load(tmp_path / "up_1.arrow")) == lost
    again = remaining_run(hidden.config(), "up", 4.0, 0, tmp_path)
    assert (again.file.name if again else "") == ("up_1.arrow" if lost else "")


@pytest.mark.parametrize("damage", ["foreign", "head", "first row"])
def test_a_file_that_cannot_be_read_stays_and_is_named(tmp_path: Path, damage: str) -> None:
    kept(tmp_path, range(1500))
    file = tmp_path / "up_1.arrow"
    content = file.read_bytes()
    with file.open("r+b") as damaged:
        if damage == "foreign":
            damaged.truncate(0)
            damaged.write(b"notes of mine")
        else:
            damaged.seek(20 if damage == "head" else content.index(b"ARROW:", 0) if b"ARROW:" in content else 4000)
            damaged.write(bytes(400) if damage == "head" else b"\xff" * 4000)
    before = file.read_bytes()
    with pytest.raises(ConfigError, match=r"up_1.arrow.*: move the file out of .*, or give another --out"):
        remaining_run(hidden.config(), "up", 4.0, 0, tmp_path)
    assert file.read_bytes() == before


def test_a_file_of_a_process_that_ended_before_its_first_row_makes_room(tmp_path: Path) -> None:
    kept(tmp_path, [])
    job = remaining_run(hidden.config(), "up", 4.0, 0, tmp_path)
    assert job is not None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["up_mine", "up_1_copy", "up_"])
def test_a_copy_with_a_name_of_its_own_is_not_taken_for_a_recording_of_the_pose(tmp_path: Path, name: str) -> None:
    kept(tmp_path, range(1500))
    (tmp_path / "up_1.arrow").rename(tmp_path / f"{name}.arrow")
    job = remaining_run(hidden.config(), "up", 4.0, 0, tmp_path)
    assert job is not None
    assert job.file.name == "up_1.arrow"


def test_the_tenth_recording_of_a_pose_comes_after_the_second(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        (tmp_path / f"up_{number}.arrow").touch()
    assert list(numbered_files("up", tmp_path)) == [1, 2, 10]


def test_a_recording_of_no_use_is_an_error_that_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = hidden.config()
    job = remaining_run(config, "up", 4.0, 0, tmp_path)
    assert job is not None

    def late(samples: Iterable[Sample], *rest: Any, **more: Any) -> Iterator[Sample]:
        return record((sample for number, sample in enumerate(samples) if number % 2), *rest, **more)

    monkeypatch.setattr(record_excitation, "record", late)
    with pytest.raises(RecordingError, match=r"up_1.arrow is of no use: \d+ of \d+ periods are .* quieter computer"):
        record_run(pose_config(config, job.pose), replace(job, seconds=0.5), lambda t: None)
    assert remaining_run(config, "up", 4.0, 0, tmp_path) == job


def test_only_a_hand_on_a_bus_has_a_drive() -> None:
    with pytest.raises(ConfigError, match="a sim hand has no drive to find"):
        pose_config(load_config("sim_right"), find_pose("up", "right"))


@pytest.mark.parametrize("name", ["up", "side", "palm-up", "palm-down"])
def test_a_served_hand_stands_alone_in_the_pose_that_is_asked_for(name: str) -> None:
    scenes: list[SimulatedScene] = []
    config = served_pose(load_config("can_pty"), find_pose(name, "right"))
    hands = virtual_hands([config], step=None, scenes=scenes, restart=True)
    with closing(hands):
        measured = hands.firmwares[0].backend.reset().gravity
    np.testing.assert_allclose(measured, find_pose(name, "right").gravity, atol=1e-9)
    assert scenes[0].trial is None


@pytest.mark.parametrize("version", ["v1", "v2", "v3", "v4", "v5", "v5plus"])
def test_a_virtual_hand_of_any_version_is_put_into_a_pose_and_knows_where_down_is(version: str) -> None:
    pose = find_pose("side", "right")
    config = load_config("can_virtual").changed(backend={"version": version, "imu": 0.0})
    rig = assemble(pose_config(config, pose))
    with closing(rig.backend):
        np.testing.assert_allclose(rig.backend.reset().gravity, pose.gravity, atol=1e-3)


def test_a_hand_that_is_not_served_stands_in_no_pose() -> None:
    with pytest.raises(ConfigError, match="a replay hand is not served"):
        served_pose(load_config("replay"), find_pose("up", "right"))


def test_the_commands_say_what_to_do(command: Run, tmp_path: Path, recording_path: Path) -> None:
    code, _, error = command("excite", "sim_right", "--pose", "up", "-o", tmp_path)
    assert (code, error.count("\n")) == (2, 1)
    code, _, error = command("excite", "can_virtual", "--pose", "upp", "-o", tmp_path)
    assert code == 2
    assert "did you mean 'up'" in error
    code, _, error = command("identify", recording_path)
    assert code == 2
    assert "record it again through the hand's bus" in error


def test_a_missing_scipy_is_named_with_the_extra_that_brings_it(
    command: Run, monkeypatch: pytest.MonkeyPatch, recording_path: Path
) -> None:
    from allegro_twin.surfaces.cli.twin import identification

    monkeypatch.setattr(identification, "find_spec", lambda name: None)
    for name in ("identify", "gap", "mirror"):
        code, _, error = command(name, recording_path)
        assert (code, "pip install 'allegro-twin[twin]'" in error) == (2, True)


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    from tests.surfaces.cli import conftest

    return conftest.command.__wrapped__(capsys, monkeypatch)  # type: ignore[no-any-return,attr-defined]


def _played(change: Callable[[Any, Any], None]) -> list[UnfollowedJoint]:
    """The joints that did not follow in a recording whose positions were changed: (t, position)."""
    recording = load(hidden.recording("up"))
    t, position = recording.columns["t"], recording.columns["position"].copy()
    change(t, position)
    return unfollowed_joints(recording.spec, recording.meta["excitation"], t, position)


def _freeze(t: Any, position: Any) -> None:
    position[t >= 2.5, 6] = position[t >= 2.5, 6][0]


def _die(t: Any, position: Any) -> None:
    position[:, 7] = position[0, 7] + 0.02 * np.sin(t)


def _run_away(t: Any, position: Any) -> None:
    position[:, 2] = 1.709 + 1e-4 * np.sin(30.0 * t)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "joint", "said"),
    [
        (_freeze, 6, "it reported the same position for 4.0 s: its encoder hangs, or it stands still"),
        (_die, 7, "it moved by 0.0"),
        (_run_away, 2, "it stood at its upper end: its motor or its encoder is reversed"),
    ],
)
def test_a_joint_that_does_not_follow_the_excitation_is_named_with_what_it_did(
    change: Callable[[Any, Any], None], joint: int, said: str
) -> None:
    (found,) = _played(change)
    assert found.joint == joint
    assert found.off > 0.1
    assert said in found.sentence(load_spec())
    assert not _played(lambda t, position: None)


@pytest.mark.slow
def test_nothing_is_told_of_a_joint_that_did_not_follow_nor_of_its_finger(command: Run, tmp_path: Path) -> None:
    """The motor of middle_3 is dead. `excite` says so, and `identify` names it as the cause."""
    strength = {"strength": [1e-3 if k == 7 else 1.0 for k in range(16)]}
    path = tmp_path / "dead.yaml"
    path.write_text(yaml.safe_dump(hidden.config(drive=strength).model_dump(mode="json", exclude_unset=True)))
    code, _, errors = command("excite", path, "--pose", "up", "--seconds", "5", "-o", tmp_path, "--yes")
    assert code == 0, errors
    assert "middle_3 did not follow what it was told: for 1 s it was 0." in errors
    assert "`identify` writes nothing of it" in errors
    motions = _motions([tmp_path / "up_1.arrow"], [])
    assert [joint for joint, _ in motions[0].unfollowed] == [7]
    assert not motions[0].good[:, 7].any()
    looked = motion_coverage(motions, OpenLoopPlayer(motions[0].spec, 0.003)).unfollowed
    assert looked[7].startswith("it did not follow what it was told (up_1.arrow): for 1 s it was 0.")
    assert set(looked[4:7]) == {"middle_3 of its finger did not follow what it was told"}
    assert not any(looked[:4] + looked[8:])
    assert next(iter(describe_unfollowed(motions))).startswith("middle_3 did not follow what it was told, and nothing")
