"""A grasp on its way from a guess to a proof."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.types import Array, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Where the palm is in the world, beside an object that stands at its place, and what the fingers do."""

    position: Array
    """Of the palm's origin, (3,), m."""
    rotation: Array
    """Of the palm, (3, 3); its x looks out of the palm, its z to the fingertips."""
    retreat: Array
    """From there to where the approach begins, (3,), m."""
    preshape: Vector
    """(n,), rad."""
    closing: Vector
    """Which way each joint closes: 1, -1, or 0 for one that does not, (n,)."""
    close: Vector
    """Where the fingers meet the object, (n,), rad."""
    squeeze: Vector
    """What they are told to do there, (n,), rad."""
    rest: Vector
    """Where they come to then, (n,), rad."""
    template: str
    """The library's grasp that it began as."""
    score: float = 0.0
    """Larger is better; of the last step that judged it."""

    @property
    def direction(self) -> str:
        """From where the hand comes: `above`, `side` or between."""
        down = -float(self.rotation[2, 0])
        return "above" if down > np.cos(np.radians(30.0)) else "side" if abs(down) < 0.5 else "oblique"


def apart(first: Candidate, second: Candidate, symmetry: Array | None = None) -> tuple[float, float]:
    """How far two palms are from each other, m and rad. `symmetry`: rotations (k, 3, 3) about the world's origin that
    leave the object as it is; the nearest image counts."""
    turns = np.eye(3)[None] if symmetry is None else symmetry
    positions = np.linalg.norm(turns @ second.position - first.position, axis=1)
    cosines = (np.einsum("kij,ij->k", turns @ second.rotation, first.rotation) - 1.0) / 2.0
    angles = np.arccos(np.clip(cosines, -1.0, 1.0))
    best = int(np.argmin(positions / 0.02 + angles / np.radians(20.0)))
    return float(positions[best]), float(angles[best])


def different(
    candidate: Candidate, others: list[Candidate], symmetry: Array | None = None,
    metres: float = 0.02, degrees: float = 20.0,
) -> bool:  # fmt: skip
    """Whether a candidate is 2 cm or 20° from every other one."""
    for other in others:
        far, turned = apart(candidate, other, symmetry)
        if far < metres and turned < np.radians(degrees):
            return False
    return True
