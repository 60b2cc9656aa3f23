"""Samples of the force on the flange: while the hand is empty, before the approach, and after the lift."""

from __future__ import annotations

from collections import deque

import numpy as np

from allegro_twin.cell.actions.cell_motion import STILL, CellMotion
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.checks.grasp_check import tare_samples
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.states import MachineState
from allegro_twin.types import HandState, Vector

_REST = 0.2  # s after a motion, until what hangs on the flange has come to rest.


class ForceSamples:
    """Collects wrenches on the flange, compensated for the hand's weight, (6,), N and N·m."""

    def __init__(self, cell: Cell) -> None:
        self._cell, settings = cell, cell.settings.validation
        self.idle: deque[Vector] = deque(maxlen=settings.samples)
        """While the camera looks and the arm rests."""
        self.before: deque[Vector] = deque()
        """Before the approach."""
        self.after: deque[Vector] = deque(maxlen=settings.long)
        """After the lift."""
        self._tare = self._enough = settings.samples

    def begin_tare(self, solid: Solid | None) -> None:
        """Sample anew before the approach, as long as this object asks for."""
        self.before.clear()
        if solid is not None:
            self._tare = tare_samples(np.asarray(solid.size), self._cell.settings.validation)

    def begin_weighing(self) -> None:
        """Sample anew after the lift."""
        self.after.clear()
        self._enough = self._cell.settings.validation.samples

    @property
    def is_tared(self) -> bool:
        """Whether there are enough samples before the approach."""
        return len(self.before) >= self._tare

    @property
    def is_weighed(self) -> bool:
        """Whether there are enough samples after the lift."""
        return len(self.after) >= self._enough

    def weigh_longer(self) -> bool:
        """Ask for the long series after the lift; False where there is one."""
        if len(self.after) >= self._cell.settings.validation.long:
            return False
        self._enough = self._cell.settings.validation.long
        return True

    def add(self, now: MachineState, state: HandState, motion: CellMotion) -> None:
        """A state of the arm: its wrench is kept where one is needed and the arm rests."""
        kept = None
        if now.state == "Look" and float(np.abs(state.velocity).max()) < STILL:
            kept = self.idle
        elif now.state == "ToTargetPose" and not motion.ahead and motion.is_over(state.t, _REST):
            kept = self.before
        elif now.state == "Done" or (now.state == "Validate" and state.t >= now.since + _REST):
            kept = self.after
        if kept is not None:
            flange = self._cell.robot.model.pose(state.position).rotation
            kept.append(self._cell.robot.compensation.flange_wrench(state.wrench, flange, state.gravity))
