"""What a simulated hand loses to its joints, and what its motors give, changed while it runs: for "what if"."""

from __future__ import annotations

from typing import NamedTuple

import mujoco

from allegro_twin.sim.model.postures import Posed
from allegro_twin.spec import HandSpec


class Change(NamedTuple):
    """Of every joint; None: as it was."""

    damping: float | None = None
    """N·m·s/rad."""
    frictionloss: float | None = None
    """Dry friction, N·m."""
    strength: float = 1.0
    """What its motors give of what they gave."""


def lose(spec: HandSpec, model: mujoco.MjModel, change: Change) -> None:
    """Set the damping and dry friction of a compiled hand's joints."""
    dofs = [int(model.jnt_dofadr[joint]) for joint in Posed(spec, model).joints]
    if change.damping is not None:
        model.dof_damping[dofs] = change.damping
    if change.frictionloss is not None:
        model.dof_frictionloss[dofs] = change.frictionloss
