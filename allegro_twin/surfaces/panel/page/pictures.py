"""Small drawings of postures, from the links of whichever hand it is: SVG, for no picture is stored in the library."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel.page.bars import hexed
from allegro_twin.types import Array, Vector
from allegro_twin.viewing.scenery import Scenery
from allegro_twin.viewing.skeleton import Skeleton
from allegro_twin.viewing.surfaces import joined, surface

_SIZE = 76.0  # Pixels, each way.
_SIDE, _UP = (0.55, 0.2), 0.25
"""How far one looks from aside and from above, as parts of looking straight at the palm."""


def pictures(spec: HandSpec, scenery: Scenery, postures: Mapping[str, Vector]) -> dict[str, str]:
    """A drawing for each posture, (n,), rad, by name."""
    if not postures:
        return {}
    skeleton = Skeleton(scenery.bodies, spec)
    places = skeleton.places(np.array(list(postures.values())))
    ends = [_end(skeleton, body) for body in range(len(skeleton.bodies))]
    look = _view(spec, skeleton)
    chains = []
    for bodies in _ways(spec, skeleton):
        points = [places[k][0] for k in bodies]
        last, turn = places[bodies[-1]]
        chains.append(np.stack([*points, last + turn @ ends[bodies[-1]]], axis=1))  # (k, joints + 1, 3)
    return {name: _drawn([chain[row] for chain in chains], look) for row, name in enumerate(postures)}


def _ways(spec: HandSpec, skeleton: Skeleton) -> list[list[int]]:
    """For every link that carries nothing further, the links that fingers' motors move from the palm to it; a link that
    several share is in each."""
    bodies, motors = skeleton.bodies, [*range(spec.n_joints), *(each.driven for each in spec.followers)]
    fingers = {joint for finger in spec.fingers for joint in finger.joints}
    carrying = {body.parent for body in bodies if body.joint >= 0}
    ways = []
    for last in (k for k, body in enumerate(bodies) if body.joint >= 0 and k not in carrying):
        way, at = [], last
        while at >= 0:
            if bodies[at].joint >= 0 and motors[bodies[at].joint] in fingers:
                way.append(at)
            at = bodies[at].parent
        ways.append(way[::-1])
    return [way for way in ways if way]


def _view(spec: HandSpec, skeleton: Skeleton) -> Array:
    """Right, up and towards who looks, (3, 3), in the palm's frame: stretched fingers point up."""
    straight, bent = skeleton.tips()
    up = straight.mean(axis=0)
    up /= np.linalg.norm(up)
    out = (bent - straight).mean(axis=0)
    out -= up * (out @ up)
    out /= np.linalg.norm(out)
    right = np.cross(up, out)
    sign = 1.0 if spec.side == "right" else -1.0
    towards = out + sign * _SIDE[0] * right + _UP * up
    towards /= np.linalg.norm(towards)
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def _end(skeleton: Skeleton, body: int) -> Vector:
    """The furthest place of a link from its joint, (3,), m, in its own frame."""
    shapes = skeleton.bodies[body].shapes
    if not shapes:
        return np.zeros(3)
    corners = joined([surface(shape) for shape in shapes]).vertices
    furthest: Vector = corners[int(np.argmax(np.linalg.norm(corners, axis=1)))]
    return furthest


def _drawn(chains: list[Array], look: Array) -> str:
    """Fingers as thick lines, the furthest first, over a palm that spans their roots."""
    flat = [chain @ look.T for chain in chains]
    root = np.array([chain[0] for chain in flat])
    wrist = np.array([0.0, 0.0, 0.0])
    scale, middle = _SIZE / 0.29, np.array([0.0, 0.045])

    def spot(point: Vector) -> str:
        x, y = (point[:2] - middle) * scale
        return f"{_SIZE / 2 + x:.1f},{_SIZE / 2 - y:.1f}"

    palm = " ".join(spot(point) for point in (*root, wrist - np.array([0.0, 0.06, 0.0])))
    lines = [
        (float(chain[:, 2].mean()),
         f'<polyline points="{" ".join(spot(p) for p in chain)}" fill="none" stroke="{hexed(number)}" '
         'stroke-width="6" stroke-linecap="round" stroke-linejoin="round"/>')
        for number, chain in enumerate(flat)
    ]  # fmt: skip
    fingers = "".join(line for _, line in sorted(lines))
    box = f'width="{_SIZE:.0f}" height="{_SIZE:.0f}" viewBox="0 0 {_SIZE:.0f} {_SIZE:.0f}"'
    return (
        f'<svg {box} xmlns="http://www.w3.org/2000/svg"><polygon points="{palm}" fill="#cfd6de" stroke="#cfd6de" '
        f'stroke-width="12" stroke-linejoin="round"/>{fingers}</svg>'
    )
