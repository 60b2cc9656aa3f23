"""All fingertips of many postures at once, by one table of angles where there is a closed form, else chain by chain.

A row of a result is the same to the bit whatever the size of its batch.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from allegro_twin.array_api import take
from allegro_twin.kinematics.closed_form.geometry import load_geometry
from allegro_twin.kinematics.tree import LinkPlacement, Tree, TreeJoint
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class ClosedFormFingertips:
    """Fingertips of a hand whose fingers all have a closed form: one third of the operations of finger by finger.

    Every finger turns about one axis and bends in the plane that it turns; the thumb's whole chain turns once more
    (docs/explanation/kinematics.md#finger, #thumb). So one table of angles serves them all:
    (x, y, z) = offset + (r cos q_t, r sin q_t, h), r = Σ lₖ sin αₖ, h = Σ lₖ cos αₖ.
    Sums are written out or run over a row, so that they do not depend on the size of the batch.
    """

    def __init__(self, spec: HandSpec, xp: Any = np) -> None:
        """`xp`: the library of the arrays that it is called with (allegro_twin/array_api.py)."""
        parts = [load_geometry(spec.model, finger.name) for finger in spec.fingers]
        thumbs = np.array([part.is_thumb for part in parts])
        # Rows of the table of angles: the turn, then what bends. The thumb's first joint takes the second row.
        order = np.where(thumbs[:, None], [1, 0, 2, 3], [0, 1, 2, 3])
        joints = np.take_along_axis(np.array([finger.joints for finger in spec.fingers]), order, axis=1).T
        left = spec.side == "left"
        flips = np.isin(np.arange(spec.n_joints), spec.mirror_flips)
        reflect = np.array([1.0, -1.0 if left else 1.0, 1.0])
        self._joints, self._xp = xp.asarray(joints), xp
        self._constants = _Constants(
            signs=np.where(left & flips, -1.0, 1.0)[joints],
            bends=1.0 - thumbs,
            thumbs=thumbs * 1.0,
            links=np.array([[*(0.0,) * (4 - len(part.links)), *part.links] for part in parts]).T,
            offset=np.array([part.offset + np.array([0.0, 0.0, part.rise]) for part in parts]).T,
            axes=np.array([[part.base[:, k] * reflect for part in parts] for k in range(3)]),
            origin=np.array([part.origin * reflect for part in parts]),
        )
        self._lifted: dict[int, _Constants] = {}

    def __call__(self, position: Array) -> Array:
        """Joints (..., n), rad → fingertips in the palm frame, in the spec's order, (..., fingers, 3), m."""
        own = self._own(position.ndim - 1)
        angle = take(position, self._joints, -1) * own.signs
        first, second, third = angle[..., 1, :], angle[..., 2, :], angle[..., 3, :]
        second += first * own.bends
        third += second
        sine, cosine = self._xp.sin(angle), self._xp.cos(angle)
        r, h = ((part * own.links).sum(axis=-2) for part in (sine, cosine))
        x = own.offset[0] + r * cosine[..., 0, :]
        y = own.offset[1] + r * sine[..., 0, :]
        z = own.offset[2] + h
        # Fingers do not turn once more: sine 0, cosine 1.
        s, c = sine[..., 1, :] * own.thumbs, cosine[..., 1, :] * own.thumbs + own.bends
        y, z = c * y + s * z, c * z - s * y
        ahead, aside, up = own.axes
        tips: Array = x[..., None] * ahead + y[..., None] * aside + z[..., None] * up + own.origin
        return tips

    def _own(self, lead: int) -> _Constants:
        """The constants where the arrays lie, with as many leading dimensions as these have: NumPy multiplies arrays of
        the same shape, as those of one hand then are, in a third of the time."""
        if lead not in self._lifted:
            ones, own = (1,) * lead, self._constants
            # In rows, for what stands in columns is slow, too.
            whole = {
                name: np.array(part, order="C").reshape(*ones, *part.shape) for name, part in own._asdict().items()
            }
            for name in ("offset", "axes"):
                whole[name] = np.moveaxis(whole[name], lead, 0)
            self._lifted[lead] = _Constants(**{name: self._xp.asarray(part) for name, part in whole.items()})
        return self._lifted[lead]


class _Constants(NamedTuple):
    signs: Array
    """Signs of the angles, (4, fingers)."""
    bends: Array
    """1 of fingers, 0 of thumbs, (fingers,)."""
    thumbs: Array
    links: Array
    """(4, fingers), m."""
    offset: Array
    """(3, fingers), m."""
    axes: Array
    """Axes of the chains' bases in the palm frame, (3, fingers, 3)."""
    origin: Array
    """(fingers, 3), m."""


class ChainFingertips:
    """Fingertips of a hand whose fingers are any chains of hinges and slides. Joints that follow a motor are where they
    are when nothing is in their way: where a motor moves several joints, a fingertip is an estimate."""

    def __init__(self, spec: HandSpec, tree: Tree) -> None:
        self._spec = spec
        columns = {name: column for column, name in enumerate(spec.all_joints)}
        self._chains = [_chain(tree, finger.tip, columns) for finger in spec.fingers]

    def __call__(self, position: Array) -> Array:
        """Motors (..., n), rad → fingertips in the palm frame, in the spec's order, (..., fingers, 3), m."""
        moved = self._spec.all_positions(position)
        return np.stack([_tip(chain, moved) for chain in self._chains], axis=-2)


_Step = tuple[TreeJoint, int] | LinkPlacement
"""A joint with its column, or a placement in the frame before."""


def _chain(tree: Tree, tip: str, columns: dict[str, int]) -> list[_Step]:
    """The steps from a fingertip to the palm. A joint that the spec does not know is not in the tree."""
    link, placement = tree.tips[tip]
    steps: list[_Step] = [placement]
    while link:
        steps += [(joint, columns[joint.name]) for joint in reversed(tree.links[link].joints)]
        steps.append(tree.links[link].placement)
        link = tree.links[link].parent
    return steps


def _tip(chain: list[_Step], moved: Array) -> Array:
    """Positions of all that moves (..., k), rad → the fingertip (..., 3), m."""
    point = np.zeros((*moved.shape[:-1], 3))
    for step in chain:
        if isinstance(step, LinkPlacement):
            x, y, z = step.rotation.T
            point = point[..., :1] * x + point[..., 1:2] * y + point[..., 2:] * z + step.position
        else:
            joint, column = step
            point = _move(joint, point, moved[..., column, None] - joint.zero)
    return point


def _move(joint: TreeJoint, point: Array, by: Array) -> Array:
    """A point of the link's frame, moved with its joint; a turn by Rodrigues' formula."""
    axis: Array = joint.axis / np.sqrt((joint.axis * joint.axis).sum())
    if joint.slides:
        slid: Array = point + by * axis
        return slid
    arm = point - joint.anchor
    along = (arm * axis).sum(axis=-1, keepdims=True) * axis
    turned: Array = joint.anchor + along + np.cos(by) * (arm - along) + np.sin(by) * np.cross(axis, arm)
    return turned
