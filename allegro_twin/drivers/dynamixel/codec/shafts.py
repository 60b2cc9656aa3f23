"""Actuator and joint positions: joints from actuators where a joint is not an actuator itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.types import HandState, Vector


class Shafts(NamedTuple):
    """Actuators or joints, in SI units."""

    position: Vector
    """rad."""
    velocity: Vector
    """rad/s."""
    torque: Vector
    """N·m."""


Joints = Callable[[Shafts], Shafts]
"""From the actuators, shape (m,), to the joints, shape (n,); NaN for what cannot be known."""


def of_joints(spec: HandSpec) -> Callable[[HandState], Shafts]:
    """The actuators of a hand whose joints they are. Raises ConfigError for any other."""
    _same(spec, "shafts")
    return lambda state: Shafts(state.position, state.velocity, state.torque)


def to_joints(spec: HandSpec) -> Joints:
    """The joints of a hand whose actuators they are. Raises ConfigError for any other."""
    _same(spec, "joints")
    return lambda shafts: shafts


def _same(spec: HandSpec, name: str) -> None:
    if spec.n_joints != spec.n_actuators:
        many = f"{spec.n_actuators} actuators for {spec.n_joints} joints"
        raise ConfigError(f"{spec.name} has {many}: give `{name}`, which says how one follows from the other")
