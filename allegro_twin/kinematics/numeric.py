"""Inverse kinematics by iteration, for fingers without a closed form: damped least squares, from several postures.

e = target - tip, Δq = Jᵀ (J Jᵀ + μ 1)⁻¹ e with μ = (|e| / 10)², which vanishes with the error (Sugihara,
"Solvability-unconcerned inverse kinematics by the Levenberg–Marquardt method", IEEE T-RO 27(5), 2011), inside the joint
limits: joints that lean on one are left out of the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arguments import FURTHEST, check_margin, finite, rows, too_far
from allegro_twin.kinematics.chain import FingerChain
from allegro_twin.kinematics.orientation import angle_between, matrix_from_euler, matrix_from_quaternion
from allegro_twin.kinematics.pose import Pose
from allegro_twin.kinematics.solutions import Flags, Nearest, Solutions
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

_ROUNDS, _STALLED = 100, 6  # At most; and rounds without a nearer posture after which a descent ends.
_MET, _THERE = 1e-8, 1e-6  # m: near enough to stop, and to count as reached.
_NEARER = 1.0 - 1e-4  # Of |e|²: what counts as nearer.
_SETTLED, _LONGEST = 1e-10, 0.4  # rad: a step that is the last, and the longest.
_DAMPING = 0.01  # Of |e|².
_LEAST = 1e-12, 3e-9  # m², of the damping; with less the inverse for one or two joints is lost in rounding.
_NO_LIMITS = 20.0  # rad
_PULL, _DRAWN = 0.03, 8
"""Share of the distance to `near` that a round moves where that costs the tip nothing, and number of rounds."""
_SEEDS, _RESTARTS = 1024, 12  # Postures whose tips are known, and how many of them a search may begin at.
_TURN = 2e-3  # m/rad. What an orientation weighs against the position.


class _Limits(NamedTuple):
    lower: Vector
    upper: Vector


class NumericFinger:
    """Forward and inverse kinematics of a finger with any number k of joints, or motors, in the palm frame.

    It finds the posture near a given one, or, without one, near the middle of the ranges; where the descent from there
    ends on the way, it begins anew at postures whose tips are near the target. Where no posture reaches the target, the
    nearest that was found is told. Joints between root and finger that are not the finger's, such as a wrist's, are
    where they rest, or where `HandKinematics.finger` was told that they are.
    """

    def __init__(self, spec: HandSpec, chain: FingerChain, finger: str) -> None:
        joints = list(spec.finger(finger).joints)
        self.shared: tuple[str, ...] = tuple(
            f.name for f in spec.fingers if f.name != finger and set(f.joints) & set(joints)
        )
        """Fingers that one of its motors moves as well."""
        self.elsewhere = chain.elsewhere
        """Whether the tip depends on joints that are not the finger's, such as a wrist's."""
        self.name, self.lower, self.upper = finger, spec.lower[joints], spec.upper[joints]
        self._chain, self._k, self._hand = chain, len(joints), spec.name
        self._seeds: tuple[Array, Array] | None = None

    def fk(self, position: ArrayLike) -> Pose:
        """The fingertip in the palm frame, joints (..., k), rad → position (..., 3), m, and rotation (..., 3, 3)."""
        q = rows(f"{self.name}: position", position, self._k)
        q = finite(f"{self.name}: position", q, *q.shape)
        tip, axes, *_ = self._chain.many(q.reshape(-1, self._k).T)
        return Pose(tip.T.reshape(*q.shape[:-1], 3).copy(), axes.transpose(2, 1, 0).reshape(*q.shape[:-1], 3, 3).copy())

    def ik(
        self,
        position: ArrayLike,
        *,
        rotation: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        euler: ArrayLike | None = None,
        near: ArrayLike | None = None,
        margin: float = 0.0,
        **held: ArrayLike | None,
    ) -> Solutions:
        """The posture with the tip at a point, shape (..., 3), m, one branch for each; the search begins at `near`, a
        posture of the finger, (..., k), rad, by default the middle of its range.

        An orientation, as `rotation` (..., 3, 3), `quaternion` (..., 4) or `euler` (..., 3), rad, is met as nearly as
        the position allows; the solutions say by what angle it is missed. `margin` is taken off both ends of every
        joint's range, rad. Raises ConfigError for what does not fit, and for another angle, which it does not hold.
        """
        if loose := [name for name, value in held.items() if value is not None]:
            raise ConfigError(
                f"{self.name} of {self._hand} has no closed form: leave out {loose[0]}, its tip turns as it comes"
            )
        margin = float(finite(f"{self.name}: margin", margin))
        check_margin(self.name, margin, self.lower, self.upper)
        limits, targets = _Limits(self.lower + margin, self.upper - margin), rows(f"{self.name}: position", position, 3)
        shape = targets.shape[:-1]
        starts = self._starts(near, shape, limits)
        targets = finite(f"{self.name}: position", targets, *targets.shape).reshape(-1, 3)
        if (np.abs(targets) > FURTHEST).any():
            raise too_far(self.name, targets)
        turns = self._rotations(rotation, quaternion, euler, shape)
        postures, distances = self._solve(targets, starts, limits, turns, near=near is not None)
        reached = distances < _THERE
        angle = np.zeros((*shape, 1)) if turns is None else self._missed(postures, turns).reshape(*shape, 1)

        def nearest(missing: Flags, limited: bool) -> Nearest:
            free = _Limits(np.full(self._k, -_NO_LIMITS), np.full(self._k, _NO_LIMITS))
            left, far = (
                (postures, distances) if limited else self._solve(targets, starts, free, None, near=near is not None)
            )
            points = np.where(missing.reshape(-1, 1), self.fk(left).position, targets)
            far = np.where(missing.reshape(-1), far, 0.0)
            return Nearest(left.reshape(*shape, -1), points.reshape(*shape, 3), far.reshape(shape))

        found = np.where(reached[:, None], postures, np.nan).reshape(*shape, 1, self._k)
        return Solutions(found, reached.reshape(*shape, 1), angle, frozen(limits.lower), frozen(limits.upper), nearest)

    def _rotations(
        self, rotation: ArrayLike | None, quaternion: ArrayLike | None, euler: ArrayLike | None, shape: tuple[int, ...]
    ) -> Array | None:
        """The orientation asked for, (targets, 3, 3)."""
        asked = {"rotation": rotation, "quaternion": quaternion, "euler": euler}
        given = [name for name, value in asked.items() if value is not None]
        if not given:
            return None
        if len(given) > 1:
            raise ConfigError(f"{self.name}: {given[0]} and {given[1]} both say an orientation: leave one out")
        sizes: dict[str, tuple[int, ...]] = {"rotation": (3, 3), "quaternion": (4,), "euler": (3,)}
        values = rows(f"{self.name}: {given[0]}", asked[given[0]], *sizes[given[0]])
        values = finite(f"{self.name}: {given[0]}", values, *values.shape)
        convert: dict[str, Callable[[Array], Array]] = {
            "rotation": np.asarray, "quaternion": matrix_from_quaternion, "euler": matrix_from_euler
        }  # fmt: skip
        try:
            return np.broadcast_to(convert[given[0]](values), (*shape, 3, 3)).reshape(-1, 3, 3)
        except ValueError as error:
            raise ConfigError(
                f"{self.name}: {given[0]} {values.shape} does not go with positions {(*shape, 3)}"
            ) from error

    def _missed(self, postures: Array, turns: Array) -> Vector:
        """Angles between the tips' orientations and those asked for, (targets,), rad."""
        return angle_between(self.fk(postures).rotation, turns)

    def _starts(self, near: ArrayLike | None, shape: tuple[int, ...], limits: _Limits) -> Array:
        """A posture for each target to begin at, (targets, k), rad."""
        start = (limits.lower + limits.upper) / 2 if near is None else rows(f"{self.name}: near", near, self._k)
        start = finite(f"{self.name}: near", start, *start.shape)
        try:
            return np.broadcast_to(start, (*shape, self._k)).reshape(-1, self._k)
        except ValueError as error:
            raise ConfigError(f"{self.name}: near {start.shape} does not go with positions {(*shape, 3)}") from error

    def _solve(
        self, targets: Array, starts: Array, limits: _Limits, turns: Array | None, *, near: bool
    ) -> tuple[Array, Vector]:
        """For each target the best posture found, (targets, k), rad, and its distance, (targets,), m. Not `near`: the
        search for one target begins where a tip is near it, and `starts` is what redundant joints are drawn to."""
        if len(targets) == 1 and turns is None:
            posture, far = self._solve_one(targets[0].tolist(), starts[0], limits, near=near)
            return posture[None], np.array([far])
        home = starts.T
        q, distance = self._descend_many(targets.T, home, limits, turns, home)
        for attempt in range(_RESTARTS):
            left = np.flatnonzero(distance >= _THERE)
            if not len(left):
                break
            seeds = self._nearest_seeds(targets[left], limits, attempt)
            some = None if turns is None else turns[left]
            again, missed = self._descend_many(targets[left].T, seeds.T, limits, some, home[:, left])
            better = missed < distance[left]
            q[:, left[better]], distance[left[better]] = again[:, better], missed[better]
        return np.ascontiguousarray(q.T), distance

    def _solve_one(self, target: list[float], start: Vector, limits: _Limits, *, near: bool) -> tuple[Vector, float]:
        lower, upper, home = limits.lower.tolist(), limits.upper.tolist(), start.tolist()
        best, least = home, float("inf")
        for attempt in range(_RESTARTS + 1):
            number = attempt - 1 if near else attempt
            own = number == (-1 if near else _RESTARTS)
            begin = home if own else self._nearest_seeds(np.array([target]), limits, number)[0].tolist()
            q, distance = self._descend_one(target, begin, home, lower, upper)
            if distance < least:
                best, least = q, distance
            if least < _THERE:
                break
        return np.array(best), least

    def _nearest_seeds(self, targets: Array, limits: _Limits, attempt: int) -> Array:
        """Fixed seed postures, the same in every call, whose tip is the `attempt`-th nearest, as indices (targets,
        k)."""
        if self._seeds is None:
            seeds = np.random.default_rng(0).uniform(self.lower, self.upper, (_SEEDS, self._k))
            self._seeds = seeds, self._chain.many(seeds.T)[0].T
        seeds, tips = self._seeds
        found = np.empty(len(targets), dtype=np.int64)
        for first in range(0, len(targets), 4096):
            some = targets[first : first + 4096]
            distance = (some * some).sum(axis=1)[:, None] - 2.0 * some @ tips.T + (tips * tips).sum(axis=1)
            found[first : first + 4096] = np.argpartition(distance, attempt, axis=1)[:, attempt]
        return np.clip(seeds[found], limits.lower, limits.upper)

    def _descend_many(
        self, targets: Array, starts: Array, limits: _Limits, turns: Array | None, home: Array
    ) -> tuple[Array, Vector]:
        """From postures (k, N) to the best of their descents, (k, N), and its distance, (N,), m."""
        lower, upper = limits.lower[:, None], limits.upper[:, None]
        best = np.clip(starts, lower, upper)
        least = np.full(targets.shape[1], np.inf)
        rows_, q = np.arange(targets.shape[1]), best.copy()
        stalled = np.zeros(targets.shape[1], dtype=np.int64)
        for turn in range(2 * _ROUNDS):
            tip, axes, moves, spins = self._chain.many(q)
            error = targets[:, rows_] - tip
            distance = np.sqrt((error * error).sum(axis=0))
            # With an orientation the first half of the rounds weighs it, the rest brings the tip to its point again.
            weighed = turns is not None and turn < _ROUNDS
            better = (distance < least[rows_]) | weighed
            no_nearer = (distance**2 > _NEARER * least[rows_] ** 2) & (not weighed)
            stalled[rows_] = np.where(no_nearer, stalled[rows_] + 1, 0)
            chosen = rows_[better]
            best[:, chosen], least[chosen] = q[:, better], distance[better]
            if weighed:
                assert turns is not None
                step = _step_with_turn(error, axes, moves, spins, turns[rows_], q, lower, upper)
            else:
                share = _PULL if turn < _DRAWN else 0.0
                step = _step(error, distance, moves, share * (home[:, rows_] - q), q, lower, upper)
            new = np.clip(q + step, lower, upper)
            moving = np.abs(new - q).max(axis=0) > _SETTLED
            going = moving | weighed if weighed else moving & (distance > _MET) & (stalled[rows_] < _STALLED)
            if not weighed and turn - (_ROUNDS if turns is not None else 0) >= _ROUNDS - 1:
                break
            if not going.all():
                rows_, new = rows_[going], new[:, going]
            if not len(rows_):
                break
            q = new
        return best, least

    def _descend_one(
        self, target: list[float], start: list[float], home: list[float], lower: list[float], upper: list[float]
    ) -> tuple[list[float], float]:
        """As `_descend_many` of one target without an orientation, in plain floats."""
        one, k = self._chain.one, self._k
        q = [min(max(value, low), high) for value, low, high in zip(start, lower, upper, strict=True)]
        best, least, stalled = q, float("inf"), 0
        for turn in range(_ROUNDS):
            (tx, ty, tz), columns = one(q)
            ex, ey, ez = target[0] - tx, target[1] - ty, target[2] - tz
            square = ex * ex + ey * ey + ez * ez
            stalled = stalled + 1 if square > _NEARER * least else 0
            if square < least:
                best, least = q, square
            if square < _MET * _MET or stalled >= _STALLED:
                break
            share = _PULL if turn < _DRAWN else 0.0
            pull = [share * (wanted - value) for wanted, value in zip(home, q, strict=True)]
            step = _step_one(ex, ey, ez, square, columns, pull, q, lower, upper)
            new = [min(max(q[m] + step[m], lower[m]), upper[m]) for m in range(k)]
            if max(abs(new[m] - q[m]) for m in range(k)) < _SETTLED:
                break
            q = new
        return best, least**0.5


