"""Postures, grasps and trajectories by name, for either hand: what most callers need of the library."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.control.demonstration import TaughtMotion
from allegro_twin.hands.library.entries import HAND, Kind
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import Library
from allegro_twin.hands.library.sources import read_shipped, shipped
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


def load_posture(name: str | Path, spec: HandSpec) -> Vector:
    """Joint positions by name or path for the spec's side, shape (n,), rad. Raises ConfigError."""
    return Library().posture(name, spec)


def posture_names(model: str = HAND) -> list[str]:
    """Every posture of a model of hand that ships with the package."""
    return _names("posture", model)


def load_grasp(name: str | Path, spec: HandSpec) -> Grasp:
    """A grasp by name or path, for the spec's side. Raises ConfigError naming the joint and the excess."""
    return Library().grasp(name, spec)


def load_trajectory(name: str | Path, spec: HandSpec) -> TaughtMotion:
    """A motion by name or path, for the spec's side. Raises ConfigError naming the joint and the excess."""
    return Library().trajectory(name, spec)


def grasp_names(model: str = HAND) -> list[str]:
    """Every grasp of a model of hand that ships with the package."""
    return _names("grasp", model)


def _names(kind: Kind, model: str) -> list[str]:
    return sorted(name for name in shipped(kind) if read_shipped(name).entry.hand == model)
