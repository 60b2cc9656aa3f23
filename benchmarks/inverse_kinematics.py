"""How many times faster a closed-form solve is than Pinocchio's damped least squares, in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pinocchio as pin

from allegro_twin.description.hands import load_spec
from allegro_twin.files.assets import data_root
from allegro_twin.kinematics.closed_form import FingerKinematics
from allegro_twin.types import Array

BATCH, ONE_BY_ONE, SCALAR, ROUNDS = 100_000, 300, 5000, 25
TOLERANCE, DAMPING, TURNS = 1e-6, 1e-6, 200
Figure = tuple[str, float, float, str]


def figures() -> Iterator[Figure]:
    """Both find the posture behind a fingertip pose: ours from the position and φ or q₀, least squares from the pose.

    The baseline is the fastest that we know how to write: a model of the one finger, from mid-range, a damping that
    suits it (99.9 % and more of its solves succeed), and no retries.
    """
    spec = load_spec()
    for name in ("index", "thumb"):
        finger = FingerKinematics(spec, name)
        q = np.random.default_rng(0).uniform(finger.lower, finger.upper, (BATCH, 4))
        points, rotations = finger.fk(q)
        values = q[:, 0] if name == "thumb" else q[:, 1:].sum(axis=1)
        least_squares = LeastSquares(spec.name, list(spec.joints), spec.finger(name).joints, spec.finger(name).tip)
        middle = (finger.lower + finger.upper) / 2
        ratios = []
        for _ in range(ROUNDS):  # Turn by turn, and the middle ratio: others use the machine too, at every moment.
            slow = least_squares.timed(points[:ONE_BY_ONE], rotations, middle)
            ratios.append((slow / _batched(finger, points, values), slow / _scalar(finger, points, values)))
        batched, scalar = np.median(ratios, axis=0).tolist()
        yield f"IK batched, {name}, times Pinocchio DLS's speed (at least)", batched, 200.0, "x"
        yield f"IK scalar, {name}, times Pinocchio DLS's speed (at least)", scalar, 50.0, "x"


class LeastSquares:
    """Δq = Jᵀ (J Jᵀ + λ)⁻¹ log(T(q)⁻¹ T) in a model of one finger, to 1 µm and 1 µrad, or for 200 turns."""

    def __init__(self, hand: str, joints: list[str], finger: tuple[int, ...], tip: str) -> None:
        whole = pin.buildModelFromUrdf(str(data_root() / "models" / "urdf" / f"{hand}.urdf"))
        others = [whole.getJointId(name) for j, name in enumerate(joints) if j not in finger]
        self._model = pin.buildReducedModel(whole, others, np.zeros(whole.nq))
        self._data, self._tip = self._model.createData(), self._model.getFrameId(tip)

    def timed(self, points: Array, rotations: Array, start: Array) -> float:
        """Seconds a solve."""
        return _each(self.solve, [(point, rotation, start) for point, rotation in zip(points, rotations, strict=False)])

    def solve(self, point: Array, rotation: Array, start: Array) -> Array:
        model, data, tip, damping = self._model, self._data, self._tip, DAMPING * np.eye(6)
        q, target = start.copy(), pin.SE3(rotation, point)
        for _ in range(TURNS):
            pin.computeJointJacobians(model, data, q)
            placement = pin.updateFramePlacement(model, data, tip)
            error = pin.log6(placement.actInv(target)).vector
            if error[:3] @ error[:3] < TOLERANCE**2 and error[3:] @ error[3:] < TOLERANCE**2:
                break
            jacobian = pin.getFrameJacobian(model, data, tip, pin.LOCAL)
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
    rows = [(*map(float, point), float(value)) for point, value in zip(points[:SCALAR], values, strict=False)]
    return _each(solve, rows)


def _each(solve: Callable[..., object], rows: Sequence[tuple[object, ...]]) -> float:
    """Seconds a call."""
    start = time.perf_counter()
    for row in rows:
        solve(*row)
    return (time.perf_counter() - start) / len(rows)
