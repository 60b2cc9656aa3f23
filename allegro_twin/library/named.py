"""Postures, grasps and trajectories by name, for either hand: what most callers need of the library."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.control.motion import Motion
from allegro_twin.library.grasps import Grasp
from allegro_twin.library.library import Library
from allegro_twin.library.sources import shipped
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


def load_posture(name: str | Path, spec: HandSpec) -> Vector:
    """Joint positions by name or path for the spec's side, shape (n,), rad. Raises ConfigError."""
    return Library().posture(name, spec)


def posture_names() -> list[str]:
    """Every posture that ships with the package."""
    return sorted(shipped("posture"))


def load_grasp(name: str | Path, spec: HandSpec) -> Grasp:
    """A grasp by name or path, for the spec's side. Raises ConfigError naming the joint and the excess."""
    return Library().grasp(name, spec)


def load_trajectory(name: str | Path, spec: HandSpec) -> Motion:
    """A motion by name or path, for the spec's side. Raises ConfigError naming the joint and the excess."""
    return Library().trajectory(name, spec)


def grasp_names() -> list[str]:
    """Every grasp that ships with the package."""
    return sorted(shipped("grasp"))
