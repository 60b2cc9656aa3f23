"""A hidden hand, excited once for all tests: three poses on a bus of this program, and what was found."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.twin.identify.pipeline import Identification, identify_hand
from allegro_twin.twin.identify.record_excitation import pose_config, record_run, remaining_run
from tests.conftest import can_config

POSES = ("up", "palm-up", "side")
SECONDS = 5.0
_DRAW = np.random.default_rng(7)
CONSTANT = _DRAW.uniform(0.8, 1.2, 16)
ARMATURE = _DRAW.uniform(0.002, 0.004, 16)
DAMPING = _DRAW.uniform(0.05, 0.10, 16)
FRICTION = _DRAW.uniform(0.005, 0.04, 16)
OFFSET = _DRAW.uniform(-0.02, 0.02, 16)
DELAY = 0.0035


NOISY = {"encoder_noise": 1e-3}
SHAPE = {"stiction": 1.5, "stribeck_speed": 0.14, "bristle": 1e-3, "load_friction": 0.06}


def config(side: str = "right", drive: Mapping[str, object] | None = None) -> RunConfig:
    truth = {
        "wire": {"torque_constant": CONSTANT.tolist()},
        "actuation": {
            "armature": ARMATURE.tolist(), "damping": DAMPING.tolist(), "frictionloss": FRICTION.tolist(),
        },
        "drive": {"delay": DELAY, "encoder_noise": 5e-5, "encoder_offset": OFFSET.tolist(), **(drive or {})},
    }  # fmt: skip
    return can_config("v4", side=side, scene={"kind": "sim", "timestep": 0.0005, "truth": truth})  # type: ignore[arg-type]


@cache
def _folder(breaking: bool) -> Path:
    return Path(mkdtemp())


def recording(pose: str, *, breaking: bool = False) -> Path:
    """Of one pose; `breaking`: of a hand whose friction is of SHAPE."""
    return _recorded(pose, breaking)


@cache  # However it is asked for, it is one.
def _recorded(pose: str, breaking: bool) -> Path:
    own = config(drive=SHAPE) if breaking else config()
    task = remaining_run(own, pose, SECONDS, 3, _folder(breaking))
    assert task is not None
    record_run(pose_config(own, task.pose), task, lambda t: None)
    return task.file


def recordings(*, breaking: bool = False) -> tuple[Path, ...]:
    """One for each pose."""
    return tuple(recording(pose, breaking=breaking) for pose in POSES)


@cache
def found_with_noise() -> Identification:
    """The same hand, whose encoders have 20 times the noise."""
    files, folder = [], Path(mkdtemp())
    for pose in POSES:
        task = remaining_run(config(drive=NOISY), pose, 2.0 * SECONDS, 3, folder)
        assert task is not None
        record_run(pose_config(config(drive=NOISY), task.pose), task, lambda t: None)
        files.append(task.file)
    return identify_hand(tuple(files), (), masses_known=True)


@cache
def found() -> Identification:
    return identify_hand(recordings(), (), masses_known=True)
