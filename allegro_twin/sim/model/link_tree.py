"""The links and joints of a hand's MJCF as plain data, for kinematics without MuJoCo."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.tree import LinkPlacement, Tree, TreeJoint, TreeLink
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

if TYPE_CHECKING:
    import mujoco


def read_link_tree(spec: HandSpec) -> Tree:
    """The links of a hand's MJCF as plain data, under our names; a joint that the spec does not know stays where the
    MJCF has it. Raises ConfigError for a joint that is neither a hinge nor a slide."""
    from allegro_twin.sim.hand_import.adapt import compile_model
    from allegro_twin.sim.model.scene import hand_spec

    model = compile_model(hand_spec(spec))
    palm = model.body("palm_link").id
    bodies = [b for b in range(palm, model.nbody) if palm in _ancestors(model, b)]
    links = tuple(_link(model, body, bodies, spec) for body in bodies)
    tips = {}
    for finger in spec.fingers:
        site = model.site(finger.tip)
        tips[finger.tip] = (bodies.index(int(site.bodyid[0])), LinkPlacement(site.pos.copy(), _matrix(site.quat)))
    return Tree(links, tips)


def _ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    found = {body}
    while body:
        body = int(model.body_parentid[body])
        found.add(body)
    return found


def _link(model: mujoco.MjModel, body: int, bodies: list[int], spec: HandSpec) -> TreeLink:
    first = body == bodies[0]
    placement = LinkPlacement(np.zeros(3), np.eye(3))
    if not first:
        placement = LinkPlacement(model.body_pos[body].copy(), _matrix(model.body_quat[body]))
    turned = _matrix(model.body_iquat[body])
    return TreeLink(
        model.body(body).name,
        0 if first else bodies.index(int(model.body_parentid[body])),
        placement,
        () if first else _hinges(model, body, spec),
        float(model.body_mass[body]),
        model.body_ipos[body].copy(),
        turned @ np.diag(model.body_inertia[body]) @ turned.T,
    )


def _hinges(model: mujoco.MjModel, body: int, spec: HandSpec) -> tuple[TreeJoint, ...]:
    import mujoco

    found, known = [], {*spec.joints, *(each.name for each in spec.followers)}
    for number in range(int(model.body_jntadr[body]), int(model.body_jntadr[body] + model.body_jntnum[body])):
        joint = model.joint(number)
        if joint.name not in known:
            continue
        kind = int(joint.type[0])
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            raise ConfigError(f"hand {spec.serial or spec.model}: joint {joint.name} is neither a hinge nor a slide")
        slides = kind == mujoco.mjtJoint.mjJNT_SLIDE
        found.append(TreeJoint(joint.name, joint.axis.copy(), joint.pos.copy(), float(joint.qpos0[0]), slides))
    return tuple(found)


def _matrix(quaternion: Array) -> Array:
    import mujoco

    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, dtype=np.float64))
    return matrix.reshape(3, 3)
