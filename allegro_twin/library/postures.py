"""Named postures: joint positions with a name, stored for one hand and mirrored for the other."""

from __future__ import annotations

from pathlib import Path

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
