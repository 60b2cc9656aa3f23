"""A config or the command line puts a policy in charge of any hand: simulated, on a bus, or recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_posture
from allegro_twin.learning.policy.interface import Interface
from allegro_twin.loop import run, to_the_end, until
from allegro_twin.surfaces.cli.start.jobs import RunOptions as Options
from allegro_twin.surfaces.cli.start.jobs import configs_of
from allegro_twin.types import Sample, TorqueCommand

pytest.importorskip("onnxruntime", reason="the shipped policies are ONNX files: extra policy")

CLOSE = 0.015  # m. Success in training is 10 mm; the velocity filter of a bus and the goal's own error come on top.


def config(backend: dict[str, Any], file: str = "reach_right", **task: Any) -> RunConfig:
    policy = {"kind": "policy", "file": file}
    task = {"posture": "ok"} if file == "reach_right" and not task else task
    return RunConfig.model_validate({"backend": backend, "task": task, "controller": policy, "seconds": 2.0})


def driven(settings: RunConfig) -> list[Sample]:
    rig = assemble(settings)
    samples = to_the_end(run(rig.backend, rig.controller))
    done = list(samples if rig.seconds is None else until(rig.seconds, samples))
    rig.backend.close()
    return done


def apart(sample: Sample, posture: str) -> float:
    """How far the farthest fingertip is from where a posture would have it, m."""
    spec = load_spec()
    interface = Interface(spec, gains=None)  # type: ignore[arg-type]  # The kinematics need none.
    here, there = (interface.fingertips(q) for q in (sample.state.position, load_posture(posture, spec)))
    return float(np.linalg.norm((here - there).reshape(-1, 3), axis=1).max())


@pytest.mark.parametrize(
    "backend",
    [{"kind": "sim"}, {"kind": "can", "version": "v4", "interface": "allegro-virtual"}],
    ids=["simulated", "on a bus"],
)
def test_a_policy_brings_the_fingertips_of_any_hand_to_those_of_a_posture(backend: dict[str, Any]) -> None:
    samples = driven(config(backend))
    assert apart(samples[0], "ok") > 2 * CLOSE
    assert apart(samples[-1], "ok") < CLOSE


def test_a_policy_answers_a_recording_as_it_answered_the_hand(recording_path: Path) -> None:
    first, second = (driven(config({"kind": "replay", "file": str(recording_path)})) for _ in range(2))
    assert len(first) == 251
    for (state, command), (again, same) in zip(first, second, strict=True):
        np.testing.assert_array_equal(state.position, again.position)
        assert isinstance(command, TorqueCommand)
        assert isinstance(same, TorqueCommand)
        np.testing.assert_array_equal(command.torque, same.torque)
    assert np.ptp([sample.command.torque for sample in first], axis=0).max() > 0.01  # type: ignore[union-attr]


def test_the_flag_replaces_the_controller_of_a_config() -> None:
    (job,) = configs_of(["can_virtual"], Options(seconds=0.5, policy="reach_right", goal="ok"))
    assert job.config.controller.kind == "policy"
    assert apart(driven(job.config)[-1], "ok") < apart(driven(job.config)[0], "ok")


def test_a_policy_with_a_script_runs_as_long_as_it_and_by_the_grasps_name() -> None:
    (job,) = configs_of(["sim_right"], Options(grasp="medium_wrap", policy="grasp_right"))
    rig = assemble(job.config.model_copy(update={"seconds": None}))
    assert rig.seconds == pytest.approx(4.3, abs=0.003)
    said = "no grasp of this policy named 'quadpod_bear'; did you mean 'quadpod_pear'[?]"
    with pytest.raises(ConfigError, match=said):
        assemble(config({"kind": "sim"}, file="grasp_right", grasp="quadpod_bear"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"posture": None}, "reaches goals: name a posture with task.posture or --goal"),
        ({"file": "reach_rihgt"}, "no policy named 'reach_rihgt'; did you mean 'reach_right'"),
        ({"posture": "okay"}, "did you mean 'ok'"),
        ({"file": "grasp_right", "posture": "ok"}, "reaches no goals: leave out task.posture"),
    ],
)
def test_what_a_policy_lacks_is_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        assemble(config({"kind": "sim"}, **change))


def test_a_policy_for_other_periods_or_another_timeline_is_refused() -> None:
    settings = config({"kind": "sim"}).model_copy(update={"period": 0.002})
    with pytest.raises(ConfigError, match=r"decides for a period of 0\.003 s; the config says 0\.002 s"):
        assemble(settings)
    with pytest.raises(ConfigError, match="on its own timeline, not on a scenario's"):
        assemble(config({"kind": "sim"}, file="grasp_right", scenario="apple"))
    with pytest.raises(ConfigError, match="--goal is for a policy"):
        configs_of(["sim_right"], Options(goal="ok"))
