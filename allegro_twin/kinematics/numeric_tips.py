"""All fingertips of a hand at once whose fingers are any chains of hinges and slides, from its tree of links."""

from __future__ import annotations

import numpy as np

from allegro_twin.kinematics.tree import Hinge, Placed, Tree
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


class ChainTips:
    """As `tips.Fingertips`, and likewise a row comes out the same whatever the size of its batch. Joints that follow
    are where they are when nothing is in their way, so where a motor moves several joints a tip is an estimate."""

    def __init__(self, spec: HandSpec, tree: Tree) -> None:
        self._spec = spec
        columns = {name: column for column, name in enumerate(spec.moving)}
        self._chains = [_chain(tree, finger.tip, columns) for finger in spec.fingers]

    def __call__(self, position: Array) -> Array:
        """Motors (..., n), rad → fingertips in the palm frame, in the spec's order, (..., fingers, 3), m."""
        moved = self._spec.moved(position)
        return np.stack([_tip(chain, moved) for chain in self._chains], axis=-2)


_Step = tuple[Hinge, int] | Placed
"""A joint with its column, or a placement in the frame before."""


def _chain(tree: Tree, tip: str, columns: dict[str, int]) -> list[_Step]:
    """From a tip to the palm. A joint that the spec does not know is not in the tree."""
    link, placed = tree.tips[tip]
    steps: list[_Step] = [placed]
    while link:
        steps += [(hinge, columns[hinge.name]) for hinge in reversed(tree.links[link].hinges)]
        steps.append(tree.links[link].placed)
        link = tree.links[link].parent
    return steps


def _tip(chain: list[_Step], moved: Array) -> Array:
    """Of all that moves (..., k) → (..., 3), m."""
    point = np.zeros((*moved.shape[:-1], 3))
    for step in chain:
        if isinstance(step, Placed):
            x, y, z = step.rotation.T
            point = point[..., :1] * x + point[..., 1:2] * y + point[..., 2:] * z + step.position
        else:
            hinge, column = step
            point = _moved(hinge, point, moved[..., column, None] - hinge.zero)
    return point


def _moved(hinge: Hinge, point: Array, by: Array) -> Array:
    """A point of the link's frame, moved with its joint; a turn by Rodrigues' formula."""
    axis: Array = hinge.axis / np.sqrt((hinge.axis * hinge.axis).sum())
    if hinge.slides:
        slid: Array = point + by * axis
        return slid
    arm = point - hinge.anchor
    along = (arm * axis).sum(axis=-1, keepdims=True) * axis
    turned: Array = hinge.anchor + along + np.cos(by) * (arm - along) + np.sin(by) * np.cross(axis, arm)
    return turned