def _step_one(
    ex: float, ey: float, ez: float, square: float, columns: list[list[float]], pull: list[float],
    q: list[float], lower: list[float], upper: list[float],
) -> list[float]:  # fmt: skip
    k = len(q)
    free = [True] * k
    step = [0.0] * k
    for _ in range(k):
        xx = yy = zz = _DAMPING * square + _LEAST[k < 3]
        xy = xz = yz = 0.0
        px = py = pz = 0.0
        for m in range(k):
            if free[m]:
                a, b, c = columns[m]
                xx, yy, zz, xy, xz, yz = xx + a * a, yy + b * b, zz + c * c, xy + a * b, xz + a * c, yz + b * c
                w = pull[m]
                px, py, pz = px + a * w, py + b * w, pz + c * w
        m00, m01, m02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        m11, m12, m22 = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        scale = 1.0 / (xx * m00 + xy * m01 + xz * m02)
        # Δq = Jᵀ A (e - J p) + p: the pull p where it costs the tip nothing.
        rx, ry, rz = ex - px, ey - py, ez - pz
        fx = (m00 * rx + m01 * ry + m02 * rz) * scale
        fy = (m01 * rx + m11 * ry + m12 * rz) * scale
        fz = (m02 * rx + m12 * ry + m22 * rz) * scale
        beyond = False
        for m in range(k):
            if free[m]:
                a, b, c = columns[m]
                s = a * fx + b * fy + c * fz + pull[m]
                if (s < 0.0 and q[m] <= lower[m]) or (s > 0.0 and q[m] >= upper[m]):
                    free[m], beyond = False, True
                    s = 0.0
                step[m] = s
        if not beyond:
            break
    longest = max(max(step), -min(step))
    return [s * _LONGEST / longest for s in step] if longest > _LONGEST else step


