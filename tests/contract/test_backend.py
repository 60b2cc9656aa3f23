"""What every backend does, whatever is behind it. A new backend adds a line to `BACKENDS` and inherits all of this."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.backend import HandBackend, limp_of
from allegro_twin.cell.arm.arm_with_hand import make_arm_with_hand
from allegro_twin.control.controllers import Follow, Torque
from allegro_twin.control.trajectory import Hold
from allegro_twin.controller import Controller
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.drivers.polled.backend import PolledBackend
from allegro_twin.errors import CommandError, EndOfRecording, HandFault
from allegro_twin.grasping.trial import make_trial
from allegro_twin.hands.description.calibration import Version
from allegro_twin.hands.description.hands import load_spec
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import recorded
from allegro_twin.recording.replay import ReplayBackend
from allegro_twin.safety import Guard, Limits
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand
from tests.conftest import MakeSim, on_a_bus
from tests.drivers.serial.polled_rigs import on_a_polled_line
from tests.drivers.serial.rigs import MODEL_O, on_a_line
from tests.hands.models import hand

Make = Callable[[], HandBackend]


def guarded(backend: HandBackend) -> Guard:
    spec = backend.spec
    limits = Limits(spec.actuation.torque_limit, np.full(spec.n_joints, 12.0), spec.lower, spec.upper)
    return Guard(backend, limits)


VERSIONS: tuple[Version, ...] = ("v1", "v2", "v3", "v4", "v5", "v5plus")
CAN = [f"can-{version}" for version in VERSIONS]


OTHERS = [
    "leap",
    "leap-left",
    "leap-guarded",
    "leap-replay",
    "gripper",
    "soft",
    "soft-replay",
    "model-o",
    "qb",
    "sih",
    "sih-guarded",
    "sih-replay",
]
"""Hands that close their own loop; on slides, and on one tendon."""
SERVOS = ["leap-servos", "model-o-servos", "qb-line", "sih-line", "sih-line-guarded"]
"""Such hands at the other end of a serial line."""
ARMS = ["arm", "arm-guarded", "arm-replay", "arm-with-a-hand", "hand-on-an-arm"]
"""Arms, alone and in a world that they share."""


@pytest.fixture(scope="module")
def replayed(make_sim: MakeSim, tmp_path_factory: pytest.TempPathFactory) -> Callable[[HandSpec], HandBackend]:
    """Replays 0.75 s of a hand, which are recorded once."""
    folder = tmp_path_factory.mktemp("recordings")

    def replay(spec: HandSpec) -> HandBackend:
        path = folder / f"{spec.model}_{spec.side}.arrow"
        if not path.exists():
            torques = "torque" in spec.commands
            law: Controller[Any] = (
                Torque(np.zeros(spec.n_joints)) if torques else Follow(Hold((spec.lower + spec.upper) / 2))
            )
            for _ in recorded(until(0.75, run(make_sim(spec), law)), path, spec, 0.003):
                pass
        return ReplayBackend(load(path))

    return replay


@pytest.fixture(
    params=["sim", "sim-left", "sim-scenario", "sim-guarded", "replay", *CAN, "can-v4-left", *OTHERS, *SERVOS, *ARMS],
)
def make(
    request: pytest.FixtureRequest,
    make_sim: MakeSim,
    recording_path: Path,
    tmp_path: Path,
    replayed: Callable[[HandSpec], HandBackend],
) -> Make:
    makers: dict[str, Make] = {
        "sim": lambda: make_sim(load_spec()),
        "sim-left": lambda: make_sim(load_spec(side="left")),
        "sim-scenario": lambda: make_trial("rubiks_cube", load_spec()).backend,
        "sim-guarded": lambda: guarded(make_sim(load_spec())),
        "replay": lambda: ReplayBackend(load(recording_path)),
        "can-v4-left": lambda: on_a_bus("v4", side="left"),
        "leap": lambda: make_sim(load_spec("leap")),
        "leap-left": lambda: make_sim(load_spec("leap", "left")),
        "leap-guarded": lambda: guarded(make_sim(load_spec("leap"))),
        "leap-replay": lambda: replayed(load_spec("leap")),
        "gripper": lambda: make_sim(hand("gripper", tmp_path)),
        "soft": lambda: make_sim(hand("soft", tmp_path)),
        "soft-replay": lambda: replayed(hand("soft", tmp_path)),
        "model-o": lambda: make_sim(load_spec("model_o")),
        "qb": lambda: make_sim(load_spec("qb_softhand")),
        "arm": lambda: make_sim(load_spec("fer")),
        "arm-guarded": lambda: guarded(make_sim(load_spec("fr3"))),
        "arm-replay": lambda: replayed(load_spec("fer")),
        "arm-with-a-hand": lambda: make_arm_with_hand("fer", load_spec(), periods=(0.003, 0.003)).arm_sim,
        "hand-on-an-arm": lambda: make_arm_with_hand("fer", load_spec("leap")).hand_sim,
        "sih": lambda: make_sim(load_spec("sih")),
        "sih-guarded": lambda: guarded(make_sim(load_spec("sih"))),
        "sih-replay": lambda: replayed(load_spec("sih")),
        "qb-line": lambda: on_a_polled_line("qb_softhand", "qb"),
        "sih-line": lambda: on_a_polled_line("sih", "schunk"),
        "sih-line-guarded": lambda: guarded(on_a_polled_line("sih", "schunk")),
        "leap-servos": lambda: on_a_line("leap"),
        "model-o-servos": lambda: on_a_line("model_o", servos=MODEL_O),
    }
    makers |= {name: partial(on_a_bus, version) for name, version in zip(CAN, VERSIONS, strict=True)}
    return makers[request.param]


@pytest.fixture
def backend(make: Make) -> Iterator[HandBackend]:
    made = make()
    yield made
    made.close()


def some(spec: HandSpec, k: int) -> Command:
    """A command that moves a hand a little."""
    wave = np.sin(0.1 * k + np.arange(spec.n_actuators))
    if "torque" in spec.commands:
        return TorqueCommand(0.05 * wave)
    return PositionCommand((spec.lower + spec.upper) / 2 + 0.1 * (spec.upper - spec.lower) * wave)


def drive(backend: HandBackend, periods: int) -> list[HandState]:
    states = [backend.reset()]
    for k in range(periods):
        backend.write(some(backend.spec, k))
        states.append(backend.read())
    return states


def test_reset_begins_at_time_and_tick_zero(backend: HandBackend) -> None:
    drive(backend, 3)
    state = backend.reset()
    assert (state.t, state.tick) == (0.0, 0)


def test_time_and_tick_only_go_forward_and_agree(backend: HandBackend) -> None:
    states = drive(backend, 20)
    for before, after in pairwise(states):
        assert after.t > before.t
        assert after.tick > before.tick
    for state in states:
        assert state.t == pytest.approx(state.tick * backend.period, abs=backend.period / 2)


def test_a_state_is_whole_and_has_the_specs_shapes(backend: HandBackend) -> None:
    for state in drive(backend, 2):
        for name in ("position", "velocity", "torque", "temperature"):
            assert getattr(state, name).shape == (backend.spec.n_joints,)
            assert getattr(state, name).dtype == np.float64
        assert state.gravity.shape == (3,)
        assert np.isfinite(state.position).all()
        assert np.isfinite(state.velocity).all()


def test_the_arrays_of_a_state_are_read_only(backend: HandBackend) -> None:
    state = drive(backend, 1)[-1]
    for name in ("position", "velocity", "torque", "temperature", "gravity"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(state, name)[0] = 1.0


def test_a_state_does_not_change_when_time_goes_on(backend: HandBackend) -> None:
    states = drive(backend, 5)
    copies = [(s.position.copy(), s.velocity.copy(), s.torque.copy(), s.gravity.copy()) for s in states]
    for _ in range(5):
        backend.read()
    for state, copy in zip(states, copies, strict=True):
        for array, kept in zip((state.position, state.velocity, state.torque, state.gravity), copy, strict=True):
            np.testing.assert_array_equal(array, kept)


def test_reading_without_writing_holds_the_last_command(backend: HandBackend) -> None:
    backend.reset()
    backend.write(limp_of(backend.spec))
    ticks = [backend.read().tick for _ in range(4)]
    assert ticks == sorted(set(ticks))


def test_a_second_session_repeats_the_first_bit_for_bit(backend: HandBackend) -> None:
    first, second = drive(backend, 30), drive(backend, 30)
    for before, after in zip(first, second, strict=True):
        np.testing.assert_array_equal(before.position, after.position)
        np.testing.assert_array_equal(before.velocity, after.velocity)
        np.testing.assert_array_equal(before.torque, after.torque)


@pytest.mark.slow
def test_a_second_instance_repeats_the_first_bit_for_bit(make: Make) -> None:
    first, second = drive(make(), 30), drive(make(), 30)
    for before, after in zip(first, second, strict=True):
        np.testing.assert_array_equal(before.position, after.position)


def test_a_command_of_the_wrong_kind_or_length_is_refused(backend: HandBackend) -> None:
    spec = backend.spec
    kinds = [TorqueCommand, PositionCommand] if "torque" in spec.commands else [PositionCommand, TorqueCommand]
    n, wanted = spec.n_actuators, f"takes a {kinds[0].__name__}"
    for kind, count, words in ((0, n - 1, "actuators"), (0, n + 1, "actuators"), (1, n, wanted)):
        backend.reset()
        with pytest.raises(CommandError, match=words):
            backend.write(kinds[kind](np.zeros(count)))


def test_a_part_of_a_command_that_the_hand_does_not_take_is_refused(backend: HandBackend) -> None:
    spec = backend.spec
    if "torque" in spec.commands:
        return
    parts = {"timed_position": PositionCommand(spec.lower, duration=0.5),
             "limited_position": PositionCommand(spec.lower, np.full(spec.n_actuators, 0.1))}  # fmt: skip
    for kind, command in parts.items():
        backend.reset()
        if kind in spec.commands:
            backend.write(command)
            continue
        with pytest.raises(CommandError, match=f"takes position.*, and this command is a {kind}"):
            backend.write(command)


def test_every_hand_takes_the_limp_command_and_gives_nothing_then(backend: HandBackend) -> None:
    if isinstance(backend, ReplayBackend):
        return
    drive(backend, 20)
    backend.write(limp_of(backend.spec))
    for _ in range(5):
        state = backend.read()
    np.testing.assert_array_equal(state.torque, 0.0)


def test_close_may_be_called_twice(backend: HandBackend) -> None:
    backend.reset()
    backend.close()
    backend.close()
    assert backend.spec.n_joints in (1, 4, 5, 7, 16)  # It still says which hand it was.


def test_a_hand_that_was_closed_takes_no_commands_unless_it_only_exists_here(backend: HandBackend) -> None:
    backend.reset()
    backend.close()
    if isinstance(backend, CanBackend | DynamixelBackend | PolledBackend):
        with pytest.raises(HandFault, match="closed"):
            backend.write(limp_of(backend.spec))
        with pytest.raises(HandFault, match="closed"):
            backend.read()
    assert backend.reset().tick == 0  # Reset leads out.


def test_only_a_recording_ends(backend: HandBackend) -> None:
    backend.reset()
    if isinstance(backend, ReplayBackend):
        with pytest.raises(EndOfRecording, match="ends at 0.750 s, after 251 rows"):
            for _ in range(1000):
                backend.read()
    else:
        for _ in range(300):
            backend.read()
