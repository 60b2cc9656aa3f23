"""Models of scenes that are compiled once, however many trials are made of each."""

from __future__ import annotations

from collections.abc import Hashable
from copy import copy
from dataclasses import fields

import mujoco
import numpy as np

from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec


class CompiledScenes:
    """Compiled scenes of one hand. What a scene's files say is read when it is first asked for."""

    def __init__(self, spec: HandSpec) -> None:
        self._spec, self._models = spec, dict[Hashable, mujoco.MjModel]()

    def model(self, stage: Stage) -> mujoco.MjModel:
        """A model of the caller's own. Raises ConfigError when MuJoCo refuses the scene."""
        key = tuple(_hashable(getattr(stage, each.name)) for each in fields(stage))
        if key not in self._models:
            self._models[key] = compile_scene(self._spec, stage)
        return copy(self._models[key])


def _hashable(value: object) -> Hashable:
    if isinstance(value, np.ndarray):
        return value.tobytes()
    return tuple(value) if isinstance(value, list) else value
