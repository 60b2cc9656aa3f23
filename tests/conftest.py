"""What many tests share: specs of both hands, hands in an empty world, a short recording."""

from __future__ import annotations

import gc
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import open_backend
from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Hold
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.drivers.can.driver.backend import CanBackend
from allegro_twin.hands.description.calibration import Version
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.loop import run, until
from allegro_twin.recording.recorder import record
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Vector

pytest_plugins = ["tests.cpu", "tests.skips"]

if threading.current_thread() is threading.main_thread():
    # A shell's background job ignores Ctrl-C and one of nohup a hangup, and so would every program that a test starts
    # and ends so.
    for number, default in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, default)

# How long an example takes says how busy the machine is. Each run draws others: half of Hypothesis's usual hundred.
settings.register_profile("untimed", deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# While thousands of tests are collected, garbage is looked for again and again among what stays until the end.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


MakeSim = Callable[..., SimBackend]


@pytest.fixture(params=["right", "left"])
def side(request: pytest.FixtureRequest) -> Side:
    return request.param  # type: ignore[no-any-return]  # Pytest does not type its parameters.


@pytest.fixture
def spec() -> HandSpec:
    return load_spec()


@pytest.fixture
def home(spec: HandSpec) -> Vector:
    return load_posture("home", spec)


@pytest.fixture(scope="session")
def make_sim() -> MakeSim:
    """A hand alone in the world; by default upright."""

    def make(
        spec: HandSpec,
        *,
        facing: tuple[float, float, float] = (1, 0, 0),
        fingers: tuple[float, float, float] = (0, 0, 1),
        period: float = 0.003,
        posture: Vector | None = None,
    ) -> SimBackend:
        stage = Stage(np.zeros(3), quaternion_facing(facing, fingers))
        return SimBackend(spec, compile_scene(spec, stage), period=period, posture=posture)

    return make


@pytest.fixture(scope="session")
def recording_bytes(tmp_path_factory: pytest.TempPathFactory, make_sim: MakeSim) -> bytes:
    spec, path = load_spec(), tmp_path_factory.mktemp("recording") / "home.arrow"
    controller = PD(Hold(load_posture("home", spec)), load_gains("default", spec))
    for _ in record(until(0.75, run(make_sim(spec), controller)), path, spec, 0.003, meta={"note": "test"}):
        pass
    return path.read_bytes()


@pytest.fixture
def recording_path(tmp_path: Path, recording_bytes: bytes) -> Path:
    """0.75 s of a hand going home: 251 rows, two whole batches and a part. A file of the test's own."""
    path = tmp_path / "home.arrow"
    path.write_bytes(recording_bytes)
    return path


@pytest.fixture
def short_films(monkeypatch: pytest.MonkeyPatch) -> None:
    """Films of hands have 10 pictures instead of 200; each costs a renderer without a graphics card 50 ms."""
    monkeypatch.setattr("allegro_twin.viewing.hand_portrait.SECONDS", 0.5)


def can_config(version: Version, *, side: Side = "right", period: float = 0.003, **backend: Any) -> RunConfig:
    """A virtual hand of some version on a bus of this program. v1 to v3 have no IMU, so their gravity is given."""
    down = {"imu": 0.03} if version in ("v4", "v5", "v5plus") else {"gravity": (0.0, 0.0, -9.81)}
    return RunConfig.model_validate(
        {
            "hand": {"side": side},
            "backend": {"kind": "can", "version": version, "interface": "allegro-virtual", **down, **backend},
            "task": {"posture": "home"},
            "controller": {"kind": "pid"},
            "period": period,
        }
    )


def on_a_bus(version: Version, **settings: Any) -> CanBackend:
    """A CAN backend with a virtual hand at the other end of its bus, without a guard."""
    config = can_config(version, **settings)
    assert isinstance(config.backend, CanSettings)
    backend = open_backend(config)
    assert isinstance(backend, CanBackend)
    return backend