def _step(error: Array, distance: Vector, moves: Array, pull: Array, q: Array, lower: Array, upper: Array) -> Array:
    """Δq of many, (k, N)."""
    free = np.ones(q.shape)
    step = np.zeros(q.shape)
    for _ in range(2):
        used = moves * free[:, None]
        inverse = _inverse(np.einsum("kin,kjn->ijn", used, used), _DAMPING * distance * distance + _LEAST[len(q) < 3])
        own = pull * free
        left = error - np.einsum("kin,kn->in", used, own)
        step = np.einsum("kin,in->kn", used, np.einsum("ijn,jn->in", inverse, left)) + own
        beyond = ((q <= lower) & (step < 0.0)) | ((q >= upper) & (step > 0.0))
        if not (beyond & (free > 0.0)).any():
            break
        free[beyond] = 0.0
    step *= free
    return np.asarray(step * np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=0), 1e-12)))


def _step_with_turn(
    error: Array, axes: Array, moves: Array, spins: Array, turns: Array, q: Array, lower: Array, upper: Array
) -> Array:
    """Δq of many that also turns the tip: the rotation vector from its axes to those asked for, weighed."""
    wanted = turns.transpose(2, 1, 0)  # Columns first, as `axes`.
    turn = 0.5 * np.sum([np.cross(axes[k], wanted[k], axis=0) for k in range(3)], axis=0)
    sine = np.sqrt((turn * turn).sum(axis=0))
    cosine = ((axes * wanted).sum(axis=(0, 1)) - 1.0) / 2.0
    turn = turn * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-9))
    residual = np.concatenate([error, _TURN * turn]).transpose(1, 0)
    jacobian = np.concatenate([moves, _TURN * spins], axis=1).transpose(2, 1, 0)
    free = np.ones(q.shape).T
    step = np.zeros(free.shape)
    for _ in range(2):
        used = jacobian * free[:, None, :]
        square = (residual * residual).sum(axis=1)
        normal = used.transpose(0, 2, 1) @ used + ((1e-3 * square + 1e-12)[:, None, None] * np.eye(q.shape[0]))
        step = np.linalg.solve(normal, (used.transpose(0, 2, 1) @ residual[:, :, None]))[:, :, 0]
        beyond = (((q <= lower) & (step.T < 0.0)) | ((q >= upper) & (step.T > 0.0))).T
        if not (beyond & (free > 0.0)).any():
            break
        free[beyond] = 0.0
    step = (step * free).T
    return np.asarray(step * np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=0), 1e-12)))


def _inverse(matrix: Array, damping: Vector) -> Array:
    """Inverses of symmetric matrices (3, 3, N) with a number added to their diagonals, by cofactors."""
    (a, b, c), (_, d, e), (*_, f) = matrix
    a, d, f = a + damping, d + damping, f + damping
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    dd, de, ff = a * f - c * c, b * c - a * e, a * d - b * b
    return np.asarray(np.array([[aa, ab, ac], [ab, dd, de], [ac, de, ff]]) / (a * aa + b * ab + c * ac))
