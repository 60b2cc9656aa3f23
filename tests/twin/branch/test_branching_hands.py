"""A recording of a hand on a wire goes on as its model does, and says what that rests on."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import assemble
from allegro_twin.app.session import Outputs, perform, recording_meta
from allegro_twin.control.controllers import PD, PositionControl
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.surfaces.cli.twin import branch_run
from allegro_twin.twin.branch.assumptions import list_collisions
from allegro_twin.twin.branch.result import BranchOptions, BranchResult
from allegro_twin.twin.branch.what_if import branch_recording
from allegro_twin.types import Sample, Vector
from tests.conftest import MakeSim
from tests.twin.branch.hands import AT, MRAD, after, as_real, rms


@pytest.mark.parametrize("loop", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_without_a_change_the_model_goes_where_the_hand_went_and_the_nominal_one_does_not(
    made: Path, own: str, tmp_path: Path, loop: bool
) -> None:
    found = branch_recording(made, AT, {}, options=BranchOptions(own, open_loop=loop))
    rest = after(found)
    np.testing.assert_array_equal(found.branched[: rest.start + 1], found.recorded[: rest.start + 1])
    np.testing.assert_array_equal(found.branched, found.unchanged)
    assert 0.0 < np.abs(found.branched - found.recorded).max() < 1.5 * MRAD
    nominal = branch_recording(
        as_real(made, tmp_path / "real.arrow"), AT, {}, options=BranchOptions("", open_loop=loop)
    )
    off = [rms((each.branched - each.recorded)[rest]) for each in (found, nominal)]
    assert off[1] > (10.0 if loop else 4.0) * off[0]


@pytest.mark.parametrize(
    "change",
    [
        {"strength": 0.5},
        *(
            pytest.param(each, marks=pytest.mark.slow)
            for each in ({"controller.gains": "v4"}, {"frictionloss": 0.15}, {"damping": 0.3})
        ),
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_change_does_to_the_model_what_it_does_to_the_hand(made: Path, own: str, change: dict[str, Any]) -> None:
    """The hand is hidden but can be repeated: its own future, with the change, is known."""
    model, hand = branch_recording(made, AT, change, options=BranchOptions(own)), branch_recording(made, AT, change)
    assert model.unchanged is not None
    rest = after(model)
    foretold, true = (model.branched - model.unchanged)[rest], (hand.branched - hand.recorded)[rest]
    assert rms(true) > 1.5 * MRAD
    assert rms(foretold - true) < 0.15 * rms(true)
    assert rms(model.unchanged[rest] - model.recorded[rest]) < 0.3 * MRAD


@pytest.mark.slow
def test_encoders_that_are_noisy_loosen_the_models_friction_as_they_did_the_hands(
    hidden: RunConfig, own: str, tmp_path: Path
) -> None:
    assert isinstance(hidden.backend, CanSettings)
    assert hidden.backend.scene is not None
    scene = hidden.backend.scene.model_dump(exclude_unset=True)
    scene["truth"]["drive"] |= {"encoder_noise": 3e-4}
    path, config = tmp_path / "noisy.arrow", hidden.changed(backend={"scene": scene})
    perform(assemble(config), config, Outputs(record=path))
    change = {"controller.gains": "v4"}
    model, hand = branch_recording(path, AT, change, options=BranchOptions(own)), branch_recording(path, AT, change)
    assert model.unchanged is not None
    rest = after(model)
    foretold, true = (model.branched - model.unchanged)[rest], (hand.branched - hand.recorded)[rest]
    assert rms(foretold - true) < 0.07 * rms(true)


@pytest.mark.slow
def test_the_host_of_the_model_hears_counts_and_speeds_as_it_did_of_the_hand(
    made: Path, own: str, tmp_path: Path
) -> None:
    branch_run.run_branch(made, AT, [], branch_run.BranchOutputs(tmp_path / "if.arrow"), BranchOptions(own))
    was, would = load(made).columns, load(tmp_path / "if.arrow").columns
    row = int(np.searchsorted(was["t"], AT - 1e-9))
    for name in ("t", "tick", "position", "velocity", "gravity"):
        np.testing.assert_array_equal(would[name][: row + 1], was[name][: row + 1])
    np.testing.assert_array_equal(would["target"], was["position"])
    np.testing.assert_allclose(would["velocity"][row:], was["velocity"][row:], atol=0.06)
    np.testing.assert_allclose(would["command_torque"][row], was["command_torque"][row], atol=1e-12)
    steps = np.diff(np.unique(was["position"][:, 3]))
    counts = (would["position"][:, 3] - was["position"][0, 3]) / steps.min()
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)


@pytest.mark.slow
def test_where_another_than_its_config_drove_the_recorded_commands_go_on(
    hidden: RunConfig, own: str, tmp_path: Path
) -> None:
    rig, path = assemble(hidden), tmp_path / "other.arrow"
    moves = Moves([Waypoint(load_posture(name, rig.spec), seconds=0.8) for name in ("home", "rock", "home")])
    with closing(rig.backend):
        samples = until(2.4, run(rig.backend, PD(moves, load_gains("v4", rig.spec))))
        for _ in record(samples, path, rig.spec, hidden.period, meta=recording_meta(rig, hidden)):
            pass
    found = branch_recording(path, AT, {"frictionloss": 0.08}, options=BranchOptions(own))
    assert any("The recorded commands go on, open loop: its config's pid would" in line for line in found.notes)
    assert found.unchanged is not None
    rest = after(found)
    assert rms((found.unchanged - found.recorded)[rest]) < 1.0 * MRAD
    assert rms((found.branched - found.unchanged)[rest]) > 20.0 * MRAD
    with pytest.raises(ConfigError, match="--set controller.gains: only commands of .* go on: its config's pid would"):
        branch_recording(path, AT, {"controller.gains": "v4"}, options=BranchOptions(own))
    with pytest.raises(ConfigError, match="differs at .* With --hand FILE a model goes on"):
        branch_recording(path, AT, {})


@pytest.mark.slow
def test_what_is_known_estimated_and_assumed_is_said(made: Path, own: str, tmp_path: Path) -> None:
    held = branch_recording(made, AT, {}, options=BranchOptions(own, "hold"))
    assert held.notes[0].startswith("Known at 1.1 s: the joints' positions and commands. Estimated by a mirror")
    assert held.notes[1].startswith("Assumed: nothing is held or touched, what pushes the joints is held as it is")
    assert held.notes[2].startswith("Its config's pid goes on, closed loop: it computes every recorded command again")
    assert len(held.notes) == 3
    real = as_real(made, tmp_path / "real.arrow", config=None)
    found = branch_recording(real, AT, {}, options=BranchOptions(own))
    assert "what pushes the joints is forgotten" in found.notes[1]
    assert (
        found.notes[2] == f"The recorded commands go on, open loop: {real} does not say with which config it was made."
    )
    lines = list(branch_run.lines(found, AT))
    assert lines[-1].startswith("Without the change the model is off by 0.")
    assert lines[-1].endswith("; nothing was changed.")
    assert next(branch_run.warnings(real, BranchOptions())) == (
        f"no --hand: {real} goes on with the nominal allegro_right, not with its own hand"
    )
    assert not any(branch_run.warnings(real, BranchOptions(own)))
    assert not any(branch_run.warnings(made, BranchOptions()))
    slight = branch_recording(made, AT, {"strength": 0.9999}, options=BranchOptions(own))
    assert list(branch_run.lines(slight, AT))[-1].endswith("hardly more than the model is off by, so nothing follows.")


@pytest.mark.slow
def test_a_push_at_the_instant_is_said_and_held_or_forgotten(hidden: RunConfig, own: str, tmp_path: Path) -> None:
    path, push = tmp_path / "pushed.arrow", np.zeros(16)
    push[9] = 0.15
    rig = assemble(hidden.changed(seconds=1.8))
    with closing(rig.backend):
        samples = until(1.8, run(rig.backend, rig.controller))
        for sample in record(samples, path, rig.spec, 0.003, meta=recording_meta(rig, hidden)):
            if sample.state.t >= 0.9 and rig.sim is not None:
                rig.sim.push(push)
    free, held = (branch_recording(path, AT, {}, options=BranchOptions(own, what)) for what in ("forget", "hold"))
    assert any("ring is touched then" in line and line.endswith("and goes on without it.") for line in free.notes)
    assert any("ring is touched then" in line and line.endswith("as a torque that stays.") for line in held.notes)
    rest = after(free)
    off = [rms((each.branched - each.recorded)[rest][:, 9]) for each in (free, held)]
    assert off[1] < 0.3 * off[0]


def test_a_touch_after_the_instant_is_named(hidden: RunConfig, own: str, tmp_path: Path) -> None:
    path, push = tmp_path / "later.arrow", np.zeros(16)
    push[9] = 0.15
    rig = assemble(hidden)
    with closing(rig.backend):
        samples = until(2.4, run(rig.backend, rig.controller))
        for sample in record(samples, path, rig.spec, 0.003, meta=recording_meta(rig, hidden)):
            if 1.6 <= sample.state.t < 1.9 and rig.sim is not None:
                rig.sim.push(push)
    found = branch_recording(path, AT, {}, options=BranchOptions(own))
    assert any(line.startswith("ring is touched from 1.6") and "not only the model's" in line for line in found.notes)
    assert 1.6 < found.believed_until < 1.7


@pytest.mark.parametrize("until", [0.6, math.inf])
def test_what_follows_is_judged_before_a_touch_or_a_meeting_only(until: float) -> None:
    """The model errs by 1 mrad, the change does 10 mrad, and from 0.6 s on a touch throws the model off by 1 rad."""
    spec, t = load_spec(), np.arange(0.0, 1.0, 0.003)
    hand = np.zeros((len(t), 16))
    model, branch = hand + MRAD, hand + 11 * MRAD
    model[t >= 0.6] += 1.0
    branch[t >= 0.6] += 1.0
    found = BranchResult(t, hand, branch, spec, None, model, (), until)
    last, table = list(branch_run.lines(found, 0.0))[-1], branch_run.table(Path("x"), found, 0.0)
    if until == math.inf:
        assert last.endswith("hardly more than the model is off by, so nothing follows.")
        assert table.caption is None
        return
    assert last.startswith("Until 0.60 s, without the change the model is off by 1.00 mrad rms (at most 1.00, ")
    assert last.endswith("; the change moves the joints by 10.00 mrad rms.")
    assert list(table.columns[0].cells) == ["0 s", "0.1 s", "0.3 s"]
    assert str(table.caption).startswith("in brackets: from 0.60 s on")


def test_parts_that_would_meet_and_did_not_are_named() -> None:
    spec, t = load_spec(), np.linspace(0.0, 1.0, 334)
    open_, fist = np.zeros(16), np.array([0.0, 1.5, 1.6, 1.6] * 3 + [1.2, 0.3, 1.4, 1.4])
    closing_ = open_ + t[:, None] * (fist - open_)
    found = list(list_collisions(spec, t, np.tile(open_, (334, 1)), closing_))
    assert found
    assert all(f"From {begin:.2f} s on" in line for begin, line in found)
    said = [line for _, line in found]
    assert all("would meet" in line and line.endswith("so believe it until then.") for line in said)
    assert not list(list_collisions(spec, t, closing_, closing_))


@pytest.mark.slow
def test_the_guard_stops_the_model_as_it_would_have_stopped_the_hand(
    hidden: RunConfig, own: str, tmp_path: Path
) -> None:
    path, config = tmp_path / "slow.arrow", hidden.changed(seconds=1.6, limits={"velocity": 1.1})
    perform(assemble(config), config, Outputs(record=path))
    found = branch_recording(
        path, AT, {"damping": 0.0, "frictionloss": 0.0, "strength": 3.0}, options=BranchOptions(own)
    )
    assert len(found.branched) < len(found.recorded)
    assert any(
        "The guard would have left it limp after 1." in line and "over its limit" in line for line in found.notes
    )
    assert found.unchanged is not None
    assert len(found.unchanged) == len(found.recorded)
    branch_run.draw_branch(tmp_path / "if.png", path, found, AT)
    assert branch_run.table(path, found, AT).row_count >= 1
    with Image.open(tmp_path / "if.png") as image:
        thin = (np.asarray(image) == [38, 38, 38]).all(axis=2).any(axis=0)
    assert abs(np.flatnonzero(thin).min() - (64 + 1024 * AT / 1.6)) < 5.0
    assert thin[-20:-12].all()


@pytest.mark.slow
def test_periods_that_nobody_heard_of_pass_in_the_model_too(made: Path, own: str, tmp_path: Path) -> None:
    holed = as_real(made, tmp_path / "holed.arrow", slice(500, 520))
    found = branch_recording(holed, AT, {}, options=BranchOptions(own, open_loop=True))
    assert len(found.branched) == len(load(made)) - 20
    assert rms((found.branched - found.recorded)[after(found)]) < 2.0 * MRAD


@pytest.mark.slow
def test_servos_go_on_as_their_loop_does(make_sim: MakeSim, tmp_path: Path) -> None:
    spec, path = load_spec("leap"), tmp_path / "leap.arrow"
    begin: Vector = load_posture("home", spec) + 0.2
    span = spec.upper - spec.lower
    moves = Moves([Waypoint(begin + d * span, seconds=0.6) for d in (0.04, -0.04, 0.03)])
    backend = make_sim(spec, posture=begin, period=0.02)
    samples: Iterator[Sample] = until(2.0, run(backend, PositionControl(moves)))
    still = (Sample(replace(s.state, torque=np.full(16, np.nan)), s.command) for s in samples)
    for _ in record(still, path, spec, 0.02, meta={"gravity": [0.0, 0.0, -9.81]}):
        pass
    found = branch_recording(path, AT, {"damping": 2.0})
    assert found.unchanged is not None
    rest = after(found)
    assert np.abs(found.unchanged - found.recorded)[rest].max() < 0.5 * MRAD
    assert rms((found.branched - found.unchanged)[rest]) > 5.0 * MRAD
    with pytest.raises(ConfigError, match="--set strength: leap_right closes its own loop"):
        branch_recording(path, AT, {"strength": 0.5})


def test_the_command_shows_all_three_futures_and_refuses_in_one_line(
    made: Path, own: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.surfaces.cli import conftest

    command = conftest.command.__wrapped__(capsys, monkeypatch)  # type: ignore[attr-defined]
    code, out, _ = command("branch", made, "--at", "1.1", "--set", "strength=0.5", "--hand", own)
    assert code == 0
    said = " ".join(out.split())
    assert "the model's own error / what the change does" in said
    assert "Without the change the model is off by 0." in said
    code, _, error = command("branch", made, "--at", "1.1", "--set", "friction=0.5", "--hand", own)
    assert code == 2
    assert "--set friction is that of contacts" in error
