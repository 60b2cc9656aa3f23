"""The loop pairs each state with the command computed from it; stages stop, pace and end it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.control.controllers import PD, PID, GravityFeedforward
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.controller import Controller
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import paced, run, to_the_end, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.recording.replay import ReplayBackend
from allegro_twin.spec import HandSpec
from allegro_twin.types import Sample, TorqueCommand, Vector
from tests.conftest import MakeSim


def samples_for(times: list[float]) -> list[Sample]:
    from tests.test_safety import state

    return [Sample(state(round(t / 0.003)), TorqueCommand(np.zeros(16))) for t in times]


def test_until_stops_with_the_first_sample_at_its_time() -> None:
    passed = list(until(0.006, samples_for([0.0, 0.003, 0.006, 0.009])))
    assert [sample.state.tick for sample in passed] == [0, 1, 2]


def test_paced_holds_samples_back_to_real_time() -> None:
    start = time.monotonic()
    for sample in paced(samples_for([0.0, 0.03, 0.06])):
        assert time.monotonic() - start >= sample.state.t - 1e-3


@pytest.mark.parametrize("kind", ["pd", "pid"])
def test_a_controller_over_a_recording_repeats_every_command_bit_for_bit(
    kind: str, tmp_path: Path, spec: HandSpec, home: Vector, make_sim: MakeSim
) -> None:
    gains, reference = load_gains("default", spec), Moves([Waypoint(home, speed=2.0)])
    gravity = GravityFeedforward(hand_kinematics(spec).gravity_torque)
    controller: Controller[Any] = (
        PD(reference, gains, gravity) if kind == "pd" else PID(reference, gains, spec.actuation.torque_limit, gravity)
    )
    path = tmp_path / "run.arrow"
    for _ in record(until(1.0, run(make_sim(spec), controller)), path, spec, 0.003):
        pass
    recording = load(path)
    backend = ReplayBackend(recording)
    commands = [s.command.torque for s in to_the_end(run(backend, controller)) if isinstance(s.command, TorqueCommand)]
    np.testing.assert_array_equal(np.array(commands), recording.columns["command_torque"])
    assert len(commands) == 335
