"""States in which episodes begin that take time to come about: played once when a task is made, then only copied."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.control import laws
from allegro_twin.control.controllers import Gains
from allegro_twin.learning.environments.settings import EnvSettings
from allegro_twin.learning.policy.script import Script
from allegro_twin.sim.batch.cpu import SimBatch
from allegro_twin.sim.engine.backend import substeps
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

if TYPE_CHECKING:
    import mujoco


def played(
    spec: HandSpec,
    model: mujoco.MjModel,
    gains: Gains,
    script: Script,
    settings: EnvSettings,
    around: Callable[[SimBatch, int], None],
) -> Array:
    """The state after the hand has followed a script; `around` acts on the one simulation before every period."""
    worlds = SimBatch(spec, model, 1, 1)
    worlds.choose(np.zeros(1, np.int64), np.zeros(1, np.int64))
    worlds.place(np.zeros(1, np.int64), script.position[:1])
    for k, (position, velocity) in enumerate(zip(script.position, script.velocity, strict=True)):
        around(worlds, k)
        error, rate = position - worlds.position[0], velocity - worlds.velocity[0]
        worlds.command(position[None] if worlds.closes_loop else laws.pd(error, rate, gains.kp, gains.kd)[None])
        worlds.step(None, substeps(settings.period, settings.timestep))
    return worlds.state(0)
