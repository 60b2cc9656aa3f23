"""How fingertips hold an object: postures of the right hand close around it, it is let go of, what holds is kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allegro_twin.control import laws
from allegro_twin.hands.description.hands import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.closed_form.tips import Fingertips
from allegro_twin.kinematics.orientation import quaternion_from_vector
from allegro_twin.learning.environments.randomise import Physics
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.tasks.base import Flags
from allegro_twin.learning.tasks.scenes import PALM, THING, upturned
from allegro_twin.learning.tasks.vectors import tilt
from allegro_twin.sim.batch.cpu import Rows, SimBatch
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

SIZES, FRICTION = (0.9, 1.1), 0.5
"""Factors on the object's size; the sliding friction in which it must hold."""
PERIOD = 0.003  # s, of the law and of the physics.
AT_ONCE = 512  # Simulations.
_CARRIED, _CLOSING, _SEEN, _WATCHED, _PERIODS = 60, 80, 110, 250, 450  # Periods: the object is let go of, the fingers
# have closed, what has fallen is given up, the rest has come to rest, and the end.
_FALLEN = 0.008  # m
_STILL, _UPRIGHT = 0.001, np.radians(8.0)  # m that it moves from then to the end; its tilt.
_GAP, _HIGHEST, _ASIDE = 0.008, 0.090, 0.035  # m: above the palm; highest middle; from the middle of the palm's edge.


class Tries(NamedTuple):
    """What is tried, a row each."""

    posture: Array
    """Before the fingers close, (n, 16), rad."""
    target: Array
    """When they have closed, (n, 16), rad."""
    place: Array
    """Of the object's middle, world, (n, 3), m."""
    yaw: Array
    """Of the object, (n,), rad."""


@dataclass(frozen=True, slots=True)
class Search:
    """What is tried: fingers opposite the thumb, in any posture that leaves room for the object between them. Ranges in
    rad. Its repr tells one search from another."""

    finger: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.75, 1.55), (0.0, 1.0), (0.0, 0.8))
    """From the palm outward."""
    thumb: tuple[tuple[float, float], ...] = ((0.7, 1.39), (0.4, 1.16), (0.0, 1.3), (-0.1, 1.0))
    spread: float = 0.15
    """Of a finger from the others."""
    squeeze: tuple[float, float] = (0.05, 0.30)
    press: tuple[float, float] = (0.0, 0.25)
    """Beyond the posture: of the fingers' base joints, and of the thumb's two."""
    below: tuple[float, float] = (-0.035, 0.005)
    """m, of the object's middle from the lowest tips."""
    apart: tuple[float, float] = (0.02, 0.1)
    """m, from the thumb to the fingers."""

    def tries(self, spec: HandSpec, height: Array, rng: np.random.Generator) -> Tries:
        """For objects so high (n,), m."""
        n, tips = len(height), Fingertips(spec)
        posture, squeeze, place = (np.zeros((n, k)) for k in (16, 16, 3))
        missing = np.arange(n)
        while len(missing):
            posture[missing], squeeze[missing] = self._postures(len(missing), rng)
            posture = np.clip(posture, spec.lower + 0.01, spec.upper - 0.01)
            world = tips(posture[missing])[..., ::-1]  # The palm's x is up, its z along the world's x.
            fingers, thumb = world[:, :3].mean(axis=1), world[:, 3]
            place[missing] = (fingers + thumb) / 2
            low = np.minimum(fingers[:, 2], thumb[:, 2])
            place[missing, 2] = low + rng.uniform(*self.below, len(missing))
            apart = fingers[:, 0] - thumb[:, 0]
            good = (apart > self.apart[0]) & (apart < self.apart[1]) & _inside(place[missing], height[missing])
            missing = missing[~good]
        target = np.clip(posture + squeeze, spec.lower, spec.upper)
        return Tries(posture, target, place, rng.uniform(-np.pi / 4, np.pi / 4, n))

    def _postures(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        finger = np.array([rng.uniform(*wide, n) for wide in self.finger]).T
        fingers = finger[:, None] + rng.uniform(-self.spread, self.spread, (n, 3, 4))
        thumb = np.array([rng.uniform(*wide, n) for wide in self.thumb]).T
        squeeze = np.zeros((n, 4, 4))
        squeeze[:, :3, 1] = rng.uniform(*self.squeeze, (n, 1))
        squeeze[:, 3, 1:3] = rng.uniform(*self.press, (n, 2))
        return np.concatenate([fingers.reshape(n, 12), thumb], axis=1), squeeze.reshape(n, 16)


def tried(thing: GraspObject, search: Search, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """One batch: of what held, joints, targets (m, 16), rad, pose (m, 7), m, and factor on the size (m,)."""
    spec = load_spec(side="right")
    gains = load_gains("default", spec)
    model = upturned(spec, thing, (0.0, 0.0, 0.2), EnvSettings(timestep=PERIOD), FRICTION)
    worlds, rows = SimBatch(spec, model, AT_ONCE, 0), np.arange(AT_ONCE)
    worlds.choose(rows, np.zeros(AT_ONCE, np.int64))
    body = worlds.free_body(THING)
    physics = Physics(worlds, body)
    size = physics.sizes(worlds.variant, rng.uniform(*SIZES, AT_ONCE))
    height = 2.0 * size * thing.half_extents()[2]
    physics.apply(rows, {"size": size})
    posture, target, place, yaw = search.tries(spec, height, rng)
    turned = quaternion_from_vector(yaw[:, None] * (0.0, 0.0, 1.0))
    worlds.position[...] = posture
    watched, going = place, rows
    for k in range(_PERIODS):
        if k < _CARRIED:
            body.pose[:, :3], body.pose[:, 3:] = place, turned
            body.velocity[...] = body.spin[...] = 0.0
        if k == _SEEN:
            going = _apart(body.pose[:, :3], place, _FALLEN)
        if k == _WATCHED:
            watched = np.array(body.pose[:, :3])
        wish = posture + (target - posture) * min(k / _CLOSING, 1.0)
        worlds.control[...] = laws.pd(wish - worlds.position, -worlds.velocity, gains.kp, gains.kd)
        worlds.step(None if k < _SEEN else going, 1)
    still = np.intersect1d(going, _apart(body.pose[:, :3], watched, _STILL))
    kept = still[_inside(body.pose[still, :3], height[still]) & (tilt(body.pose[still, 3:]) < _UPRIGHT)]
    return worlds.position[kept], target[kept], body.pose[kept], size[kept]


def _apart(place: Array, other: Array, most: float) -> Rows:
    """Who is at most so far from where it was."""
    return np.flatnonzero(np.linalg.norm(place - other, axis=-1) < most)


def _inside(place: Array, height: Array) -> Flags:
    """Where an object may be: above the palm, and neither high nor aside."""
    low = PALM + height / 2 + _GAP
    inside: Flags = (place[:, 2] > low) & (place[:, 2] < _HIGHEST) & (np.abs(place[:, :2]).max(axis=-1) < _ASIDE)
    return inside
