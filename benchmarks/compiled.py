"""Damped least squares of one finger, compiled where a C compiler is found (least_squares.c)."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin

from allegro_twin.types import Array

SOURCE = Path(__file__).with_name("least_squares.c")
FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")


class CompiledLeastSquares:
    """The model of one finger in Pinocchio, solved without it: batches of poses in one call."""

    def __init__(self, model: pin.Model, tip: int, tolerance: float, damping: float, turns: int) -> None:
        library = ctypes.CDLL(str(_compiled()))
        self._solve = library.solve_all
        self._solve.restype = ctypes.c_int
        self._finger = np.ascontiguousarray(_constants(model, tip))
        self._settings = (ctypes.c_double(tolerance), ctypes.c_double(damping), ctypes.c_int(turns))

    def solve(self, points: Array, rotations: Array, start: Array) -> tuple[Array, int]:
        """Postures (n, 4), rad, of tips at points (n, 3), m, with rotations (n, 3, 3); and how many were reached."""
        found = np.empty((len(points), 4))
        given = [np.ascontiguousarray(values, dtype=np.float64) for values in (points, rotations, start)]
        places, turns, begin = (_pointer(values) for values in given)
        reached = self._solve(
            _pointer(self._finger), ctypes.c_int(len(points)), places, turns, begin, *self._settings, _pointer(found)
        )
        return found, int(reached)


def compiler() -> str | None:
    """Where the C compiler is, if there is one: $CC or cc."""
    return shutil.which(os.environ.get("CC", "cc"))


def _compiled() -> Path:
    found = compiler()
    assert found is not None
    target = Path(tempfile.mkdtemp()) / "least_squares.so"
    subprocess.run([found, *FLAGS, "-o", str(target), str(SOURCE), "-lm"], check=True)
    return target


def _constants(model: pin.Model, tip: int) -> Array:
    """The `finger` of least_squares.c: of each joint its orientation, its place and its axis; then the tip's place."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    placed = list(model.jointPlacements)[1:]
    axes = [pin.getJointJacobian(model, data, k + 1, pin.LOCAL)[3:, k] for k in range(model.nq)]
    parts = [place.rotation.ravel() for place in placed] + [place.translation for place in placed]
    return np.concatenate([*parts, *axes, model.frames[tip].placement.translation])


def _pointer(values: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)
