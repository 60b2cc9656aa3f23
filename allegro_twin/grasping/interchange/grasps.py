"""Grasps of one hand on one object, as arrays: what every format becomes, and is written from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_conjugate, quaternion_product
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

STAGES = ("preshape", "close", "squeeze")
"""The last three that a grasp goes through; what comes before them is its approach."""
FARTHEST = 2.0
"""m between palm and object, or of the object from the origin: no hand is so large, so the file has another unit."""
_UNIT = 0.01
"""How far from 1 a quaternion may be: of 4-digit text, say; beyond, it is something else."""


@dataclass(frozen=True, slots=True)
class PalmFrame:
    """Frame of the hand whose pose a format gives."""

    name: str
    palm: tuple[float, float, float, float]
    """Our palm in it: a turn about its origin, w x y z."""


PALM = PalmFrame("palm", (1.0, 0.0, 0.0, 0.0))
"""Ours, and the root of the manufacturer's URDF: x out of the palm, z to the fingertips. BODex, DexGraspNet;
every file of another hand that names no frame."""
MENAGERIE = PalmFrame("menagerie", (0.0, 0.5**0.5, 0.0, 0.5**0.5))
"""The world of Menagerie's file, in which its palm is turned (`quat="0 1 0 1"`): z out of the palm, x to the
fingertips. DexGraspBench hangs that world on a free joint, and what follows it does the same."""
FRAMES = {frame.name: frame for frame in (PALM, MENAGERIE)}


@dataclass(frozen=True, slots=True, eq=False)
class Grasps:
    """k grasps in s ≥ 3 stages: an approach, if there is one, then `STAGES`. Poses are positions, m, and quaternions
    w x y z. Raises ConfigError, in a line, for what cannot be: see `check_grasps`."""

    hand: Array
    """Poses of the `frame` in the file's world, (k, s, 7)."""
    joints: Array
    """In the spec's order, (k, s, n), rad; what a squeeze asks for may lie outside the limits."""
    object_pose: Array
    """In the file's world, (k, 7)."""
    scale: Vector
    """Scale of the object's mesh: file units to m, (k,)."""
    object: str
    """Its file or name, as it was written."""
    spec: HandSpec
    """The hand that they are of."""
    frame: PalmFrame
    source: str
    """The file that they are from, and what was added to it."""

    def __len__(self) -> int:
        return len(self.joints)

    @property
    def palm(self) -> Array:
        """Our palm in the frame of the object's file, (k, s, 7)."""
        back = quaternion_conjugate(_unit(self.object_pose[:, None, 3:]))
        turn = matrix_from_quaternion(back)
        position = np.einsum("koij,ksj->ksi", turn, self.hand[..., :3] - self.object_pose[:, None, :3])
        hand = quaternion_product(np.broadcast_to(back, self.hand[..., 3:].shape), _unit(self.hand[..., 3:]))
        return np.concatenate(
            [position, quaternion_product(hand, np.broadcast_to(self.frame.palm, hand.shape))], axis=-1
        )

    def palm_from(self, middle: ArrayLike) -> Array:
        """The palm from another origin in the object, (3,), m, in its file's axes: from the middle of its mesh
        (`meshes.mesh_middle`), say, which is where the frame of an object in a scene is."""
        shift = np.append(np.asarray(middle, dtype=np.float64), np.zeros(4))
        return self.palm - shift

    @property
    def approach(self) -> Array:
        """(k, s − 3, n), rad."""
        return self.joints[:, :-3]

    @property
    def preshape(self) -> Array:
        """(k, n), rad."""
        return self.joints[:, -3]

    @property
    def close(self) -> Array:
        """(k, n), rad."""
        return self.joints[:, -2]

    @property
    def squeeze(self) -> Array:
        """(k, n), rad."""
        return self.joints[:, -1]

    def pick(self, rows: ArrayLike) -> Grasps:
        """Some of them: numbers, or one for each whether it stays."""
        chosen = np.atleast_1d(np.asarray(rows))
        return replace(
            self,
            hand=self.hand[chosen],
            joints=self.joints[chosen],
            object_pose=self.object_pose[chosen],
            scale=self.scale[chosen],
        )

    def within(self, spec: HandSpec) -> Grasps:
        """Copy with every joint inside its limits, as a position controller needs."""
        return replace(self, joints=np.clip(self.joints, spec.lower, spec.upper))

    def in_frame(self, frame: PalmFrame) -> Grasps:
        """Copy with the hand's poses in another of its frames; nothing is rounded where it is that one already."""
        if frame == self.frame:
            return self
        turn = quaternion_product(np.array(self.frame.palm), quaternion_conjugate(np.array(frame.palm)))
        turned = quaternion_product(self.hand[..., 3:], np.broadcast_to(turn, self.hand[..., 3:].shape))
        return replace(self, hand=np.concatenate([self.hand[..., :3], turned], axis=-1), frame=frame)


