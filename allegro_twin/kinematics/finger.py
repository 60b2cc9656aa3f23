"""The interface of one finger's forward and inverse kinematics, whatever the hand."""

from __future__ import annotations

from typing import Protocol

from numpy.typing import ArrayLike

from allegro_twin.kinematics.pose import Pose
from allegro_twin.kinematics.solutions import Solutions
from allegro_twin.types import Vector


class FingerKinematics(Protocol):
    """Forward and inverse kinematics of one finger in the palm frame; `HandKinematics.finger` gives one.

    A posture of the finger is what its own k joints, or motors, are at, from the palm outward: shape (k,), rad.
    """

    name: str
    lower: Vector
    """Lowest joint positions, shape (k,), rad."""
    upper: Vector
    shared: tuple[str, ...]
    """Other fingers that its motors move as well."""

    def fk(self, position: ArrayLike) -> Pose:
        """The fingertip, joints (..., k), rad → position (..., 3), m, and rotation (..., 3, 3). Raises ConfigError for
        another shape."""
        ...

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
        """The postures that bring the fingertip to a position, shape (..., 3), m, within the joint limits.

        With it one of: an orientation of the tip, as `rotation` (..., 3, 3), `quaternion` (..., 4) or `euler` (..., 3),
        rad, met as nearly as the position allows; `near`, a posture (..., k), rad, to be as near to as possible; or,
        by its name, an angle that this kind of finger can hold (`held`, (...), rad). `margin` is taken off both ends
        of every joint's range, rad. Raises ConfigError for what does not fit, and for what this finger does not solve.
        """
        ...
