"""What an episode is told of its thing: by the simulator, late and with noise, or by one picture."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from allegro_twin.cell.camera.camera import Camera
from allegro_twin.cell.motion.grasp_selection import Body, about, body_of, standing
from allegro_twin.cell.perception.pipeline import Found, Pipeline
from allegro_twin.cell.pick.scene import Stand
from allegro_twin.kinematics.arm import rotate
from allegro_twin.kinematics.pose import Pose

_ROUND = ("sphere", "cylinder")


def told(stand: Stand, yaw: float) -> Body:
    """The thing as it stands, turned by `yaw`, rad."""
    return _plain(replace(standing(stand.thing, yaw), position=stand.there.position))


def pictured(stand: Stand, camera: Camera, pipeline: Pipeline) -> Body | None:
    """The thing as a picture shows it now; None where perception refuses."""
    frame = camera.capture(stand.cell.world.data)
    seen = pipeline.look(frame.cloud, frame.pose.position, frame.pose.rotation)
    return _plain(body_of(seen.solid)) if isinstance(seen, Found) else None


class Track:
    """The thing's frame over an episode: x along its longer level extent and z up while it stands, carried along."""

    def __init__(self, stand: Stand, body: Body) -> None:
        settings, there = stand.settings, stand.there
        self._stand, self._fixed = stand, settings.perception
        self.pose = Pose(body.position, about(body.yaw))
        self._own = there.rotation.T @ self.pose.rotation
        self._noise = (settings.camera_shift, settings.camera_turn)
        self._past = deque([self.pose], maxlen=settings.camera_delay + 1)

    def look(self, draws: np.random.Generator) -> None:
        """A decision comes: what is known now."""
        if self._fixed:
            return
        there = self._stand.there
        self._past.append(Pose(there.position, there.rotation @ self._own))
        known, (shift, twist) = self._past[0], self._noise
        self.pose = Pose(
            known.position + shift * draws.uniform(-1.0, 1.0, 3) if shift else known.position,
            rotate(known.rotation, twist * draws.uniform(-1.0, 1.0, 3)) if twist else known.rotation,
        )


def _plain(body: Body) -> Body:
    """Of the turns that look the same, one: of what is round none, else within a quarter turn."""
    yaw = 0.0 if body.kind in _ROUND else float((body.yaw + np.pi / 2.0) % np.pi - np.pi / 2.0)
    return replace(body, yaw=yaw)
