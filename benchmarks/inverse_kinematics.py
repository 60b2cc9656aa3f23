"""How many times faster a closed-form solve is than Pinocchio's damped least squares, in the same run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator

import numpy as np
import pinocchio as pin

from allegro_twin.description.hands import load_spec
from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.closed_form import FingerKinematics
from allegro_twin.types import Array

BATCH, ONE_BY_ONE, ROUNDS = 100_000, 300, 5
TOLERANCE, DAMPING, TURNS = 1e-6, 1e-6, 200
Figure = tuple[str, float, float, str]


def figures() -> Iterator[Figure]:
    """Against a baseline that asks for less: the position alone, on a model of the one finger, from mid-range."""
    spec = load_spec()
    for name in ("index", "thumb"):
        finger = FingerKinematics(spec, name)
        q = np.random.default_rng(0).uniform(finger.lower, finger.upper, (BATCH, 4))
        points = finger.fk(q).position
        values = q[:, 0] if name == "thumb" else q[:, 1:].sum(axis=1)
        least_squares = LeastSquares(spec.name, list(spec.joints), spec.finger(name).joints, spec.finger(name).tip)
        batched, scalar = [], []
        for _ in range(ROUNDS):
            slow = _each(lambda k: least_squares.solve(points[k], (finger.lower + finger.upper) / 2), ONE_BY_ONE)
            batched.append(slow / _batched(finger, points, values))
            scalar.append(slow / _scalar(finger, points, values))
        yield f"IK batched, {name}, times Pinocchio DLS's speed (at least)", statistics.median(batched), 200.0, "x"
        yield f"IK scalar, {name}, times Pinocchio DLS's speed (at least)", statistics.median(scalar), 50.0, "x"


class LeastSquares:
    """Δq = Jᵀ (J Jᵀ + λ)⁻¹ (p - p(q)) in a model reduced to one finger, until the tip is within 1 µm or 200 turns."""

    def __init__(self, hand: str, joints: list[str], finger: tuple[int, ...], tip: str) -> None:
        whole = pin.buildModelFromUrdf(str(data_root() / "models" / "urdf" / f"{hand}.urdf"))
        others = [whole.getJointId(name) for j, name in enumerate(joints) if j not in finger]
        self._model = pin.buildReducedModel(whole, others, np.zeros(whole.nq))
        self._data, self._tip = self._model.createData(), self._model.getFrameId(tip)

    def solve(self, point: Array, start: Array) -> Array:
        model, data, tip, damping = self._model, self._data, self._tip, DAMPING * np.eye(3)
        q = start.copy()
        for _ in range(TURNS):
            pin.computeJointJacobians(model, data, q)
            placement = pin.updateFramePlacement(model, data, tip)
            error = point - placement.translation
            if error @ error < TOLERANCE**2:
                break
            jacobian = pin.getFrameJacobian(model, data, tip, pin.LOCAL_WORLD_ALIGNED)[:3]
            q += jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping, error)
        return q


def _batched(finger: FingerKinematics, points: Array, values: Array) -> float:
    start = time.perf_counter()
    solutions = finger.ik(points, q0=values) if finger.name == "thumb" else finger.ik(points, pitch=values)
    elapsed = time.perf_counter() - start
    assert solutions.reachable.all()
    return elapsed / len(points)


def _scalar(finger: FingerKinematics, points: Array, values: Array) -> float:
    solve = finger.scalar.at_q0 if finger.name == "thumb" else finger.scalar.at_pitch
    rows = [(*map(float, point), float(value)) for point, value in zip(points[:5000], values[:5000], strict=True)]
    return _each(lambda k: solve(*rows[k]), len(rows))


def _each(solve: Callable[[int], object], n: int) -> float:
    """Seconds a call."""
    start = time.perf_counter()
    for k in range(n):
        solve(k)
    return (time.perf_counter() - start) / n
