"""Every backend of the package keeps the contract, whatever is behind it. A new one adds a line to the fixture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.backend import HandBackend, limp_of
from allegro_twin.cell.arm.arm_with_hand import make_arm_with_hand
from allegro_twin.control.controllers import ConstantTorque, PositionControl
from allegro_twin.control.trajectory import Hold
from allegro_twin.controller import Controller
from allegro_twin.device import device_of, innermost
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.drivers.dynamixel.driver.backend import DynamixelBackend
from allegro_twin.drivers.polled.backend import PolledBackend
from allegro_twin.errors import CommandError, EndOfRecording, HandFault
from allegro_twin.grasping.trial import make_trial
from allegro_twin.hands.description.calibration import Version
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.loop import run, until
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.recording.replay import ReplayBackend
from allegro_twin.safety import Guard, Limits
from allegro_twin.spec import HandSpec
from allegro_twin.testing import BackendContract
from allegro_twin.types import PositionCommand, TorqueCommand
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
ALIKE = {
    "sim-left", "can-v1", "can-v2", "can-v5", "can-v4-left", "leap-left", "leap-guarded", "soft-replay", "sih-guarded",
    "sih-replay", "model-o-servos", "sih-line-guarded", "arm-guarded",
}  # fmt: skip
"""Of each of these another one of its kind is in the fast tier."""
EVERY = ["sim", "sim-left", "sim-scenario", "sim-guarded", "replay", *CAN, "can-v4-left", *OTHERS, *SERVOS, *ARMS]


@pytest.fixture(scope="module")
def replayed(make_sim: MakeSim, tmp_path_factory: pytest.TempPathFactory) -> Callable[[HandSpec], HandBackend]:
    """Replays 0.75 s of a hand, which are recorded once."""
    folder = tmp_path_factory.mktemp("recordings")

    def replay(spec: HandSpec) -> HandBackend:
        path = folder / f"{spec.model}_{spec.side}.arrow"
        if not path.exists():
            torques = "torque" in spec.commands
            law: Controller[Any] = (
                ConstantTorque(np.zeros(spec.n_joints))
                if torques
                else PositionControl(Hold((spec.lower + spec.upper) / 2))
            )
            for _ in record(until(0.75, run(make_sim(spec), law)), path, spec, 0.003):
                pass
        return ReplayBackend(load(path))

    return replay


@pytest.fixture(
    params=[pytest.param(name, marks=pytest.mark.slow if name in ALIKE else ()) for name in EVERY],
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


class TestEveryBackend(BackendContract):
    """The published contract over every backend of the package."""

    @pytest.fixture(autouse=True)
    def _of(self, make: Make) -> None:
        self.make = make  # type: ignore[method-assign]  # Chosen by parameter.

    def does_not_apply(self, reason: str) -> None:
        """Which rules those are is known: recordings, and hands that take torques."""
        assert reason in ("it takes torques", "what was recorded has happened")


@pytest.fixture
def backend(make: Make) -> Iterator[HandBackend]:
    made = make()
    yield made
    made.close()


def test_it_says_whether_it_is_live(backend: HandBackend) -> None:
    """A stranger's backend need not; ours are simulated, replayed or in lockstep here."""
    assert isinstance(innermost(backend).live, bool)
    assert not device_of(backend).live


def test_a_hand_behind_a_wire_takes_nothing_once_it_is_closed(backend: HandBackend) -> None:
    backend.reset()
    backend.close()
    if isinstance(backend, CanBackend | DynamixelBackend | PolledBackend):
        with pytest.raises(HandFault, match="closed"):
            backend.write(limp_of(backend.spec))
        with pytest.raises(HandFault, match="closed"):
            backend.read()


def test_a_recording_says_where_it_ends(backend: HandBackend) -> None:
    if isinstance(backend, ReplayBackend):
        backend.reset()
        with pytest.raises(EndOfRecording, match="ends at 0.750 s, after 251 rows"):
            for _ in range(1000):
                backend.read()


def test_a_refusal_names_what_the_hand_takes(backend: HandBackend) -> None:
    spec = backend.spec
    other = PositionCommand if "torque" in spec.commands else TorqueCommand
    wanted = TorqueCommand if "torque" in spec.commands else PositionCommand
    backend.reset()
    with pytest.raises(CommandError, match=f"takes a {wanted.__name__}"):
        backend.write(other(np.zeros(spec.n_actuators)))
    backend.reset()
    with pytest.raises(CommandError, match="actuators"):
        backend.write(wanted(np.zeros(spec.n_actuators + 1)))
