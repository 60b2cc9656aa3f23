"""Mounts of a hand on an arm's flange, with adapter, camera and load: conf/mounts/<name>.yaml."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import field_validator

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root, find_file
from allegro_twin.files.schema import Positive, Settings, load_settings
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_facing, quaternion_from_matrix
from allegro_twin.spec import HandSpec
from allegro_twin.spec.arm import Load
from allegro_twin.types import Array, frozen

Triple = tuple[float, float, float]


class AdapterSettings(Settings):
    """The part between flange and hand: a disc on the flange."""

    mass: Positive
    """kg."""
    radius: Positive
    """m."""
    length: Positive
    """m."""


class MountCameraSettings(Settings):
    """Pose of a camera in the flange's frame."""

    position: Triple
    """m."""
    looks: Triple
    """Where it looks."""
    up: Triple
    """Up in its picture, as nearly as possible."""


class LoadSettings(Settings):
    """Load on the flange that the arm compensates; `weigh_tool` measures it from several poses."""

    mass: Positive
    """kg."""
    centre: Triple
    """Centre of mass in the flange's frame, m."""


class MountSettings(Settings):
    hand: str
    """The model of hand that it is for."""
    position: Triple
    """The palm's origin in the flange's frame, m."""
    facing: Triple
    """Where the palm looks, in the flange's frame, whose z points away from the arm."""
    fingers: Triple
    """Where stretched fingers point."""
    adapter: AdapterSettings
    camera: MountCameraSettings
    load: LoadSettings

    @field_validator("facing", "fingers")
    @classmethod
    def _some(cls, value: Triple) -> Triple:
        if not np.linalg.norm(value) > 1e-6:
            raise ValueError("needs a direction")
        return value


@dataclass(frozen=True, slots=True, eq=False)
class HandMount:
    """A hand's place on a flange. Frames are the flange's."""

    name: str
    position: Array
    """Position of the palm, (3,), m."""
    quaternion: Array
    """Orientation of the palm, w x y z."""
    adapter: AdapterSettings
    camera_position: Array
    """(3,), m."""
    camera_quaternion: Array
    """Orientation of its optical frame: z ahead, x to the right of the picture, y down."""
    load: Load


def load_mount(hand: HandSpec, name: str | Path = "") -> HandMount:
    """The mount of a hand: its model's own, or another by name or path. Raises ConfigError for one of another hand, and
    for a hand that has none."""
    if not name and not (data_root() / "conf" / "mounts" / f"{hand.model}.yaml").is_file():
        own = ", ".join(sorted(file.stem for file in (data_root() / "conf" / "mounts").glob("*.yaml")))
        raise ConfigError(
            f"{hand.model_reference} has no mount on an arm's flange, so it is no hand for the cell: take one of "
            f"{own}; plan and run pick with a hand of your own without an arm (docs/how-to/pick_with_your_hand.md)"
        )
    path = find_file(name or hand.model, "mount", "conf/mounts")
    settings = load_settings(MountSettings, path)
    if settings.hand != hand.model:
        raise ConfigError(
            f"{path} is the flange of a {settings.hand}, and the hand is a {hand.name}: "
            f"take conf/mounts/{hand.model}.yaml"
        )
    camera, position = settings.camera, np.array(settings.position)
    quaternion = quaternion_facing(settings.facing, settings.fingers)
    centre = np.array(settings.load.centre)
    if hand.side == "left":  # The file is of a right hand, and a left one is its mirror image in the palm's x-z plane.
        axes = matrix_from_quaternion(quaternion)
        centre = position + axes @ (axes.T @ (centre - position) * (1.0, -1.0, 1.0))
    return HandMount(
        name=path.stem,
        position=frozen(position),
        quaternion=frozen(quaternion),
        adapter=settings.adapter,
        camera_position=frozen(camera.position),
        camera_quaternion=frozen(_optical(camera, path)),
        load=Load(settings.load.mass, frozen(centre)),
    )


def _optical(camera: MountCameraSettings, path: Path) -> Array:
    ahead, up = np.array(camera.looks), np.array(camera.up)
    right = np.cross(ahead, up)
    if not np.linalg.norm(right) > 1e-6:
        raise ConfigError(f"{path}: camera: looks {camera.looks} and up {camera.up} must not be parallel or zero")
    z, x = ahead / np.linalg.norm(ahead), right / np.linalg.norm(right)
    return quaternion_from_matrix(np.stack([x, np.cross(z, x), z], axis=-1))