def check_hand(hand: object, side: object, spec: HandSpec, where: str) -> None:
    """Raises ConfigError for a file of another hand. `hand`, `side`: as it says; None: it does not."""
    if hand is not None and hand != spec.model:
        raise ConfigError(f"{where}: is of the hand {hand}; this one is {spec.model}: ask for {hand} (--hand)")
    if side is not None and side != spec.side:
        raise ConfigError(f"{where}: is of a {side} hand; this one is a {spec.side} hand")


def check_grasps(
    spec: HandSpec, hand: ArrayLike, joints: ArrayLike, object_pose: ArrayLike, scale: ArrayLike, *,
    object_name: str, frame: PalmFrame, source: str,
) -> Grasps:  # fmt: skip
    """Grasps from arrays that fit each other; one pose and one scale of the object stand for all.

    Raises ConfigError for an empty set, numbers that are not finite, quaternions that are none, scales not above 0, and
    lengths that cannot be metres.
    """
    poses, angles = frozen(hand), frozen(joints)
    if not len(poses):
        raise ConfigError(f"{source}: holds no grasp")
    object_poses = frozen(np.broadcast_to(np.asarray(object_pose, dtype=np.float64), (len(poses), 7)))
    scales = frozen(np.broadcast_to(np.asarray(scale, dtype=np.float64), (len(poses),)))
    for name, values in (("hand pose", poses), ("joints", angles), ("object pose", object_poses), ("scale", scales)):
        _finite(values, name, source)
    for name, quaternion in (("hand", poses[..., 3:]), ("object", object_poses[:, 3:])):
        size = _length(quaternion)
        if np.abs(size - 1.0).max() > _UNIT:
            bad = np.unravel_index(np.abs(size - 1.0).argmax(), size.shape)
            raise ConfigError(
                f"{source}: grasp {bad[0]}: the {name}'s quaternion {_short(quaternion[bad])} has length "
                f"{size[bad]:.3g}, not 1: a pose is x y z, m, then w x y z"
            )
    if scales.min() <= 0.0:
        raise ConfigError(f"{source}: the object's scale is {scales.min():g}; it must be above 0")
    _metres(poses, object_poses, source)
    return Grasps(poses, angles, object_poses, scales, object_name, spec, frame, source)


def _metres(poses: Array, object_poses: Array, source: str) -> None:
    for what, offset in (
        ("the object is {} from the origin", object_poses[:, None, :3]),
        ("the hand is {} from the object", poses[..., :3] - object_poses[:, None, :3]),
    ):
        distance = float(_length(offset).max())
        if distance > FARTHEST:
            said = what.format(f"{distance:.4g} m")
            raise ConfigError(f"{source}: {said}: are its lengths millimetres? They are read as m; divide them by 1000")


def _finite(values: Array, name: str, source: str) -> None:
    if not np.isfinite(values).all():
        row = int(np.argwhere(~np.isfinite(values))[0][0])
        bad = values[row][~np.isfinite(values[row])].flat[0]
        raise ConfigError(f"{source}: grasp {row}: {name} holds {bad}; every number must be finite")


def _short(values: Array) -> str:
    return f"[{', '.join(f'{value:.4g}' for value in values)}]"


def _length(vectors: Array) -> Array:
    """Infinite where it is larger than any number: what has it is refused for its size."""
    with np.errstate(over="ignore"):
        size: Array = np.linalg.norm(vectors, axis=-1)
    return size


def _unit(quaternion: Array) -> Array:
    scaled: Array = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return scaled
