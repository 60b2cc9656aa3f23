"""Empty grasp: finger positions after a close on nothing, predicted by simulating the hand alone."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.motion.finger_paths import SteeredReference, finger_controller
from allegro_twin.cell.settings import CellHandSettings
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import quaternion_from_gravity
from allegro_twin.loop import run
from allegro_twin.sim.contact.self_clearance import SelfClearance
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array, Vector, frozen

SQUEEZE = 0.6
"""s, as in conf/protocols/table_pick.yaml."""
PERIOD = 0.003
"""Control period of a hand in the cell, s."""
_PEAK = 15.0 / 8.0  # Peak over mean speed of a motion from rest to rest.
_REST = 0.5  # s. After the squeeze, at least, until nothing moves;
_STILL, _LONGEST = 2e-3, 4.0  # and that is rad/s, or s after the squeeze at the latest: slow motors creep.
_TOUCH = 0.001  # m. Fingers nearer than this touch each other.
_OFF = np.radians(3.0)  # Of an encoder at worst: more shows when the hand is calibrated.
_FINE = 0.5  # m/s². Of gravity in the palm's frame, which hardly matters: the hand carries itself.


def squeeze_speed(grasp: Grasp) -> float:
    """How fast the fingers go from closed to squeezed at their peak, rad/s, so that it takes `SQUEEZE`."""
    far = float(np.abs(grasp.squeeze - grasp.close).max())
    return max(_PEAK * far / SQUEEZE, 0.05)


class EmptyGrasp(NamedTuple):
    """Result of a close on nothing."""

    position: Vector
    """Joint positions after the close on nothing, (n,), rad."""
    telling: NDArray[np.bool_]
    """Joints of fingers that meet no other, (n,): where two fingertips come to rest on each other is chance, so that
    the others tell whether something is there. All, where every finger meets another."""


def touching_joints(hand: CellHandSettings, postures: Array) -> NDArray[np.bool_]:
    """Which joints are of fingers that touch each other in postures, (..., n), rad → (..., n): what is between those
    two is a finger. Fingers that were brushed on the way may hook into each other that are apart around nothing."""
    spec, apart = _apart(hand.model, hand.side)
    rows = np.atleast_2d(postures)
    found = np.zeros(rows.shape, np.bool_)
    fingers = {finger.name: list(finger.joints) for finger in spec.fingers}
    for (one, other), gaps in zip(apart.pairs, apart(rows).T, strict=True):
        if one != other and one in fingers and other in fingers:
            found[np.ix_(gaps < _TOUCH, fingers[one] + fingers[other])] = True
    return found.reshape(postures.shape)


def misread_positions(position: Vector) -> Array:
    """Where a hand may be that reads a `position`, (n,), rad, with any one encoder off to either side, (2n, n)."""
    return np.asarray(position + np.concatenate([np.eye(len(position)), -np.eye(len(position))]) * _OFF)


@cache
def _apart(model: str, side: Side) -> tuple[HandSpec, SelfClearance]:
    spec = load_spec(model, side)
    return spec, SelfClearance(spec)


def empty_grasp(hand: CellHandSettings, grasp: Grasp, palm: Array) -> EmptyGrasp:
    """After a grasp, of a hand whose palm is turned so in the world, (3, 3).

    The first time costs some 0.1 s.
    """
    gravity = tuple(float(part) for part in -np.round(9.81 * palm[2] / _FINE) * _FINE)
    return _closed(hand.model, hand.side, hand.gains, grasp, gravity)


@lru_cache(maxsize=256)
def _closed(model: str, side: Side, gains: str, grasp: Grasp, gravity: tuple[float, ...]) -> EmptyGrasp:
    spec = load_spec(model, side)
    stage = Stage(np.array([0.0, 0.0, 1.0]), quaternion_from_gravity(gravity))
    backend = SimBackend(spec, compile_scene(spec, stage), period=PERIOD, posture=grasp.preshape)
    path = SmoothSetpoint(grasp.preshape)
    closed = path.head_for(0.0, grasp.close, grasp.speed)
    end = None
    for sample in run(backend, finger_controller(SteeredReference(path), gains, spec, hand_kinematics(spec))):
        t, position = sample.state.t, sample.state.position
        if end is None and t >= closed:
            end = path.head_for(t, grasp.squeeze, squeeze_speed(grasp)) + _REST
        if end is not None and t >= end and (np.abs(sample.state.velocity).max() < _STILL or t >= end + _LONGEST):
            break
    backend.close()
    return EmptyGrasp(frozen(position), _telling(position, grasp, load_gains(gains, spec).kp, spec))


def _telling(position: Vector, grasp: Grasp, stiffness: Vector, spec: HandSpec) -> NDArray[np.bool_]:
    stopped = stiffness * np.abs(grasp.squeeze - position) > 2.0 * spec.actuation.frictionloss
    telling = np.ones(spec.n_joints, np.bool_)
    for finger in spec.fingers:
        joints = list(finger.joints)
        telling[joints] &= not stopped[joints].any()
    return telling if telling.any() else ~telling
