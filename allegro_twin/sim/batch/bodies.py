"""Free bodies in many simulations side by side."""

from __future__ import annotations

import mujoco

from allegro_twin.types import Array


class Body:
    """A free body in every simulation: its pose, its motion, and what pushes it. Live views, one row each."""

    def __init__(self, model: mujoco.MjModel, name: str, qpos: Array, qvel: Array, push: Array) -> None:
        body, joint = model.body(name), model.joint(name)
        self.id, self.geoms = int(body.id), slice(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0]))
        first = int(model.body_bvhadr[self.id])
        self.boxes = slice(first, first + int(model.body_bvhnum[self.id]))
        """Its rows of `bvh_aabb`."""
        place, motion = int(joint.qposadr[0]), int(joint.dofadr[0])
        self.pose: Array = qpos[:, place : place + 7]
        """Position and quaternion in the world, (n, 7), m."""
        self.velocity: Array = qvel[:, motion : motion + 3]
        """World, (n, 3), m/s."""
        self.spin: Array = qvel[:, motion + 3 : motion + 6]
        """In the body's own axes, (n, 3), rad/s."""
        self.force: Array = push[:, self.id, :3]
        """On its centre of mass, world, (n, 3), N."""
        self.moment: Array = push[:, self.id, 3:]
        """World, (n, 3), N·m."""
