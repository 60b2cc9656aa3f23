"""One finger in closed form: formulas, limits, mirror image and palm frame together."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arguments import check_margin, finite, rows
from allegro_twin.kinematics.closed_form import many_poses, one_pose
from allegro_twin.kinematics.closed_form.forms.finger import FingerForms
from allegro_twin.kinematics.closed_form.forms.thumb import ThumbForms
from allegro_twin.kinematics.closed_form.geometry import BaseFrame, load_geometry
from allegro_twin.kinematics.closed_form.one_pose import Chain
from allegro_twin.kinematics.closed_form.scalar import ScalarKinematics
from allegro_twin.kinematics.closed_form.targets import read_target
from allegro_twin.kinematics.pose import Pose
from allegro_twin.kinematics.solutions import Solutions
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

_MARGINS = 64  # Chains that are kept, each with its searches.


class ClosedFormFinger:
    """Forward and inverse kinematics of one Allegro finger or thumb in closed form, in the palm frame.

    Joint vectors are the finger's own, shape (..., 4), rad, from the palm outward. The tip is the centre of the
    fingertip sphere. A left finger is solved as the mirrored right one (docs/explanation/kinematics.md#mirror).
    """

    def __init__(self, spec: HandSpec, finger: str) -> None:
        joints = spec.finger(finger).joints
        self.shared: tuple[str, ...] = ()
        """Other fingers that its motors move as well: none."""
        geometry, left = load_geometry(spec.model, finger), spec.side == "left"
        self.name, self.lower, self.upper = finger, spec.lower[list(joints)], spec.upper[list(joints)]
        self._signs = np.array([-1.0 if left and j in spec.mirror_flips else 1.0 for j in joints])
        ends = np.sort([self.lower * self._signs, self.upper * self._signs], axis=0)
        self.base: Vector = geometry.origin * [1.0, -1.0 if left else 1.0, 1.0]
        """Where joint 0 is in the palm frame, shape (3,), m."""
        self._forms = (ThumbForms if geometry.is_thumb else FingerForms)(geometry, *ends)
        self._frame = BaseFrame(geometry, self._forms.shift, left=left)
        self.scalar = ScalarKinematics(geometry, self.lower, self.upper, self._signs, left=left)
        """Inverse kinematics of one target at a time on plain numbers, as little as a control loop needs."""
        self._chains: dict[float, Chain] = {}  # By margin.

    def fk(self, position: ArrayLike) -> Pose:
        """The fingertip in the palm frame, joints (..., 4), rad → position (..., 3), m, and rotation (..., 3, 3).

        NaN of a posture with a NaN, as of a branch that does not exist. Raises ConfigError for another shape.
        """
        q = self._joints(position)
        return Pose(self._frame.to_palm(self._forms.tip(q)), self._frame.rotation_to_palm(self._forms.rotation(q)))

    def tip(self, position: ArrayLike) -> Array:
        """The fingertip's position alone, joints (..., 4), rad → (..., 3), m: a third of the cost of `fk`.

        The matrix product runs over one row at a time where an axis of length one precedes the joints, and then the
        result of a row does not depend on how many there are.
        """
        return self._frame.to_palm(self._forms.tip(self._joints(position)))

    def _joints(self, position: ArrayLike) -> Array:
        """Joints of the right hand, (4, ...), rad."""
        joints = rows(f"{self.name}: position of its 4 joints", position, 4)
        if np.isinf(joints).any():
            raise ConfigError(f"{self.name}: positions must be finite; {int(np.isinf(joints).sum())} of them are not")
        return np.moveaxis(joints * self._signs, -1, 0)

    def ik(
        self,
        position: ArrayLike,
        *,
        rotation: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        euler: ArrayLike | None = None,
        near: ArrayLike | None = None,
        margin: float = 0.0,
        **held: ArrayLike | None,
    ) -> Solutions:
        """All postures that bring the fingertip to a position in the palm frame, shape (..., 3), m.

        A finger holds with it `pitch` φ = q₁ + q₂ + q₃; the thumb `q0`, `q1` or `psi` = q₂ + q₃; each (...), rad. Or an
        orientation of the tip in the palm, as `rotation` (..., 3, 3), `quaternion` (..., 4) or `euler` (..., 3): the
        position is then exact and the rotation the nearest that a finger can have there, or the one of the thumb that
        has the q₀ of the rotation; where none of these branches is the nearest that there is inside the limits, that
        stands in the first. With none of these, one posture: nearest to `near` (..., 4), rad, or else the one furthest
        from its nearest limit.

        `margin` is taken off both ends of every joint's range, rad. Raises ConfigError for arguments that do not fit.
        """
        given = {**held, "rotation": rotation, "quaternion": quaternion, "euler": euler, "near": near}
        target = read_target(self.name, isinstance(self._forms, ThumbForms), position, given)
        if not isinstance(margin, float):
            margin = float(finite(f"{self.name}: margin", margin))
        chain = self._chains.get(margin) or self._chain_inside(margin)
        if isinstance(target.angle, float):
            return one_pose.solve(chain, target)
        return many_poses.solve(chain, target)

    def _chain_inside(self, margin: float) -> Chain:
        check_margin(self.name, margin, self.lower, self.upper)
        if len(self._chains) >= _MARGINS:
            self._chains.clear()
        limits = self.lower + margin, self.upper - margin
        chain = self._chains[margin] = Chain(self._forms, self._frame, self.scalar.fk, limits, self._signs)
        return chain
