"""The whole hand in Pinocchio: fingertip poses, Jacobians and gravity torque, in the palm frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.arguments import finite, numbers, shown
from allegro_twin.kinematics.closed_form.forms.maths import ARRAYS
from allegro_twin.kinematics.coupling import Moving
from allegro_twin.kinematics.orientation import entries_of_matrix, is_rotation
from allegro_twin.kinematics.pose import Pose as Pose
from allegro_twin.kinematics.tree import Tree, built
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector


class HandModel:
    """Rigid-body kinematics and statics of one hand. Joint vectors follow the spec's order, shape (n,), rad, lists
    included; every method raises ConfigError for other shapes, and for positions that are not finite."""

    def __init__(self, spec: HandSpec, source: Path | Tree | None = None) -> None:
        """From a URDF, by default the hand's own, or from a tree of links. Raises ConfigError."""
        if source is None and spec.foreign is not None:
            raise ConfigError(
                f"hand {spec.serial} is simulated from {spec.foreign.mjcf}: sim.statics.hand_model has its model"
            )
        self._model = built(source) if isinstance(source, Tree) else _from_urdf(spec, source)
        self._data = self._model.createData()
        self._moving = Moving(spec, self._model)
        self._tips = {finger.name: self._model.getFrameId(finger.tip) for finger in spec.fingers}
        self._links = {frame.name: index for index, frame in enumerate(self._model.frames) if _is_link(frame)}
        self._spec, self._n, self._gravity = spec, spec.n_joints, np.full(3, np.nan)

    def gravity_torque(self, position: ArrayLike, gravity: ArrayLike) -> Vector:
        """The torques that hold the hand still against gravity: g(q) = ∂V/∂q, shape (n,), N·m.

        `gravity` is the acceleration in the palm frame, shape (3,), m/s². Of many postures at once: (k, n) and (k, 3).
        Where gravity is NaN, as of a hand that does not feel it, so is what depends on it.
        """
        q, down = self._checked(position, gravity)
        if q.ndim == 1:
            return self._held(q, down)
        return np.array([self._held(*each) for each in zip(q, down, strict=True)]).reshape(q.shape)

    def _held(self, position: Vector, gravity: Vector) -> Vector:
        if not np.array_equal(gravity, self._gravity):
            self._model.gravity.linear = self._gravity = gravity.copy()
        torque: Vector = pin.computeGeneralizedGravity(self._model, self._data, self._moving.configuration(position))
        return self._moving.driven(torque, position)

    def _checked(self, position: ArrayLike, gravity: ArrayLike) -> tuple[Vector, Vector]:
        """As arrays, if they belong together."""
        n, q, down = self._n, numbers("position", position), numbers("gravity", gravity)
        if q.ndim not in (1, 2) or q.shape[-1] != n or down.shape != (*q.shape[:-1], 3):
            raise ConfigError(
                f"gravity_torque needs positions of shape ({n},) and gravity of shape (3,), or (k, {n}) and (k, 3); "
                f"these have {q.shape} and {down.shape}"
            )
        if np.isinf(down).any():
            raise ConfigError(f"gravity must be finite, m/s²; it is {down.tolist()}")
        return finite("position", q, *q.shape), down

    def fingertips(self, position: ArrayLike) -> dict[str, Pose]:
        """Centre and orientation of every fingertip."""
        return self._poses(self._tips, position)

    def links(self, position: ArrayLike) -> dict[str, Pose]:
        """Pose of every moving link, fingertips included, by its name in the URDF."""
        return self._poses(self._links, position)

    def fingertip_force(self, position: ArrayLike, torque_limit: ArrayLike) -> dict[str, float]:
        """How hard each fingertip can press with its pad at a posture, N.

        Along the tip's x axis n (out of the pad) a force f needs τ = Jᵀ n f, so f = min over joints of limit / |Jᵀ n|;
        infinite where no joint moves the tip along it.
        """
        limit, forces = numbers("torque_limit", torque_limit), {}
        if limit.shape != (self._n,) or not (limit >= 0.0).all():
            raise ConfigError(
                f"torque_limit needs {self._n} numbers ≥ 0, N·m, shape ({self._n},); it is {shown(torque_limit)}"
            )
        for name, jacobian in self._jacobians(position, pin.LOCAL).items():
            lever = np.abs(jacobian[0])
            forces[name] = float((limit[lever > 1e-6] / lever[lever > 1e-6]).min(initial=np.inf))
        return forces

    def jacobian(self, position: ArrayLike, palm: ArrayLike | None = None) -> dict[str, Array]:
        """Of every fingertip the J in (v; ω) = J q̇, shape (6, n): velocity of its centre, m/s, then its spin, rad/s.

        In the axes of the palm; or in the world's, if `palm` is the palm's orientation there, shape (3, 3). The columns
        are all the hand's joints, in the spec's order; those of other fingers are zero. The palm stands still.
        """
        found = self._jacobians(position, pin.LOCAL_WORLD_ALIGNED)
        if palm is None:
            return found
        axes = finite("palm, a rotation matrix,", palm, 3, 3)
        if not is_rotation(ARRAYS, entries_of_matrix(axes)):
            raise ConfigError(
                f"palm is no rotation matrix: its columns must be orthonormal, right-handed; it is {axes.tolist()}"
            )
        turn = np.kron(np.eye(2), axes)
        return {name: turn @ jacobian for name, jacobian in found.items()}

    def manipulability(self, position: ArrayLike) -> dict[str, float]:
        """How freely each fingertip's centre can be moved: w = √det(Jᵥ Jᵥᵀ) of the linear rows, m³/rad³.

        Yoshikawa, "Manipulability of robotic mechanisms", IJRR 4(2), 1985. Zero where the tip is stuck in a direction.
        """
        found = self._jacobians(position, pin.LOCAL_WORLD_ALIGNED)
        # The product of the singular values: a determinant of Jᵥ Jᵥᵀ can come out below zero.
        return {name: float(np.linalg.svd(j[:3], compute_uv=False).prod()) for name, j in found.items()}

    def _jacobians(self, position: ArrayLike, axes: pin.ReferenceFrame) -> dict[str, Array]:
        q = finite("position", position, self._n)
        pin.computeJointJacobians(self._model, self._data, self._moving.configuration(q))
        pin.updateFramePlacements(self._model, self._data)
        return {
            name: self._moving.driven(pin.getFrameJacobian(self._model, self._data, index, axes), q)
            for name, index in self._tips.items()
        }

    def _poses(self, frames: dict[str, int], position: ArrayLike) -> dict[str, Pose]:
        q = finite("position", position, self._n)
        pin.framesForwardKinematics(self._model, self._data, self._moving.configuration(q))
        placed = {name: self._data.oMf[index] for name, index in frames.items()}
        return {name: Pose(frame.translation.copy(), frame.rotation.copy()) for name, frame in placed.items()}

    def fingertip_jacobians(self, position: ArrayLike, fingers: Sequence[str]) -> tuple[Array, Array]:
        """Positions (k, 3), m, and translational Jacobians (k, 3, n), m/rad, of some fingertips, in the palm frame."""
        q = finite("position", position, self._n)
        frames = [self._tips[self._spec.finger(finger).name] for finger in fingers]
        pin.computeJointJacobians(self._model, self._data, self._moving.configuration(q))
        pin.updateFramePlacements(self._model, self._data)
        places = np.array([self._data.oMf[frame].translation for frame in frames]).reshape(-1, 3)
        aligned = pin.LOCAL_WORLD_ALIGNED
        jacobians = [pin.getFrameJacobian(self._model, self._data, f, aligned)[:3] for f in frames]
        return places, self._moving.driven(np.array(jacobians).reshape(-1, 3, self._model.nv), q)


