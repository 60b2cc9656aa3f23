"""What `mirror` says: of a file that does not fit, of joints that feel little, and of a run that ends early."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from allegro_twin.recording.reader import load
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.cli.twin.mirror_run import lines, misfit, other_name, sensitivity
from allegro_twin.twin.mirror.contact_detection import Contact
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.faults import Fault, FaultName, FaultReport
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.twin.mirror.on_recording import FreeMotion, MirrorResult, possible_cause
from allegro_twin.types import Sample, Vector
from tests.surfaces.cli.conftest import Run
from tests.surfaces.cli.conftest import command as command
from tests.twin import plugin_hand
from tests.twin.free_motion import free_motion

N = 16


@pytest.fixture(scope="module")
def free(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return free_motion(tmp_path_factory.mktemp("free") / "free.arrow")


@pytest.mark.slow
def test_a_file_that_fits_says_nothing_but_what_it_found(free: Path, command: Run) -> None:
    code, shown, errors = command("mirror", free, "--free", free)
    assert (code, shown.rstrip().splitlines()[-1]) == (0, "Nothing touched it.")
    assert "does not fit" not in errors


@pytest.mark.slow
def test_a_file_of_another_hand_is_said_before_any_verdict_and_no_free_motion_learns_it_away(
    free: Path, tmp_path: Path, command: Run
) -> None:
    file = tmp_path / "other.yaml"
    file.write_text("wire: {torque_constant: 1.4}\nactuation: {frictionloss: 0.06, damping: 0.03}\n")
    code, shown, errors = command("mirror", free, "--free", free, "--hand", file)
    assert code == 0
    assert f"{file} does not fit the hand in {free}: in free motion it leaves " in errors
    assert " times what noise explains (" in errors
    assert "Nothing touched it" not in shown
    assert "No touch was felt, which says little: " in shown
    assert " N at the tip)" in shown or "blind to touches are" in shown


def test_a_card_of_another_model_is_no_file_of_a_hand(free: Path, command: Run) -> None:
    for name in ("mirror", "gap"):
        code, _, errors = command(name, free, "--hand", "leap")
        assert (code, errors.count("\n")) == (2, 1)
        assert "leap.yaml is not of one allegro: it says what every leap is" in errors


@pytest.mark.parametrize(
    ("other", "said"), [({"side": "left"}, "its side is left"), ({"version": "v3"}, "its version is v3")]
)
def test_a_free_motion_of_another_hand_is_refused(
    free: Path, tmp_path: Path, command: Run, other: dict[str, str], said: str
) -> None:
    there = free_motion(tmp_path / "there.arrow", **other)  # type: ignore[arg-type]
    code, _, errors = command("mirror", free, "--free", there)
    assert (code, f"--free {there} is of another hand: {said}" in errors) == (2, True)


def test_a_free_motion_of_a_hand_with_another_name_is_said(spec: HandSpec) -> None:
    calm = Thresholds.default(spec)
    free = FreeMotion(calm, np.ones(N), np.full(N, 0.002), "", Path("free.arrow"), "b.yaml")
    assert other_name(free, replace(spec, serial="a.yaml")) == (
        "free.arrow is of the hand b.yaml, and this is a.yaml: are they one hand?"
    )
    assert not other_name(free, replace(spec, serial="b.yaml"))
    assert not other_name(free, spec)  # Excited before it had a file.
    assert not misfit(free, spec)


def test_a_recording_is_copied_with_the_columns_of_its_mirror(free: Path, tmp_path: Path, command: Run) -> None:
    code, _, errors = command("mirror", free, "--record", tmp_path / "m.arrow")
    assert code == 0, errors
    before, after = load(free), load(tmp_path / "m.arrow")
    for name, column in before.columns.items():
        np.testing.assert_array_equal(after.columns[name], column)
    assert after.columns["event"].shape == (len(before), 4 + N)
    assert after.meta["excitation"] == before.meta["excitation"]
    code, _, errors = command("mirror", free, "--record", free)
    assert (code, "that is the recording itself" in errors) == (2, True)
    assert len(load(free)) == len(before)


def test_a_cut_recording_is_mirrored_as_far_as_it_goes(free: Path, tmp_path: Path, command: Run) -> None:
    (tmp_path / "cut.arrow").write_bytes(free.read_bytes()[:-2000])
    assert command("mirror", tmp_path / "cut.arrow")[0] == 2
    code, shown, errors = command("mirror", tmp_path / "cut.arrow", "--partial")
    assert (code, "s beside the model" in shown) == (0, True), errors


@pytest.mark.parametrize(("ends", "code", "said"), [("ctrl-c", 130, ""), ("silent", 3, "the bus is down")])
def test_a_run_that_ends_early_says_what_was_found_until_then(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch, ends: str, code: int, said: str
) -> None:
    plugin_hand.install(monkeypatch)
    config = tmp_path / "theirs.yaml"
    config.write_text(f"backend: {{kind: theirs, ends: {ends}}}\ncontroller: {{kind: pd}}\nseconds: 3.0\n")
    ended, shown, errors = command("mirror", config, "--record", tmp_path / "r.arrow")
    assert (ended, said in errors) == (code, True)
    assert "1.5 s beside the model" in shown
    assert "Nothing touched it." in shown
    assert load(tmp_path / "r.arrow").columns["t"][-1] == pytest.approx(1.5, abs=0.01)


def result(spec: HandSpec, above: Vector, *faults: FaultReport) -> MirrorResult:
    t = np.linspace(0.0, 2.0, 200)
    none, rows = np.zeros((200, N)), np.tile(above, (200, 1))
    return MirrorResult(t, none, none, rows, (), faults)


def test_joints_that_feel_late_and_joints_that_are_blind_are_named(spec: HandSpec) -> None:
    above = np.full(N, 0.010)
    assert sensitivity(result(spec, above), spec) == ""
    above[2] = 0.111
    said = sensitivity(result(spec, above), spec)
    assert said.startswith("nothing is felt at index_2 under 111 mN·m (about ")
    newtons = float(said.partition("(about ")[2].partition(" N")[0])
    assert newtons == pytest.approx(0.111 / 0.06, rel=0.35)  # The two outer links are 6 cm long.
    above[8] = 0.6 * spec.actuation.torque_limit[8]
    (line,) = lines(result(spec, above), spec)
    assert line.startswith("No touch was felt, which says little: nothing is felt at index_2 under 111 mN·m")
    assert "blind to touches are ring_0: " in line


def test_a_torque_that_no_motor_gives_is_said_to_be_one(spec: HandSpec) -> None:
    impact, wrong = "more than its motors give: an impact, or a stop", "an encoder or motor of the wrong sign"
    for torque, end, said in ((0.3, 1.5, ""), (4.48, 1.5, impact), (4.48, 9.0, wrong), (0.3, 9.0, "")):
        found = replace(result(spec, np.full(N, 0.010)), contacts=(Contact("index", 1.0, end, torque, 2),))
        line, *_ = lines(found, spec)
        assert [each for each in (impact, wrong) if each in line] == ([said] if said else [])


def test_what_looks_like_a_touch_of_a_finger_with_a_joint_whose_place_is_unknown_may_be_because_of_that(
    spec: HandSpec,
) -> None:
    before, after = (Contact("index", begin, begin + 0.5, 0.1, 2) for begin in (0.5, 7.0))
    for name, ended, causes in (("stuck", np.inf, 2), ("stuck", 5.0, 1), ("weak", np.inf, 1), ("weak", 5.0, 0)):
        report = FaultReport(Fault(cast("FaultName", name), 3, 0.1), 0.9, 1.234, ended)
        assert sum(possible_cause(each, [report], spec) is report for each in (before, after)) == causes


def test_what_is_wrong_is_said_with_the_time_at_which_it_got_its_name(spec: HandSpec) -> None:
    _, line = lines(result(spec, np.full(N, 0.010), FaultReport(Fault("stuck", 3, 0.1), 0.9, 1.234)), spec)
    said = "index_3 does not follow its motor: it is stuck, its motor is dead, or its encoder repeats a value"
    assert line == f"Something is wrong: {said} (since 0.90 s, named at 1.23 s)."


def stopped_after(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes while the mirror observes a row."""
    observe, seen = Mirror.observe, iter(range(10**6))

    def one(mirror: Mirror, sample: Sample) -> None:
        if next(seen) == rows:
            raise KeyboardInterrupt
        observe(mirror, sample)

    monkeypatch.setattr(Mirror, "observe", one)


def test_a_mirror_of_a_recording_that_is_interrupted_tells_what_it_found_and_keeps_a_whole_copy_of_it(
    free: Path, tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "copy.arrow"
    stopped_after(901, monkeypatch)
    code, shown, errors = command("mirror", free, "--record", copy)
    assert (code, "2.7 s beside the model" in shown) == (130, True)
    assert f"interrupted: what came until then is in {copy}" in " ".join(errors.split())
    assert (len(load(copy)), load(copy).complete) == (901, True)


def test_a_mirror_without_files_that_is_interrupted_says_that_its_table_is_of_what_came_until_then(
    free: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped_after(901, monkeypatch)
    code, shown, errors = command("mirror", free)
    assert (code, "2.7 s beside the model" in shown) == (130, True)
    assert "interrupted: what is shown is what came until then" in " ".join(errors.split())


def test_a_mirror_of_a_hand_that_is_interrupted_names_its_files(
    tmp_path: Path, command: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "run.arrow"
    stopped_after(301, monkeypatch)
    code, shown, errors = command("mirror", "can_virtual", "--record", copy)
    assert (code, "0.9 s beside the model" in shown) == (130, True)
    assert f"interrupted: what came until then is in {copy}" in " ".join(errors.split())
    assert load(copy).complete
