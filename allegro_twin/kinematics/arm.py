"""Kinematics and dynamics of an arm with its tool and load, in the base's frame, by Pinocchio."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.arguments import finite
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import Array, Vector

_DAMPING = 1e-4  # Of the inverse near singular postures, m² and rad².
_STEPS, _STEP = 200, 0.2  # rad: the largest step of a joint.
_STALLED, _NEARER = 30, 0.98
"""Steps in which the error must fall to that share: what comes no nearer does not arrive. Of 1,184 goals that 200 steps
reach, in a cell and from random postures, one is given up; a failure takes 50 steps."""


class ToolFrame(NamedTuple):
    """A tool's frame on the flange."""

    position: Array
    """(3,), m."""
    quaternion: Array
    """w x y z."""


FLANGE = ToolFrame(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))


class ArmModel:
    """Rigid-body kinematics and dynamics of an arm with its load. Joint vectors have shape (n,), lists included;
    every method raises ConfigError for other shapes, and for numbers that are not finite.

    `tool` is the frame of poses and Jacobians, on the flange; by default the flange itself.
    """

    def __init__(self, spec: ArmSpec, tool: ToolFrame = FLANGE) -> None:
        path = data_root() / "models" / "urdf" / f"{spec.name}.urdf"
        if not path.is_file():
            raise ConfigError(f"arm {spec.name}: no URDF at {path}")
        self.spec, self.tool, self._model = spec, tool, pin.buildModelFromUrdf(str(path))
        joint = self._model.getJointId(spec.joints[-1])
        on = self._model.frames[self._model.getFrameId(spec.flange)].placement
        place = on * pin.SE3(matrix_from_quaternion(tool.quaternion), np.array(tool.position))
        self._frame = self._model.addFrame(pin.Frame("tool", joint, 0, place, pin.FrameType.OP_FRAME), False)
        self._flange, self._on_flange = self._model.getFrameId(spec.flange), place
        if spec.load is not None:
            weight = pin.Inertia(spec.load.mass, np.array(spec.load.centre), np.zeros((3, 3)))
            self._model.appendBodyToJoint(joint, weight, on)
        self._model.armature = np.array(spec.actuation.armature)
        self._model.gravity.linear = np.zeros(3)  # The arm carries itself.
        self._data = self._model.createData()

    def pose(self, position: ArrayLike) -> Pose:
        """Pose of the tool."""
        return self._pose(self._frame, position)

    def flange(self, position: ArrayLike) -> Pose:
        """Pose of the flange."""
        return self._pose(self._flange, position)

    def _pose(self, frame: int, position: ArrayLike) -> Pose:
        pin.framesForwardKinematics(self._model, self._data, self._joints("position", position))
        found = self._data.oMf[frame]
        return Pose(found.translation.copy(), found.rotation.copy())

    def _joints(self, what: str, value: ArrayLike) -> Vector:
        return finite(f"{self.spec.name}: {what}", value, self.spec.n_joints)

    def motion(self, position: ArrayLike) -> tuple[Array, Array, Array]:
        """The tool's place (3,), m, its axes (3, 3), and the J in (v; ω) = J q̇, (6, n), in the axes of the base."""
        return self._motion(self._joints("position", position))

    def _motion(self, position: Vector) -> tuple[Array, Array, Array]:
        data = self._data
        pin.computeJointJacobians(self._model, data, position)
        frame = pin.updateFramePlacement(self._model, data, self._frame)
        jacobian = pin.getFrameJacobian(self._model, data, self._frame, pin.LOCAL_WORLD_ALIGNED)
        return frame.translation.copy(), frame.rotation.copy(), jacobian

    def coriolis(self, position: ArrayLike, velocity: ArrayLike) -> Vector:
        """C(q, q̇) q̇, N·m."""
        q, speed = self._joints("position", position), self._joints("velocity", velocity)
        return np.array(pin.nonLinearEffects(self._model, self._data, q, speed))

    def momentum(self, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
        """M q̇ with the rotors, N·m·s, and C(q, q̇)ᵀ q̇, N·m: the momentum, and what changes it without any torque."""
        q, speed = self._joints("position", position), self._joints("velocity", velocity)
        bias: Vector = pin.computeCoriolisMatrix(self._model, self._data, q, speed).T @ speed
        momentum: Vector = pin.crba(self._model, self._data, q) @ speed
        return momentum, bias

    def inertia(self, position: ArrayLike) -> Array:
        """M(q) with the rotors, (n, n), kg·m²."""
        return np.array(pin.crba(self._model, self._data, self._joints("position", position)))

    def light(self, link: float = 0.1, tip: float = 1.0) -> ArmModel:
        """Copy of the chain with light masses: each link a point of `link` kg at its joint, and at the tool a body of
        `tip` kg and as many kg·m²."""
        other = ArmModel(self.spec, self.tool)
        nothing = np.zeros(3)
        for joint in range(1, other._model.njoints):
            # 1e-6: so that no joint is without inertia.
            other._model.inertias[joint] = pin.Inertia(link, nothing, 1e-6 * np.eye(3))
        other._model.inertias[other._model.njoints - 1] = self._on_flange.act(
            pin.Inertia(tip, nothing, tip * np.eye(3))
        )
        other._model.armature = np.zeros(self.spec.n_joints)
        other._data = other._model.createData()
        return other

    def reach(self, wanted: Pose, near: ArrayLike, tolerance: float = 1e-4) -> Vector:
        """Joint positions inside the limits with the tool at a pose, found from nearby ones. Raises ConfigError with
        how near it came, when that is not within `tolerance`, m and rad."""
        spec, start = self.spec, self._joints("near", near)
        at = start
        place = finite(f"{spec.name}: wanted position", wanted.position, 3)
        goal = pin.SE3(finite(f"{spec.name}: wanted rotation", wanted.rotation, 3, 3), place)
        best = list[float]()
        for count in range(_STEPS):
            place, axes, jacobian = self._motion(at)
            error = np.concatenate([goal.translation - place, pin.log3(goal.rotation @ axes.T)])
            largest = float(np.abs(error).max())
            best.append(min(largest, best[-1]) if best else largest)
            if largest < tolerance * 0.1 or (count >= _STALLED and best[-1] > _NEARER * best[count - _STALLED]):
                break
            inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + _DAMPING * np.eye(6))
            # The redundant motion returns to the start.
            step = inverse @ error + 0.1 * ((start - at) - inverse @ (jacobian @ (start - at)))
            at = np.clip(at + step * min(1.0, _STEP / max(float(np.abs(step).max()), 1e-9)), spec.lower, spec.upper)
        place, axes, _ = self._motion(at)
        short, angle = np.linalg.norm(goal.translation - place), np.linalg.norm(pin.log3(goal.rotation @ axes.T))
        if max(short, angle) > tolerance:
            raise ConfigError(
                f"{spec.name} does not reach {np.round(wanted.position, 3).tolist()} m with that orientation: it stays "
                f"{1e3 * short:.1f} mm and {np.degrees(angle):.1f}° short; ask for one nearer, or turned less"
            )
        return at


def rotation_between(axes: Array, wanted: Array) -> Vector:
    """The rotation vector that turns one orientation (3, 3) into another, in the axes of the base, (3,), rad."""
    found: Vector = pin.log3(wanted @ axes.T)
    return found


def rotate(axes: Array, vector: Vector) -> Array:
    """An orientation (3, 3) turned by a rotation vector, (3,), rad, in the axes of the base."""
    return np.asarray(pin.exp3(vector) @ axes)
