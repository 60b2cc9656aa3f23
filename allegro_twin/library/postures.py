"""Named postures: joint positions with a name, stored for one hand and mirrored for the other."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.files.assets import data_root, find
from allegro_twin.files.schema import Settings, load
from allegro_twin.library.grasps import Angles, joint_vector
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Vector


class PostureFile(Settings):
    """A posture as it is stored."""

    description: str = ""
    side: Side = "right"
    """Which hand the angles are for; the other hand uses their mirror image."""
    angles: Angles


def load_posture(name: str | Path, spec: HandSpec) -> Vector:
    """Joint positions by name or path for the spec's side, shape (n,), rad. Raises ConfigError."""
    path = find(name, "posture", "conf/postures")
    stored = load(PostureFile, path)
    values = joint_vector(stored.angles, spec, str(path))
    return spec.posture(values if stored.side == spec.side else spec.mirrored(values), str(path))


def posture_names() -> list[str]:
    """Every posture that ships with the package."""
    return sorted(path.stem for path in (data_root() / "conf" / "postures").glob("*.yaml"))
