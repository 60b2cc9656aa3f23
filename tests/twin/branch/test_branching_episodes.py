"""A recorded episode goes on as it did, to the last bit, or otherwise from the instant of a change."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import assemble
from allegro_twin.app.session import Outputs, perform
from allegro_twin.errors import ConfigError
from allegro_twin.learning.environments.episode import EpisodeBackend
from allegro_twin.learning.environments.randomise import Randomise
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.recording.reader import load
from allegro_twin.sim.model.joints import JointChange
from allegro_twin.surfaces.cli.twin import branch_run
from allegro_twin.twin.branch.result import BranchOptions
from allegro_twin.twin.branch.what_if import branch_recording
from allegro_twin.types import TorqueCommand
from tests.learning.environments.test_posterior import known, write
from tests.twin.branch.hands import as_real

CUBE: dict[str, Any] = {
    "hand": {"model": "allegro", "side": "right"},
    "backend": {"kind": "sim"},
    "task": {"episode": {"task": "Rotate", "environment": {"timestep": 0.003, "palm": "allowed"}, "seed": 3}},
    "controller": {"kind": "policy", "file": "rotate_hand_right"},
    "seconds": 1.2,
}

SEARCH = {"samples": 4, "horizon": 0.12, "hold": 0.0, "iterations": 1}
PLANNED = {"kind": "mpc", "planning": SEARCH, "threads": 1}
FINGERTIPS = {"episode": {"task": "Rotate", "environment": {"timestep": 0.003}}}


def made(tmp_path: Path, **changes: Any) -> Path:
    config = RunConfig.model_validate(CUBE | changes)
    path = tmp_path / "run.arrow"
    perform(assemble(config), config, Outputs(record=path))
    return path


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"backend": {"kind": "can", "version": "v4", "interface": "allegro-virtual"}},
        {"controller": PLANNED, "seconds": 0.2},
        {"hand": {"model": "leap"}, "task": FINGERTIPS, "controller": {"kind": "position"}, "seconds": 0.6},
    ],
    ids=["policy", "bus", "mpc", "own loop"],
)
def test_without_a_change_an_episode_goes_on_as_it_did_bit_for_bit(tmp_path: Path, changes: dict[str, Any]) -> None:
    path = made(tmp_path, **changes)
    found = branch_recording(path, 0.1, {})
    np.testing.assert_array_equal(found.branched, load(path).columns["position"])


@pytest.mark.parametrize(
    "change",
    [{"friction": 0.05}, {"damping": 0.5}, {"frictionloss": 0.2}, {"strength": 0.5}],
    ids=lambda c: next(iter(c)),
)
def test_each_change_acts_on_an_episode_from_its_instant_on(tmp_path: Path, change: dict[str, float]) -> None:
    path = made(tmp_path)
    found = branch_recording(path, 0.6, change)
    off = np.abs(found.branched - found.recorded).max(axis=1)
    assert not off[found.t <= 0.6].any()
    assert off[-1] > 1e-3


def test_the_dry_friction_of_a_twin_that_rubs_more_under_load_changes_too() -> None:
    environment = EnvSettings(
        timestep=0.003, randomise=Randomise(twin=write(known()))
    )  # Its friction is set in every period.
    moved = []
    for dry in (None, 0.5):
        hand = EpisodeBackend("Reach", environment, seed=1)
        hand.reset()
        hand.become(JointChange(frictionloss=dry))
        for _ in range(40):
            hand.write(TorqueCommand(np.full(16, 0.2)))
            state = hand.read()
        moved.append(np.abs(state.velocity).max())
    assert moved[1] < 0.1 * moved[0]


@pytest.mark.parametrize("strength", [0.5, 1.5])
@pytest.mark.parametrize("task", [{}, FINGERTIPS], ids=["alone", "episode"])
def test_motors_of_another_strength_give_that_share_of_what_they_are_told_and_of_what_they_can(
    strength: float, task: dict[str, Any]
) -> None:
    rig = assemble(RunConfig.model_validate(CUBE | {"task": task, "controller": {"kind": "torque"}}))
    hand = rig.sim or rig.episode
    assert hand is not None
    hand.reset()
    limit = hand.spec.actuation.torque_limit
    for share in (1.0, strength):
        for asked, given in ((0.1, 0.1), (5.0, limit)):
            hand.write(TorqueCommand(np.full(16, asked)))
            hand.read()
            data = rig.sim.data if rig.sim is not None else rig.episode.engine.worlds.snapshot(0).data  # type: ignore[union-attr]  # One of them.
            np.testing.assert_allclose(np.sort(data.actuator_force[:16]), np.sort(share * given + np.zeros(16)))
        hand.become(JointChange(strength=strength))
    rig.backend.close()


def test_what_becomes_of_the_branchs_episode_is_said(tmp_path: Path) -> None:
    path = made(tmp_path, task=FINGERTIPS, controller=PLANNED, seconds=0.5)
    same, slipped = branch_recording(path, 0.1, {}), branch_recording(path, 0.1, {"friction": 0.0})
    assert same.notes[0].startswith("The episode of the branch: Rotate: 0.47 s, ")
    assert same.notes[1] == "It is not over at 0.50 s, where the recording ends."
    assert re.fullmatch(r"The episode of the branch: Rotate: lost at \d\.\d\d s, .* rad", slipped.notes[0])
    assert list(branch_run.lines(slipped, 0.1))[1:] == [*slipped.notes]


def test_a_branch_of_an_episode_shows_its_object_beside_where_that_was(tmp_path: Path) -> None:
    path, into = made(tmp_path), tmp_path / "if.arrow"
    branch_run.run_branch(path, 0.4, ["friction=0.0"], branch_run.BranchOutputs(into), BranchOptions())
    was, would = load(path).columns["object"], load(into).columns
    np.testing.assert_array_equal(would["target_object"], was)
    before = load(path).columns["t"] <= 0.4
    np.testing.assert_array_equal(would["object"][before], was[before])
    assert np.abs(would["object"][-1] - was[-1])[:3].max() > 1e-3


def test_another_controller_of_a_branch_sees_the_branchs_own_object(tmp_path: Path) -> None:
    path = made(tmp_path, controller=PLANNED, seconds=0.3)
    changed = branch_recording(path, 0.2, {"controller.planning": SEARCH | {"samples": 6}})
    off = np.abs(changed.branched - changed.recorded).max(axis=1)
    assert not off[changed.t <= 0.2].any()
    assert off[-1] > 0.0


def test_an_episode_that_an_earlier_version_recorded_says_so(tmp_path: Path) -> None:
    path = as_real(made(tmp_path), tmp_path / "old.arrow")
    with pytest.raises(ConfigError, match="was made with an earlier version, and this is mujoco .*: it would not be"):
        branch_recording(path, 0.2, {})
