"""How many times faster a closed-form solve is than damped least squares, and what one call costs, in the same run.

`python -m benchmarks.inverse_kinematics` prints these alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
import pinocchio as pin

from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.kinematics.orientation import (
    euler_from_matrix,
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_from_vector,
)
from allegro_twin.types import Array
from benchmarks.compiled import CompiledLeastSquares, compiler

BATCH, ONE_BY_ONE, COMPILED, SCALAR, ROUNDS = 100_000, 300, 5000, 5000, 25
CALLS, NOISE = 300, 0.02  # Single calls, and rad by which a pose is off what the finger can do.
TOLERANCE, DAMPING, TURNS = 1e-6, 1e-6, 200
Figure = tuple[str, float, float, str]


def figures() -> Iterator[Figure]:
    """Both find the posture behind a fingertip pose: ours from the position and φ or q₀, least squares from the pose.

    The baselines are the fastest that we know how to write: a model of the one finger, from mid-range, a damping that
    suits it (99.9 % and more of its solves succeed), and no retries: Pinocchio driven from Python; and C for this one
    finger, which solves for the four joints instead of the six numbers of the pose.
    """
    for name in ("index", "thumb"):
        yield from _ratios(name)
    for name in ("index", "middle", "ring", "thumb"):
        yield from _calls(name)


def _ratios(name: str) -> Iterator[Figure]:
    finger, q = _postures(name, BATCH)
    points, rotations = finger.fk(q)
    values = q[:, 0] if name == "thumb" else q[:, 1:].sum(axis=1)
    slow, middle = LeastSquares(name), (finger.lower + finger.upper) / 2
    compiled = slow.compiled() if compiler() else None
    rounds = []
    for _ in range(ROUNDS):  # Turn by turn, and the middle ratio: others use the machine too, at every moment.
        ours = np.array([_batched(finger, points, values), _scalar(finger, points, values)])
        python = slow.timed(points[:ONE_BY_ONE], rotations, middle)
        c = np.nan if compiled is None else _compiled(compiled, points[:COMPILED], rotations[:COMPILED], middle)
        rounds.append([*(python / ours), *(c / ours)])
    ratios = np.median(rounds, axis=0).tolist()
    without = "" if compiled else ": no compiler"
    yield f"IK batched, {name}, times Pinocchio DLS's speed (at least)", ratios[0], 400.0, "x"
    yield f"IK scalar, {name}, times Pinocchio DLS's speed (at least)", ratios[1], 50.0, "x"
    yield f"IK batched, {name}, times compiled DLS's speed (at least){without}", ratios[2], 10.0, "x"
    yield f"IK scalar, {name}, times compiled DLS's speed (at least){without}", ratios[3], 1.0, "x"


def _calls(name: str) -> Iterator[Figure]:
    """The middle one of single calls of `ik`, each with another target, and of `nearest` where it is out of reach."""
    finger, q = _postures(name, CALLS)
    rng = np.random.default_rng(1)
    near, far = rng.uniform(finger.lower, finger.upper, q.shape), rng.uniform(-0.25, 0.25, (CALLS, 3))
    points, rotations = finger.fk(q)
    axes = rng.normal(size=(CALLS, 3))
    axes *= NOISE / np.linalg.norm(axes, axis=1, keepdims=True)
    noisy = rotations @ matrix_from_quaternion(quaternion_from_vector(axes))
    held = {"q0": q[:, 0], "q1": q[:, 1], "psi": q[:, 2] + q[:, 3]} if name == "thumb" else {"pitch": q[:, 1:].sum(1)}
    quaternions, eulers = quaternion_from_matrix(rotations), euler_from_matrix(rotations)
    rows: dict[str, list[Callable[[], object]]] = {
        "position": [partial(finger.ik, point) for point in points],
        "near": [partial(finger.ik, point, near=wish) for point, wish in zip(points, near, strict=True)],
        "pose": [partial(finger.ik, point, rotation=turn) for point, turn in zip(points, rotations, strict=True)],
        f"pose off by {NOISE} rad": [
            partial(finger.ik, point, rotation=turn) for point, turn in zip(points, noisy, strict=True)
        ],
        "quaternion": [partial(finger.ik, p, quaternion=turn) for p, turn in zip(points, quaternions, strict=True)],
        "euler": [partial(finger.ik, p, euler=turn) for p, turn in zip(points, eulers, strict=True)],
        "nearest()": [finger.ik(point).nearest for point in far],
    }
    for mode, values in held.items():
        rows[mode] = [partial(finger.ik, p, **{mode: float(v)}) for p, v in zip(points, values, strict=True)]
    for what, calls in rows.items():
        yield f"IK, one call, {name}, {what} (at most)", 1e6 * _median(calls), 50.0, "µs"


class LeastSquares:
    """Δq = Jᵀ (J Jᵀ + λ)⁻¹ log(T(q)⁻¹ T) in a model of one finger, to 1 µm and 1 µrad, or for 200 turns."""

    def __init__(self, finger: str) -> None:
        spec = load_spec()
        whole = pin.buildModelFromUrdf(str(data_root() / "models" / "urdf" / f"{spec.name}.urdf"))
        others = [whole.getJointId(name) for j, name in enumerate(spec.joints) if j not in spec.finger(finger).joints]
        self._model = pin.buildReducedModel(whole, others, np.zeros(whole.nq))
        self._data, self._tip = self._model.createData(), self._model.getFrameId(spec.finger(finger).tip)

    def compiled(self) -> CompiledLeastSquares:
        """The same in C."""
        return CompiledLeastSquares(self._model, self._tip, TOLERANCE, DAMPING, TURNS)

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


def _postures(name: str, n: int) -> tuple[ClosedFormFinger, Array]:
    finger = ClosedFormFinger(load_spec(), name)
    return finger, np.random.default_rng(0).uniform(finger.lower, finger.upper, (n, 4))


def _batched(finger: ClosedFormFinger, points: Array, values: Array) -> float:
    start = time.perf_counter()
    solutions = finger.ik(points, q0=values) if finger.name == "thumb" else finger.ik(points, pitch=values)
    elapsed = time.perf_counter() - start
    assert solutions.reachable.all()
    return elapsed / len(points)


def _scalar(finger: ClosedFormFinger, points: Array, values: Array) -> float:
    solve = finger.scalar.at_q0 if finger.name == "thumb" else finger.scalar.at_pitch
    rows = [(*map(float, point), float(value)) for point, value in zip(points[:SCALAR], values, strict=False)]
    return _each(solve, rows)


def _compiled(solver: CompiledLeastSquares, points: Array, rotations: Array, start: Array) -> float:
    begin = time.perf_counter()
    _, reached = solver.solve(points, rotations, start)
    elapsed = time.perf_counter() - begin
    assert reached > 0.99 * len(points), f"least squares reached {reached} of {len(points)}"
    return elapsed / len(points)


def _each(solve: Callable[..., object], rows: Sequence[tuple[object, ...]]) -> float:
    """Seconds a call."""
    start = time.perf_counter()
    for row in rows:
        solve(*row)
    return (time.perf_counter() - start) / len(rows)


def _median(calls: Sequence[Callable[[], object]]) -> float:
    """Seconds of the middle call; of each the least of five, as others use the machine too."""
    times = np.full(len(calls), np.inf)
    for row, call in [*enumerate(calls)] * 5:
        start = time.perf_counter()
        call()
        times[row] = min(times[row], time.perf_counter() - start)
    return float(np.median(times))


if __name__ == "__main__":
    from benchmarks.figures import show

    show(figures())
