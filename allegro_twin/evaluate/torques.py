"""What many controllers ask of their hands in one period."""

from __future__ import annotations

from typing import Any

import numpy as np

from allegro_twin.control import laws
from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Path
from allegro_twin.loop import Controller
from allegro_twin.sim.many import Rows, Simulations
from allegro_twin.types import Array, HandState, Vector


class Torques:
    """Controllers side by side: PD as arrays, any other one by one."""

    def __init__(self, controllers: list[Controller[Any]], states: list[HandState]) -> None:
        self._controllers = controllers
        self._memory = [each.start(state) for each, state in zip(controllers, states, strict=True)]
        self._plain = np.array([isinstance(each, PD) for each in controllers])
        self._paths: list[Path | None] = [getattr(memory, "path", None) for memory in self._memory]
        self._kp = np.array([_gain(each, "kp", len(states[0].position)) for each in controllers])
        self._kd = np.array([_gain(each, "kd", len(states[0].position)) for each in controllers])

    def __call__(self, rows: Rows, t: float, sims: Simulations, state_of: Any) -> Array:
        target, rate = np.zeros((2, len(rows), sims.spec.n_joints))
        feed, own = np.zeros_like(target), {}
        gravity = sims.gravity
        for place, row in enumerate(rows.tolist()):
            if not self._plain[row]:
                command, self._memory[row] = self._controllers[row](state_of(row), self._memory[row])
                own[place] = command.torque
                continue
            point = self._memory[row].path(t)
            target[place], rate[place] = point.position, point.velocity
            compensation = self._controllers[row].gravity
            if compensation is not None:
                down = gravity[row] if compensation.vector is None else compensation.vector
                feed[place] = compensation.torque_of(sims.position[row], down)
        torque = laws.pd(
            target - sims.position[rows], rate - sims.velocity[rows], self._kp[rows], self._kd[rows], feed
        )  # fmt: skip
        for place, wanted in own.items():
            torque[place] = wanted
        return torque


def _gain(controller: Controller[Any], name: str, n: int) -> Vector:
    return np.asarray(getattr(controller.gains, name)) if isinstance(controller, PD) else np.zeros(n)
