"""Skeleton of a hand: poses of its links, from the table of facts for our hands, from the model for others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from allegro_twin.hands.description import facts
from allegro_twin.hands.description.appearance import VisualBody, VisualShape
from allegro_twin.hands.generate import mesh
from allegro_twin.kinematics.orientation import matrix_from_euler, matrix_from_quaternion, quaternion_from_matrix
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

_SEGMENTS = 3  # Of a rounded edge.
_HALF = float(np.sqrt(0.5))


def bodies_of(spec: HandSpec) -> tuple[VisualBody, ...]:
    """The links of a hand: of the foreign file that it names, or of our own description. Raises ConfigError."""
    if spec.foreign is not None:
        from allegro_twin.sim.model.appearance import hand_bodies

        return hand_bodies(spec)
    hand = facts.load_facts(spec.model, spec.side)
    names = [link.name for link in hand.links]
    return tuple(
        VisualBody(
            name=link.name if link.parent else "palm",
            parent=names.index(link.parent) if link.parent else -1,
            position=link.xyz,
            quaternion=tuple(quaternion_from_matrix(matrix_from_euler(np.array(link.rpy)))),
            joint=spec.joints.index(link.joint.name) if link.joint is not None else -1,
            axis=link.joint.axis if link.joint is not None else (0.0, 0.0, 1.0),
            shapes=_shapes(link, hand.colors),
        )
        for link in hand.links
    )


class Skeleton:
    """Forward kinematics of a hand's bodies, for many moments at once; joints that follow are where they would be
    free."""

    def __init__(self, bodies: Sequence[VisualBody], spec: HandSpec) -> None:
        self.bodies, self._spec = tuple(bodies), spec
        self._turns = [matrix_from_quaternion(np.array(body.quaternion)) for body in bodies]

    def places(self, position: Array) -> list[tuple[Array, Array]]:
        """For joint positions (k, n), rad, each body's place (k, 3), m, and rotation (k, 3, 3) in the palm's frame."""
        position, moments = self._spec.all_positions(position), len(position)
        found: list[tuple[Array, Array]] = []
        for body, turn in zip(self.bodies, self._turns, strict=True):
            place = np.tile(np.array(body.position), (moments, 1))
            rotation = np.tile(turn, (moments, 1, 1))
            if body.joint >= 0:
                about = _rotations(np.array(body.axis), position[:, body.joint] - body.zero)
                anchor = np.array(body.anchor)
                place = place + (rotation @ (anchor - about @ anchor)[..., None])[..., 0]
                rotation = rotation @ about
            if body.parent >= 0:
                base, frame = found[body.parent]
                place = base + (frame @ place[..., None])[..., 0]
                rotation = frame @ rotation
            found.append((place, rotation))
        return found

    def tips(self) -> tuple[Array, Array]:
        """Where the last links of the fingers are, straight and half bent, (f, 3), m each: what a view is found by."""
        spec = self._spec
        last = {finger.joints[-1] for finger in spec.fingers}
        if spec.followers:  # A motor is in the palm: the ends are what carries nothing further that moves.
            carrying = {body.parent for body in self.bodies if body.joint >= 0}
            last = {body.joint for k, body in enumerate(self.bodies) if k not in carrying and body.joint >= 0}
        rows = np.stack([np.clip(np.zeros(spec.n_joints), spec.lower, spec.upper), (spec.lower + spec.upper) / 2])
        places = [p for body, (p, _) in zip(self.bodies, self.places(rows), strict=True) if body.joint in last]
        straight, bent = np.stack(places, axis=1)
        return straight, bent


def _rotations(axis: Array, angle: Array) -> Array:
    """Rodrigues: R = I + sin θ K + (1 − cos θ) K², for each angle θ (k,), rad, (k, 3, 3)."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    found: Array = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return found


def _shapes(link: facts.LinkFacts, colors: dict[str, tuple[float, ...]]) -> tuple[VisualShape, ...]:
    found = [_visual(visual, colors[visual.color]) for visual in link.visuals]
    if link.tip is not None:
        tip = link.tip
        size, middle = (tip.radius, (tip.end - tip.start) / 2), (tip.start + tip.end) / 2
        found.append(VisualShape("capsule", size, (0.0, 0.0, middle), color=colors["tip"]))
    return tuple(found)


def _visual(visual: facts.VisualFacts, color: tuple[float, ...]) -> VisualShape:
    if visual.kind == "cylinder":
        return VisualShape("cylinder", visual.size, visual.at, (_HALF, _HALF, 0.0, 0.0), color)
    vertices, triangles = mesh.rounded_box(visual.size, visual.radius, _SEGMENTS)
    return VisualShape("mesh", (), visual.at, color=color, vertices=vertices, triangles=triangles)
