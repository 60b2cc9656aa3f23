"""The self filter: points of a cloud that are on the arm or the hand are cut out."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.arm.arm_with_hand import ArmWithHand
from allegro_twin.cell.camera.camera import DepthCamera
from allegro_twin.cell.camera.intrinsics import Cloud, Intrinsics
from allegro_twin.cell.camera.settings import DepthCameraSettings
from allegro_twin.sim.model.arm_with_hand import MountedHand
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.types import Array, Vector

AROUND = 4
"""Pixels: by so many it is taken larger on every side, for a camera's edges are not exact."""


class RobotMask:
    """A model without surroundings. For one thread; `close` it. Raises ConfigError where nothing can be rendered."""

    def __init__(self, model: mujoco.MjModel, settings: DepthCameraSettings, lens: Intrinsics | None = None) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._camera = DepthCamera(model, settings, lens=lens)

    def mask(self, pose: Callable[[Array], None]) -> NDArray[np.bool_]:
        """Which pixels show it, (rows, columns), once `pose` has written its joints into `qpos`."""
        pose(self._data.qpos)
        mujoco.mj_kinematics(self._model, self._data)
        settings = self._camera.settings
        shown = self._camera.exact(self._data, settings.mount.pose(self._model, self._data)) < settings.furthest
        for axis in (0, 1):
            wide = shown.copy()
            for step in range(1, AROUND + 1):
                ahead, behind = [slice(None)] * 2, [slice(None)] * 2
                ahead[axis], behind[axis] = slice(step, None), slice(None, -step)
                wide[tuple(ahead)] |= shown[tuple(behind)]
                wide[tuple(behind)] |= shown[tuple(ahead)]
            shown = wide
        return np.asarray(shown)

    def close(self) -> None:
        """Idempotent."""
        self._camera.close()


class SelfFilter:
    """The arm and the hand of a cell, without things and table. For one thread; `close` it."""

    def __init__(self, robot: ArmWithHand, camera: DepthCameraSettings, lens: Intrinsics | None = None) -> None:
        """`lens`: of the camera, where it is another than the settings' own."""
        stage = Stage(robot.base.position, np.array([1.0, 0.0, 0.0, 0.0]))
        model = compile_scene(robot.spec, stage, MountedHand(robot.hand.spec, robot.mount))
        self._arm, self._hand = PostureMap(robot.spec, model), PostureMap(robot.hand.spec, model)
        self._robot_mask = RobotMask(model, camera, lens)

    def mask(self, arm: Vector, hand: Vector) -> NDArray[np.bool_]:
        """Which pixels show it, (rows, columns), at joint positions of both, (n,), rad."""

        def pose(qpos: Array) -> None:
            self._arm(arm, qpos)
            self._hand(hand, qpos)

        return self._robot_mask.mask(pose)

    def remove_robot(self, cloud: Cloud, arm: Vector, hand: Vector) -> Cloud:
        """A cloud in which what shows it is unknown."""
        return np.where(self.mask(arm, hand)[..., None], np.nan, cloud).astype(cloud.dtype)

    def close(self) -> None:
        """Idempotent."""
        self._robot_mask.close()
