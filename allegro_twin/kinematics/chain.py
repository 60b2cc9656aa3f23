"""One finger's chain of hinges and slides, from the palm to its tip: forward kinematics and Jacobian, one or many.

Every joint turns about, or slides along, the z axis of its own frame: T = Π (Cⱼ, dⱼ) Z(qⱼ) · (C_tip, d_tip), where
qⱼ is the motor's position, or by a table what follows the motor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector


class Law(NamedTuple):
    """Position of a joint as a function of its motor's position."""

    motor: int
    """Place among the finger's motors; -1: none of them moves it."""
    lower: float
    """Lower limit of the motor, rad."""
    per_step: float
    """Steps of the table in a radian of the motor; 0: the joint is where its motor is."""
    table: tuple[float, ...]
    """Joint positions at even steps of the motor, rad or m; one constant position for a joint that no motor of the
    finger moves."""


class FingerChain:
    """The chain of one finger, for its k motors in the spec's order."""

    def __init__(self, spec: HandSpec, model: pin.Model, finger: str, rest: Vector) -> None:
        """`rest`: the model's configuration at rest, where joints stay that the finger's motors do not move."""
        tip = model.frames[model.getFrameId(spec.finger(finger).tip)]
        motors = list(spec.finger(finger).joints)
        path, joint = [], int(tip.parentJoint)
        while joint:
            path.append(joint)
            joint = int(model.parents[joint])
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        self.laws, self.slides, self.turns, self.shifts = [], [], [], []
        to_z = np.eye(3)
        for joint in reversed(path):
            screw = np.asarray(pin.getJointJacobian(model, data, joint, pin.LOCAL))[:, model.idx_vs[joint]]
            slides = not np.abs(screw[3:]).max() > 1e-9
            axis = screw[:3] if slides else screw[3:]
            placement, onto = model.jointPlacements[joint], _onto_z(axis)
            self.turns.append(to_z.T @ placement.rotation @ onto)
            self.shifts.append(to_z.T @ placement.translation)
            self.slides.append(slides)
            self.laws.append(_law(spec, motors, model.names[joint], float(rest[model.idx_qs[joint]])))
            to_z = onto
        self.turns.append(to_z.T @ tip.placement.rotation)
        self.shifts.append(to_z.T @ tip.placement.translation)
        self.k = len(motors)
        held = {*spec.joints, *(each.name for each in spec.followers)}
        self.elsewhere = any(law.motor < 0 and model.names[joint] in held
                             for law, joint in zip(self.laws, reversed(path), strict=True))  # fmt: skip
        """Whether the hand has motors between root and finger that are not the finger's, such as a wrist's."""
        self._flat = [(*turn.T.ravel().tolist(), *shift.tolist()) for turn, shift in zip(self.turns, self.shifts,
                                                                                         strict=True)]  # fmt: skip

    def one(self, q: Sequence[float]) -> tuple[list[float], list[list[float]]]:
        """The tip of one posture, (3,), m, and the columns of its Jacobian, (k, 3), m/rad; in plain floats, for NumPy
        takes longer to begin than this takes."""
        xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
        px = py = pz = 0.0
        marks = []
        for (a, b, c, d, e, f, g, h, i, sx, sy, sz), law, slide in zip(
            self._flat, self.laws, self.slides, strict=False
        ):
            px += xx * sx + yx * sy + zx * sz
            py += xy * sx + yy * sy + zy * sz
            pz += xz * sx + yz * sy + zz * sz
            ux, uy, uz = xx * a + yx * b + zx * c, xy * a + yy * b + zy * c, xz * a + yz * b + zz * c
            vx, vy, vz = xx * d + yx * e + zx * f, xy * d + yy * e + zy * f, xz * d + yz * e + zz * f
            zx, zy, zz = xx * g + yx * h + zx * i, xy * g + yy * h + zy * i, xz * g + yz * h + zz * i
            motor, lower, per_step, table = law
            slope = 1.0
            if motor < 0:
                angle = table[0]
            elif per_step:
                part = (q[motor] - lower) * per_step
                step = min(max(int(part), 0), len(table) - 2)
                rise = table[step + 1] - table[step]
                angle, slope = table[step] + (part - step) * rise, rise * per_step
            else:
                angle = q[motor]
            if slide:
                xx, xy, xz, yx, yy, yz = ux, uy, uz, vx, vy, vz
                px, py, pz = px + zx * angle, py + zy * angle, pz + zz * angle
            else:
                s, co = math.sin(angle), math.cos(angle)
                xx, xy, xz = co * ux + s * vx, co * uy + s * vy, co * uz + s * vz
                yx, yy, yz = co * vx - s * ux, co * vy - s * uy, co * vz - s * uz
            if motor >= 0:
                marks.append((motor, slide, slope, zx, zy, zz, px, py, pz))
        sx, sy, sz = self._flat[-1][9:]
        tx, ty, tz = (
            px + xx * sx + yx * sy + zx * sz,
            py + xy * sx + yy * sy + zy * sz,
            pz + xz * sx + yz * sy + zz * sz,
        )
        columns = [[0.0, 0.0, 0.0] for _ in range(self.k)]
        for motor, slide, slope, ax, ay, az, ox, oy, oz in marks:
            column = columns[motor]
            if slide:
                column[0] += slope * ax
                column[1] += slope * ay
                column[2] += slope * az
            else:
                rx, ry, rz = tx - ox, ty - oy, tz - oz
                column[0] += slope * (ay * rz - az * ry)
                column[1] += slope * (az * rx - ax * rz)
                column[2] += slope * (ax * ry - ay * rx)
        return [tx, ty, tz], columns

    def many(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """Forward kinematics of postures (k, N), rad: tips (3, N), m; tip axes (3, 3, N) as columns; Jacobians of
        position (k, 3, N) and of rotation (k, 3, N)."""
        n = q.shape[1]
        x, y, z = (np.repeat(np.eye(3)[:, k : k + 1], n, axis=1) for k in range(3))
        p = np.zeros((3, n))
        marks = []
        for turn, shift, law, slide in zip(self.turns, self.shifts, self.laws, self.slides, strict=False):
            p = p + x * shift[0] + y * shift[1] + z * shift[2]
            u, v, z = (x * turn[0, k] + y * turn[1, k] + z * turn[2, k] for k in range(3))
            angle, slope = _followed(law, q)
            if slide:
                x, y, p = u, v, p + z * angle
            else:
                s, c = np.sin(angle), np.cos(angle)
                x, y = c * u + s * v, c * v - s * u
            if law.motor >= 0:
                marks.append((law.motor, slide, slope, z, p))
        turn, shift = self.turns[-1], self.shifts[-1]
        tip = p + x * shift[0] + y * shift[1] + z * shift[2]
        axes = np.stack([x * turn[0, k] + y * turn[1, k] + z * turn[2, k] for k in range(3)])
        moves, spins = np.zeros((2, self.k, 3, n))
        for motor, slide, slope, axis, origin in marks:
            moves[motor] += slope * (axis if slide else _cross(axis, tip - origin))
            if not slide:
                spins[motor] += slope * axis
        return tip, axes, moves, spins


def _law(spec: HandSpec, motors: list[int], name: str, rest: float) -> Law:
    if name in spec.joints:
        number = spec.joints.index(name)
        return Law(motors.index(number), 0.0, 0.0, ()) if number in motors else Law(-1, 0.0, 0.0, (rest,))
    follower = next((each for each in spec.followers if each.name == name), None)
    if follower is None or follower.driven not in motors:
        return Law(-1, 0.0, 0.0, (rest,))
    lower, upper = float(spec.lower[follower.driven]), float(spec.upper[follower.driven])
    table = tuple(float(each) for each in follower.positions)
    return Law(motors.index(follower.driven), lower, (len(table) - 1) / (upper - lower), table)


def _followed(law: Law, q: Array) -> tuple[Array | float, Array | float]:
    """Positions and slopes of a joint for postures (k, N)."""
    if law.motor < 0:
        return law.table[0], 0.0
    if not law.per_step:
        return q[law.motor], 1.0
    table = np.array(law.table)
    part = (q[law.motor] - law.lower) * law.per_step
    step = np.clip(part.astype(np.int64), 0, len(table) - 2)
    rise = np.diff(table)[step]
    return table[step] + (part - step) * rise, rise * law.per_step


def _cross(a: Array, b: Array) -> Array:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _onto_z(axis: Vector) -> Array:
    """A rotation whose z axis is the given direction."""
    z = axis / np.linalg.norm(axis)
    across = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(across, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