def _from_urdf(spec: HandSpec, urdf: Path | None) -> pin.Model:
    """A joint that the spec does not know stays at zero."""
    path = data_root() / "models" / "urdf" / f"{spec.name}.urdf" if urdf is None else Path(urdf)
    if not path.is_file():
        raise ConfigError(f"hand {spec.name}: no URDF at {path}")
    try:
        model = pin.buildModelFromUrdf(str(path))
    except (RuntimeError, ValueError) as error:
        raise ConfigError(f"hand {spec.name}: {path} is no URDF that can be read") from error
    # The motors of tendons move no joint of their own.
    needed = [*(each.name for each in spec.followers), *(() if spec.followers else spec.joints)]
    missing = [name for name in needed if not model.existJointName(name)]
    missing += [finger.tip for finger in spec.fingers if not model.existFrame(finger.tip)]
    if missing:
        raise ConfigError(f"hand {spec.name}: {path} has no {', '.join(missing[:3])}{', ...' * (len(missing) > 3)}")
    known = {*spec.joints, *(each.name for each in spec.followers)}
    others = [number for number, name in enumerate(model.names) if number and name not in known]
    return pin.buildReducedModel(model, others, pin.neutral(model)) if others else model


def _is_link(frame: pin.Frame) -> bool:
    """Whether a frame is a link that moves."""
    return bool(frame.type == pin.FrameType.BODY and frame.parentJoint > 0)
