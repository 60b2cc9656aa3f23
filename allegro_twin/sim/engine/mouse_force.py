"""Force of a person who drags a body with the mouse: a damped spring of bounded strength, as in MuJoCo's viewer."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from allegro_twin.types import Array, Vector

STIFFNESS = 100.0
"""N/m. OWN: an object of 100 g follows within 10 mm of its weight."""
LARGEST = 5.0
"""N: the force is never larger."""
SECONDS = 5.0
"""s of simulated time after which a force ends that nobody renews: a lost network, a page that hangs."""


@dataclass(frozen=True, slots=True, eq=False)
class MouseDrag:
    """One position of the mouse while it drags a body."""

    body: int
    """Its number in the model."""
    point: Vector
    """Where it was picked, in its own frame, (3,), m."""
    target: Vector
    """Where the mouse is, in the world, (3,), m."""
    end: int = 0
    """Physics step after which the force is zero."""


class MouseForce:
    """Applies the force of the newest drag before each physics step. `drag` may be set by any thread."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self.drag: MouseDrag | None = None
        self._applied = np.zeros(model.nv)
        self.reset()

    @property
    def active(self) -> bool:
        """Whether there is something to apply or to take back."""
        return self.drag is not None or self.now is not None

    def reset(self) -> None:
        """Forget the drag, and the forces so far: the simulation begins anew."""
        self.drag = None
        self._applied[:] = 0.0
        self.now: tuple[MouseDrag, Vector, Vector] | None = None
        """The drag that acts, the picked point (m) and the force (N) in the world, (3,) each."""
        self.largest = 0.0
        """N, since the reset."""

    def step(self, step: int) -> None:
        """Apply the force for a physics step, so many after the reset."""
        model, data, drag = self._model, self._data, self.drag
        data.qfrc_applied -= self._applied
        self._applied[:] = 0.0
        if drag is None or step >= drag.end:
            if drag is self.drag:
                self.drag = None
            self.now = None
            return
        point, force = drag_force(model, data, drag)
        mujoco.mj_applyFT(model, data, force, np.zeros(3), point, drag.body, self._applied)
        data.qfrc_applied += self._applied
        self.now, self.largest = (drag, point, force), max(self.largest, float(np.linalg.norm(force)))


def drag_force(model: mujoco.MjModel, data: mujoco.MjData, drag: MouseDrag) -> tuple[Vector, Vector]:
    """The picked point, m, and the force on it, N, in the world, (3,) each: F = k (target - point) - 2 √(k m) v, of at
    most `LARGEST`."""
    origin, twist = data.xpos[drag.body], np.empty(6)
    arm: Array = data.xmat[drag.body].reshape(3, 3) @ drag.point
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY.value, drag.body, twist, 0)
    velocity = twist[3:] + np.cross(twist[:3], arm)
    damping = 2.0 * np.sqrt(STIFFNESS * model.body_subtreemass[drag.body])
    force = STIFFNESS * (drag.target - origin - arm) - damping * velocity
    size = float(np.linalg.norm(force))
    return origin + arm, force * min(1.0, LARGEST / size) if size > 0.0 else force
