"""The backend block of a simulated hand, and the scene block of a virtual one."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import field_validator

from allegro_twin.errors import unknown
from allegro_twin.files.schema import PerJoint, Positive, Vector3
from allegro_twin.plugins import BackendSettings


class SimSettings(BackendSettings):
    """A hand in MuJoCo: alone, or in the scene of the task."""

    kind: Literal["sim"]
    facing: Vector3 = (1.0, 0.0, 0.0)
    """Alone: where the palm looks, world axes; z is up."""
    fingers: Vector3 = (0.0, 0.0, 1.0)
    """Alone: where stretched fingers point."""
    start: str | PerJoint | None = None
    """Joint positions at reset; default: the pre-shape of the scenario's grasp, else the nearest to zero inside the
    limits."""

    @property
    def virtual(self) -> bool:
        return True

    @property
    def place(self) -> str:
        return "simulated"


class SceneSettings(SimSettings):
    """Pose of a virtual hand, and its true parameters."""

    truth: str | dict[str, Any] | None = None
    """What is hidden from the host: the blocks `actuation`, `drive` and `wire` of a hand's file, or such a file; they
    override what the hand's own file says. docs/reference/hand_files.md"""
    timestep: Positive | None = None
    """Alone: of the physics, s; default 0.001."""

    @field_validator("truth")
    @classmethod
    def _blocks(cls, value: str | dict[str, Any] | None) -> str | dict[str, Any] | None:
        for key in value if isinstance(value, dict) else ():
            if key not in _HIDDEN:
                raise ValueError(unknown("block", str(key), _HIDDEN))
        return value


_HIDDEN = ("actuation", "drive", "wire")
