"""Contact sensors: the force of every link of a hand on an object, which a simulation reports at every step."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco

PREFIX = "contact/"
"""Sensors are named by this and the link."""


def add_contact_sensors(scene: mujoco.MjSpec, root: mujoco.MjsBody, object_name: str) -> None:
    """Measure the net contact force on a free body `object_name` (world axes, 3 numbers, N) of each colliding link
    below and with `root`."""
    force, net = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3
    for link in _links(root):
        scene.add_sensor(
            name=PREFIX + link.name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=link.name,
            reftype=mujoco.mjtObj.mjOBJ_BODY,
            refname=object_name,
            intprm=[force, net, 1],
        )


def _links(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    if any(geom.contype or geom.conaffinity for geom in body.geoms):
        yield body
    for child in body.bodies:
        yield from _links(child)
