"""Self filter: what a camera sees of arm and hand, drawn alone as their encoders say, is cut out of a cloud."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.arm.arm_with_hand import Cell
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.camera.robot_mask import Alone
from allegro_twin.cell.camera.settings import CameraSettings
from allegro_twin.sim.model.arm_with_hand import MountedHand
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.types import Array, Vector


class Itself:
    """The arm and the hand of a cell, without things and table. For one thread; `close` it."""

    def __init__(self, cell: Cell, camera: CameraSettings) -> None:
        stage = Stage(cell.base.position, np.array([1.0, 0.0, 0.0, 0.0]))
        model = compile_scene(cell.spec, stage, MountedHand(cell.hand.spec, cell.mount))
        self._arm, self._hand = PostureMap(cell.spec, model), PostureMap(cell.hand.spec, model)
        self._alone = Alone(model, camera)

    def seen(self, arm: Vector, hand: Vector) -> NDArray[np.bool_]:
        """Which pixels show it, (rows, columns), at joint positions of both, (n,), rad."""

        def pose(qpos: Array) -> None:
            self._arm(arm, qpos)
            self._hand(hand, qpos)

        return self._alone.seen(pose)

    def cut_out(self, cloud: Cloud, arm: Vector, hand: Vector) -> Cloud:
        """A cloud in which what shows it is unknown."""
        return np.where(self.seen(arm, hand)[..., None], np.nan, cloud).astype(cloud.dtype)

    def close(self) -> None:
        """Idempotent."""
        self._alone.close()
