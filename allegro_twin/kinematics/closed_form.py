"""One finger in closed form: `FingerKinematics` puts the forms, the limits, the mirror and the palm frame together."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.euler import angle_between
from allegro_twin.kinematics.family import Chain, inside, resolve
from allegro_twin.kinematics.finger import ImaFinger
from allegro_twin.kinematics.geometry import load_geometry
from allegro_twin.kinematics.nearest import Nearest, search
from allegro_twin.kinematics.planar import Flags
from allegro_twin.kinematics.pose import Pose
from allegro_twin.kinematics.scalar import ScalarKinematics
from allegro_twin.kinematics.solution import Solutions
from allegro_twin.kinematics.target import Target, read_target
from allegro_twin.kinematics.thumb import Thumb
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

_CHUNK = 4096  # Rows at a time: the intermediate arrays then stay in the processor's cache.


class FingerKinematics:
    """Forward and inverse kinematics of one finger of one hand, in the palm frame.

    Joint vectors are the finger's own, shape (..., 4), rad, from the palm outward. The tip is the centre of the
    fingertip sphere. A left finger is solved as the mirrored right one (docs/kinematics.md#mirror).
    """

    def __init__(self, spec: HandSpec, finger: str) -> None:
        joints = spec.finger(finger).joints
        geometry = load_geometry(spec.model, finger)
        self.name, self.lower, self.upper = finger, spec.lower[list(joints)], spec.upper[list(joints)]
        self._chain: Chain = Thumb(geometry) if geometry.is_thumb else ImaFinger(geometry)
        left = spec.side == "left"
        self._reflect = np.array([1.0, -1.0 if left else 1.0, 1.0])
        self._signs = np.array([-1.0 if left and j in spec.mirror_flips else 1.0 for j in joints])
        self.scalar = ScalarKinematics(geometry, self.lower, self.upper, self._signs, left=left)
        """The same for one target at a time on plain numbers, about fifty times faster a call."""

    def fk(self, position: ArrayLike) -> Pose:
        """The fingertip in the palm frame, joints (..., 4), rad → position (..., 3), m, and rotation (..., 3, 3)."""
        joints = np.asarray(position, dtype=np.float64)
        if joints.shape[-1:] != (4,):
            raise ConfigError(f"{self.name} has 4 joints; these positions have shape {joints.shape}")
        q = np.moveaxis(joints * self._signs, -1, 0)
        return Pose(self._to_palm(q), self._orientation(q))

    def ik(
        self,
        position: ArrayLike,
        *,
        pitch: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        euler: ArrayLike | None = None,
        q0: ArrayLike | None = None,
        q1: ArrayLike | None = None,
        psi: ArrayLike | None = None,
        near: ArrayLike | None = None,
        margin: float = 0.0,
    ) -> Solutions:
        """All postures that bring the fingertip to a position in the palm frame, shape (..., 3), m.

        A finger takes with it `pitch` φ = q₁ + q₂ + q₃; the thumb `q0`, `q1` or `psi` = q₂ + q₃; each (...), rad. Or an
        orientation of the tip in the palm, as `rotation` (..., 3, 3), `quaternion` (..., 4) or `euler` (..., 3):
        the position is then exact and the rotation the nearest that a finger can have there, or the one of the thumb
        that has the q₀ of the rotation; if no such branch is inside the limits, the nearest rotation inside them
        stands in the first branch. With none of these, one posture: nearest to `near` (..., 4), rad, or else
        the one furthest from its nearest limit.

        `margin` is taken off both ends of every joint's range, rad. Raises ConfigError for arguments that do not fit.
        """
        given = {"pitch": pitch, "rotation": rotation, "quaternion": quaternion, "euler": euler,
                 "q0": q0, "q1": q1, "psi": psi, "near": near}  # fmt: skip
        target = read_target(self.name, self._chain.geometry.is_thumb, position, given)
        lower, upper = self._limits_within(margin)
        joints, within, angle = self._in_blocks(target, lower, upper)
        k = joints.shape[1]
        return Solutions(
            np.moveaxis(joints, 0, -1).swapaxes(0, 1).reshape(*target.shape, k, 4),
            within.T.reshape(*target.shape, k),
            angle.T.reshape(*target.shape, k),
            lower,
            upper,
            lambda missing, limits: self._nearest(target, missing, lower, upper, limits=limits),
        )

    def _limits_within(self, margin: float) -> tuple[Vector, Vector]:
        half = float((self.upper - self.lower).min()) / 2
        if not 0.0 <= margin < half:
            raise ConfigError(f"{self.name}: margin {margin} rad does not fit; half the least range is {half:.3f} rad")
        return self.lower + margin, self.upper - margin

    def _in_blocks(self, target: Target, lower: Vector, upper: Vector) -> tuple[Array, Flags, Array]:
        """As `_solved`, of all targets."""
        parts = [self._solved(target.rows(k, k + _CHUNK), lower, upper) for k in range(0, max(1, target.n), _CHUNK)]
        if len(parts) == 1:
            return parts[0]
        joints, within, angle = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        return joints, within, angle

    def _solved(self, target: Target, lower: Vector, upper: Vector) -> tuple[Array, Flags, Array]:
        """Joints (4, k, N), within (k, N), residual angle (k, N) of one block of targets."""
        low, high = self._as_right(lower, upper)
        x, y, z = self._in_base(target.position)
        rotation = self._rotation_in_base(target) if target.mode == "rotation" else target.rotation
        if target.mode == "position":
            q, ok = self._preferred(target, (x, y, z), low, high)
        elif target.mode == "rotation":
            q, ok = self._chain.at_rotation(x, y, z, rotation)
        else:
            q, ok = getattr(self._chain, f"at_{target.mode}")(x, y, z, target.angle)
        q, within = inside(q, low, high)
        within &= ok
        if not ok.all():
            q[:, ~ok] = np.nan
        angle = np.zeros(ok.shape)
        if target.mode == "rotation":
            angle = angle_between(self._chain.rotation(q), rotation)
            self._nearest_rotation(q, within, angle, (x, y, z), rotation, low, high)
        q *= self._signs[:, None, None]
        return q, within, angle

    def _preferred(
        self, target: Target, point: tuple[Array, Array, Array], low: Vector, high: Vector
    ) -> tuple[Array, Flags]:
        """Position alone: one branch, the posture nearest to `near`, or the one furthest from its nearest limit."""
        near = target.near

        def distance(q: Array) -> Array:
            assert near is not None
            return np.asarray(np.square(q - (near * self._signs).T[:, None, :]).sum(axis=0))

        def crowding(q: Array) -> Array:
            room = np.minimum(q - low[:, None, None], high[:, None, None] - q)
            return np.asarray(-room.min(axis=0))

        q, cost = resolve(self._chain, *point, low, high, crowding if near is None else distance)
        return q[:, None, :], np.isfinite(cost)[None]

    def _nearest_rotation(
        self,
        q: Array,
        within: Flags,
        angle: Array,
        point: tuple[Array, Array, Array],
        rotation: Array,
        low: Vector,
        high: Vector,
    ) -> None:
        """Where no branch is inside the limits, the first becomes the posture inside them with the nearest rotation."""
        missing = np.flatnonzero(~within.any(axis=0))
        if missing.size == 0:
            return
        wanted = rotation[missing]

        def turned(q: Array) -> Array:
            return angle_between(self._chain.rotation(q), wanted)

        x, y, z = (c[missing] for c in point)
        found, cost = resolve(self._chain, x, y, z, low, high, turned)
        ok = np.isfinite(cost)
        q[:, 0, missing[ok]] = found[:, ok]
        within[0, missing[ok]], angle[0, missing[ok]] = True, cost[ok]

    def _nearest(self, target: Target, missing: Flags, lower: Vector, upper: Vector, *, limits: bool) -> Nearest:
        flat = missing.ravel()
        posture, distance = np.full((target.n, 4), np.nan), np.zeros(target.n)
        point = target.position.copy()
        if flat.any():
            low, high = self._as_right(lower, upper)
            if not limits:
                low, high = (low + high) / 2 - np.pi, (low + high) / 2 + np.pi
            mode = "position" if target.mode == "rotation" else target.mode
            xyz = self._in_base(target.position[flat])
            q, distance[flat] = search(self._chain, mode, xyz, target.angle[flat], low, high)
            posture[flat], point[flat] = (q * self._signs[:, None]).T, self._to_palm(q)
        shape = target.shape
        return Nearest(posture.reshape(*shape, 4), point.reshape(*shape, 3), distance.reshape(shape))

    def _as_right(self, lower: Vector, upper: Vector) -> tuple[Vector, Vector]:
        """The limits of the mirrored finger, whose flipped joints have their ends exchanged."""
        ends = np.stack([lower * self._signs, upper * self._signs])
        return ends.min(axis=0), ends.max(axis=0)

    def _in_base(self, position: Array) -> tuple[Array, Array, Array]:
        """Palm positions (N, 3) as coordinates (N,) in the base frame of the right hand's finger."""
        geometry = self._chain.geometry
        x, y, z = geometry.base.T @ (position * self._reflect - geometry.origin).T
        return x, y, z

    def _rotation_in_base(self, target: Target) -> Array:
        """Bᵀ S R S, shape (N, 3, 3)."""
        reflected = target.rotation * (self._reflect[:, None] * self._reflect)
        return np.asarray(self._chain.geometry.base.T @ reflected)

    def _to_palm(self, q: Array) -> Array:
        """The tip, joints of the right hand (4, ...) → (..., 3)."""
        geometry = self._chain.geometry
        tip = np.stack(self._chain.tip(q), axis=-1) @ geometry.base.T + geometry.origin
        return np.asarray(tip * self._reflect)

    def _orientation(self, q: Array) -> Array:
        """S B R S, joints of the right hand (4, ...) → (..., 3, 3)."""
        rotation = self._chain.geometry.base @ self._chain.rotation(q)
        return np.asarray(rotation * (self._reflect[:, None] * self._reflect))
