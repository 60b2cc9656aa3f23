"""Kinematics and statics of a whole hand: fingertips, links, Jacobians, gravity torque, and a solver for a finger."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.arguments import finite, numbers, short_repr
from allegro_twin.kinematics.chain import FingerChain
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.closed_form.geometry import has_closed_form
from allegro_twin.kinematics.finger import FingerKinematics
from allegro_twin.kinematics.fingertips import ChainFingertips, ClosedFormFingertips
from allegro_twin.kinematics.maths import ARRAYS
from allegro_twin.kinematics.numeric import NumericFinger
from allegro_twin.kinematics.orientation import entries_of_matrix, is_rotation
from allegro_twin.kinematics.pose import Pose
from allegro_twin.kinematics.tree import Tree, link_tree, pinocchio_model
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

_SAME = 0.001  # m. Two models whose fingertips are this close together have the same geometry.
_STEP = 1e-6  # Of a driven joint's range: half the width of a difference quotient.


def hand_kinematics(spec: HandSpec) -> HandKinematics:
    """Kinematics and statics of any hand, from the model file that its spec names: our URDF, or somebody else's MJCF.

    Raises ConfigError where that file is missing or is not of this hand.
    """
    return HandKinematics(spec)


class HandKinematics:
    """Rigid-body kinematics and statics of one hand, in the palm frame; a finger's inverse kinematics by `finger`.

    A posture is what the spec's joints, or motors, are at: shape (n,), rad; lists are as good as arrays. Every method
    raises ConfigError for another shape, and for a posture that is not finite. Joints that follow a motor are where
    they are when nothing is in their way. An object is not shared between threads.
    """

    def __init__(self, spec: HandSpec, source: Path | Tree | None = None) -> None:
        """`source`: a URDF or a tree of links, instead of the model file that the spec names. Raises ConfigError."""
        if source is None and spec.foreign is not None:
            source = link_tree(spec)
        self.spec = spec
        self._model = pinocchio_model(source) if isinstance(source, Tree) else _from_urdf(spec, source)
        self._data = self._model.createData()
        self._coupling = _Coupling(spec, self._model)
        self._tips = {finger.name: self._model.getFrameId(finger.tip) for finger in spec.fingers}
        self._links = {frame.name: index for index, frame in enumerate(self._model.frames) if _is_link(frame)}
        self._n, self._gravity = spec.n_joints, b""
        self._fingers: dict[str, FingerKinematics] = {}

    def finger(self, name: str, posture: ArrayLike | None = None) -> FingerKinematics:
        """Forward and inverse kinematics of one finger: in closed form where its axes have one, else by iteration.

        `posture`, (n,), rad, says where joints are that move the finger and are not its own, such as a wrist's; None:
        where they rest.

        Raises ConfigError for an unknown name, and for a finger whose closed form does not have the fingertip where
        somebody else's model has it.
        """
        if name not in self._fingers:
            closed = has_closed_form(self.spec.model, self.spec.finger(name).name)
            if closed:
                self.check_closed_form([name])
            self._fingers[name] = ClosedFormFinger(self.spec, name) if closed else self.numeric(name)
        found = self._fingers[name]
        if posture is not None and isinstance(found, NumericFinger) and found.elsewhere:
            return self.numeric(name, posture)
        return found

    def numeric(self, name: str, posture: ArrayLike | None = None) -> NumericFinger:
        """A finger by iteration, whatever its axes; `posture` as for `finger`."""
        place = np.asarray(self.spec.rest) if posture is None else finite("posture", posture, self._n)
        rest = self._coupling.configuration(place)
        finger = self.spec.finger(name).name
        return NumericFinger(self.spec, FingerChain(self.spec, self._model, finger, rest), finger)

    def check_closed_form(self, fingers: Iterable[str], position: ArrayLike | None = None) -> None:
        """Raise ConfigError, with the distance, where somebody else's model of the hand has a fingertip elsewhere than
        its closed form; at a posture, by default the one nearest to zero."""
        foreign = self.spec.foreign
        if foreign is None or foreign.keeps:
            return
        posture = self.spec.rest if position is None else np.asarray(position)
        tips = self.fingertips(posture)
        for name in fingers:
            closed = ClosedFormFinger(self.spec, name).fk(posture[list(self.spec.finger(name).joints)]).position
            apart = float(np.linalg.norm(closed - tips[name].position))
            if apart > _SAME:
                raise ConfigError(
                    f"{name}: the closed form has the fingertip {apart * 1000:.1f} mm from where "
                    f"{foreign.mjcf} has it; only hands of the nominal geometry move fingertips: use move_to"
                )

    def batch_fingertips(self, xp: Any = np) -> Callable[[Array], Array]:
        """A function for all fingertips of many postures: (..., n), rad → (..., fingers, 3), m, in the spec's order.

        A row comes out the same whatever the size of its batch. `xp`: the library of the arrays
        (allegro_twin/array_api.py); without a closed form NumPy's alone.
        """
        if all(has_closed_form(self.spec.model, finger.name) for finger in self.spec.fingers):
            return ClosedFormFingertips(self.spec, xp)
        return ChainFingertips(self.spec, link_tree(self.spec))

    def fingertips(self, position: ArrayLike) -> dict[str, Pose]:
        """Centre and orientation of every fingertip."""
        return self._poses(self._tips, position)

    def links(self, position: ArrayLike) -> dict[str, Pose]:
        """Pose of every moving link, fingertips included, by its name in the model file."""
        return self._poses(self._links, position)

    def jacobian(self, position: ArrayLike, palm: ArrayLike | None = None) -> dict[str, Array]:
        """J of every fingertip in (v; ω) = J q̇, shape (6, n): velocity of its centre, m/s, then its spin, rad/s.

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

    def fingertip_jacobians(self, position: ArrayLike, fingers: Sequence[str]) -> tuple[Array, Array]:
        """Positions (k, 3), m, and translational Jacobians (k, 3, n), m/rad, of some fingertips, in the palm frame."""
        q = finite("position", position, self._n)
        frames = [self._tips[self.spec.finger(finger).name] for finger in fingers]
        pin.computeJointJacobians(self._model, self._data, self._coupling.configuration(q))
        pin.updateFramePlacements(self._model, self._data)
        places = np.array([self._data.oMf[frame].translation for frame in frames]).reshape(-1, 3)
        aligned = pin.LOCAL_WORLD_ALIGNED
        jacobians = [pin.getFrameJacobian(self._model, self._data, f, aligned)[:3] for f in frames]
        return places, self._coupling.driven(np.array(jacobians).reshape(-1, 3, self._model.nv), q)

    def gravity_torque(self, position: ArrayLike, gravity: ArrayLike) -> Vector:
        """The torques that hold the hand still against gravity: g(q) = ∂V/∂q, shape (n,), N·m.

        `gravity` is the acceleration in the palm frame, shape (3,), m/s². Of many postures at once: (k, n) and (k, 3).
        Where gravity is NaN, as of a hand that does not measure it, so is what depends on it.
        """
        q, down = self._posture_and_gravity(position, gravity)
        if q.ndim == 1:
            return self._gravity_torque(q, down)
        if not self._coupling.direct:
            return np.array([self._gravity_torque(*each) for each in zip(q, down, strict=True)]).reshape(q.shape)
        placed, torque = self._coupling.configuration(q), np.empty_like(q)
        turned = np.ones(len(down), bool)  # Setting Pinocchio's gravity costs as much as the torques of a row.
        turned[1:] = (down[1:] != down[:-1]).any(axis=1)
        for row, (configuration, other) in enumerate(zip(placed, turned.tolist(), strict=True)):
            if other:
                self._set_gravity(down[row])
            torque[row] = pin.computeGeneralizedGravity(self._model, self._data, configuration)
        return self._coupling.driven(torque, q)

    @property
    def direct(self) -> bool:
        """Whether every motor turns a joint of its own."""
        return self._coupling.direct

    def inverse_dynamics(self, position: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Vector:
        """The torques with which links move so where nothing weighs: M(q) q̈ + C(q, q̇) q̇, shape (n,), N·m; of the links
        alone, without rotors and friction. Recursive Newton–Euler.

        `position`, rad, `velocity`, rad/s, `acceleration`, rad/s²: (n,) each. Raises ConfigError for a hand that is not
        `direct`.
        """
        if not self.direct:
            raise ConfigError(f"{self.spec.name} has coupled joints, for which inverse dynamics is not known")
        named = {"position": position, "velocity": velocity, "acceleration": acceleration}
        q, v, a = (self._coupling.configuration(finite(name, each, self._n)) for name, each in named.items())
        self._set_gravity(np.zeros(3))
        torque: Vector = pin.rnea(self._model, self._data, q, v, a)
        return self._coupling.driven(torque, q)

    def fingertip_force(self, position: ArrayLike, torque_limit: ArrayLike) -> dict[str, float]:
        """How hard each fingertip can press with its pad at a posture, N.

        Along the tip's x axis n (out of the pad) a force f needs τ = Jᵀ n f, so f = min over joints of limit / |Jᵀ n|;
        infinite where no joint moves the tip along it.
        """
        limit, forces = numbers("torque_limit", torque_limit), {}
        if limit.shape != (self._n,) or not (limit >= 0.0).all():
            raise ConfigError(
                f"torque_limit needs {self._n} numbers ≥ 0, N·m, shape ({self._n},); it is {short_repr(torque_limit)}"
            )
        for name, jacobian in self._jacobians(position, pin.LOCAL).items():
            lever = np.abs(jacobian[0])
            forces[name] = float((limit[lever > 1e-6] / lever[lever > 1e-6]).min(initial=np.inf))
        return forces

    def manipulability(self, position: ArrayLike) -> dict[str, float]:
        """How freely each fingertip's centre can be moved: w = √det(Jᵥ Jᵥᵀ) of the linear rows, m³/rad³.

        Yoshikawa, "Manipulability of robotic mechanisms", IJRR 4(2), 1985. Zero where the tip is stuck in a direction.
        """
        found = self._jacobians(position, pin.LOCAL_WORLD_ALIGNED)
        # The product of the singular values: a determinant of Jᵥ Jᵥᵀ can come out below zero.
        return {name: float(np.linalg.svd(j[:3], compute_uv=False).prod()) for name, j in found.items()}

    def _gravity_torque(self, position: Vector, gravity: Vector) -> Vector:
        self._set_gravity(gravity)
        torque: Vector = pin.computeGeneralizedGravity(self._model, self._data, self._coupling.configuration(position))
        return self._coupling.driven(torque, position)

    def _set_gravity(self, gravity: Vector) -> None:
        if (asked := gravity.tobytes()) != self._gravity:
            self._model.gravity.linear, self._gravity = gravity, asked

    def _posture_and_gravity(self, position: ArrayLike, gravity: ArrayLike) -> tuple[Vector, Vector]:
        """Both as arrays. Raises ConfigError where they do not belong together."""
        n, q, down = self._n, numbers("position", position), numbers("gravity", gravity)
        if q.ndim not in (1, 2) or q.shape[-1] != n or down.shape != (*q.shape[:-1], 3):
            raise ConfigError(
                f"gravity_torque needs positions of shape ({n},) and gravity of shape (3,), or (k, {n}) and (k, 3); "
                f"these have {q.shape} and {down.shape}"
            )
        if np.isinf(down).any():
            raise ConfigError(f"gravity must be finite, m/s²; it is {down.tolist()}")
        return finite("position", q, *q.shape), down

    def _jacobians(self, position: ArrayLike, axes: pin.ReferenceFrame) -> dict[str, Array]:
        q = finite("position", position, self._n)
        pin.computeJointJacobians(self._model, self._data, self._coupling.configuration(q))
        pin.updateFramePlacements(self._model, self._data)
        return {
            name: self._coupling.driven(pin.getFrameJacobian(self._model, self._data, index, axes), q)
            for name, index in self._tips.items()
        }

    def _poses(self, frames: dict[str, int], position: ArrayLike) -> dict[str, Pose]:
        q = finite("position", position, self._n)
        pin.framesForwardKinematics(self._model, self._data, self._coupling.configuration(q))
        placed = {name: self._data.oMf[index] for name, index in frames.items()}
        return {name: Pose(frame.translation.copy(), frame.rotation.copy()) for name, frame in placed.items()}


class _Coupling:
    """Map from the joints that a hand drives to all joints of Pinocchio's model, and back. A joint of the spec that the
    model does not have is a tendon's motor: it shows in the joints that follow it."""

    def __init__(self, spec: HandSpec, model: pin.Model) -> None:
        self._spec = spec
        known = [k for k, name in enumerate(spec.joints) if model.existJointName(name)]
        names = [spec.joints[k] for k in known] + [each.name for each in spec.followers]
        # Pinocchio orders the fingers by name; `_order` says where it has what we have.
        self._order = np.array([model.idx_vs[model.getJointId(name)] for name in names])
        self._place = np.argsort(self._order)
        self._known = known
        self.direct = not spec.followers and len(known) == spec.n_joints
        """Whether the model's joints are the hand's."""

    def configuration(self, position: Vector) -> Vector:
        """The model's configuration at a posture, (n,), rad; where it is direct, at many, (..., n)."""
        if self.direct:
            return position[..., self._place]
        return self._all(position)[self._place]

    def driven(self, columns: Array, position: Vector) -> Array:
        """Derivatives by the model's joints, (..., joints), as derivatives by those that are driven, (..., n): by the
        chain rule, Σ ∂q/∂qₖ over all that move with joint k."""
        ours: Array = columns[..., self._order]
        return ours if self.direct else ours @ self._slope(position)

    def _all(self, position: Vector) -> Vector:
        return np.concatenate([position[self._known], self._spec.coupled_positions(position)])

    def _slope(self, position: Vector) -> Array:
        lower, upper = self._spec.lower, self._spec.upper
        columns = []
        for k, wide in enumerate(_STEP * (upper - lower)):
            below, above = np.array(position), np.array(position)
            below[k], above[k] = max(position[k] - wide, lower[k]), min(position[k] + wide, upper[k])
            columns.append((self._all(above) - self._all(below)) / (above[k] - below[k]))
        return np.stack(columns, axis=-1)


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
