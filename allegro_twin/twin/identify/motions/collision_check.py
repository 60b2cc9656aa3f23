"""An excitation played by the nominal hand in simulation before anything moves: what it would touch, how fast it is."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from allegro_twin.control.controllers import GravityFeedforward
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.loop import run, until
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.excite import APPROACH, Excitation
from allegro_twin.twin.identify.motions.poses import Pose
from allegro_twin.types import Array

NEAR = 0.003  # m between two links that count as touching: the real hand is not quite the nominal one.
SCALES, TRIES = (1.0, 0.85, 0.7), 6


class Rehearsed(NamedTuple):
    """An excitation that touches nothing, and what it does."""

    excitation: Excitation
    speed: Array
    """Of each joint at the end of every period, (k, n), rad/s."""


def rehearsed(spec: HandSpec, pose: Pose, seed: int, seconds: float) -> Rehearsed:
    """The first of a few excitations, each smaller than the one before it, in which the nominal hand meets neither
    itself nor a joint limit. Raises ConfigError where none does."""
    model = compile_scene(spec, Stage(np.zeros(3), quaternion_facing(pose.facing, pose.fingers)))
    model.geom_margin[:] = NEAR / 2.0
    model.geom_gap[:] = NEAR / 2.0
    carried = GravityFeedforward(hand_kinematics(spec).gravity_torque)
    for scale, number in product(SCALES, range(TRIES)):
        excitation = Excitation(spec, seed + 1000 * number, carried, scale)
        backend = SimBackend(spec, model, posture=excitation.middle)
        speed = []
        for sample in until(seconds, run(backend, excitation)):
            if sample.state.t > APPROACH and backend.data.ncon:
                break
            speed.append(sample.state.velocity)
        else:
            return Rehearsed(excitation, np.array(speed))
    raise ConfigError(f"no excitation of {spec.name} found that does not touch itself: give another --seed")
