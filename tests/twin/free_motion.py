"""A recording of a nominal hand that touches nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Moves, Waypoint
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.loop import run, until
from allegro_twin.recording.recorder import record
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import Side
from tests.twin.plugin_hand import CALIBRATION


def free_motion(path: Path, side: Side = "right", version: str = "v4") -> Path:
    """6 s of a nominal hand that touches nothing."""
    spec = load_spec(side=side)
    middle = (spec.lower + spec.upper) / 2.0
    moves = Moves([Waypoint(middle + d, seconds=0.8) for d in (0.15, -0.15, 0.1, -0.2, 0.2, -0.1, 0.05)])
    hand = SimBackend(
        spec,
        compile_scene(spec, Stage(np.zeros(3), quaternion_facing((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))),
        posture=middle,
    )
    samples = until(6.0, run(hand, PD(moves, load_gains("v4", spec))))
    meta = {"calibration": CALIBRATION | {"version": version}, "excitation": {"asked": 7}}
    for _ in record(samples, path, spec, 0.003, meta=meta):
        pass
    return path
