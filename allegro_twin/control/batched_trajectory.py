"""Trajectories side by side: arrays where one alone has vectors, and the same numbers to the last bit."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control.trajectory import SetPoint, Trajectory


class Trajectories:
    """Many trajectories of as many joints each, asked together where they are."""

    def __init__(self, paths: Sequence[Trajectory]) -> None:
        self._paths = paths
        legs = max(len(path.postures) for path in paths)
        n = len(paths[0].postures[0])
        # The last leg of each, from its last posture, goes nowhere; so do those that it does not have.
        self._from, self._travel = np.zeros((2, len(paths), legs, n))
        for row, path in enumerate(paths):
            self._from[row, : len(path.postures)] = path.postures
            self._travel[row, : len(path.postures) - 1] = np.diff(path.postures, axis=0)
        self._moves = np.any(self._travel, axis=2)

    def __call__(self, rows: NDArray[np.int64], t: float) -> SetPoint:
        """Those of some rows at a time, s: (rows, n) each, rad and rad/s."""
        legs = np.empty(len(rows), dtype=np.int64)
        part, rate = np.zeros((2, len(rows), 1))
        for place, row in enumerate(rows.tolist()):
            path = self._paths[row]
            legs[place] = leg = max(bisect_right(path.times, t) - 1, 0)
            if self._moves[row, leg]:
                start, seconds = path.times[leg], path.times[leg + 1] - path.times[leg]
                done, speed = path.shapes[leg]((t - start) / seconds)
                part[place], rate[place] = done, speed / seconds
        travel = self._travel[rows, legs]
        return SetPoint(self._from[rows, legs] + part * travel, rate * travel)
