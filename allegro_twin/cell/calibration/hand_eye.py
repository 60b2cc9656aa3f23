"""Hand-eye calibration: where a camera is on an arm, or beside it, from pictures of a calibration pattern.

Camera at the wrist: the pattern lies still. Camera that stands still: the pattern is on the arm. In both the pattern is
at T = X⁻¹ B Z in the camera's frame: X is the camera in the frame that it is fixed to, Z the pattern in its own, and B
what the arm's encoders say, its pose A in the base or A⁻¹. X and Z are what is looked for.

1. In each picture alone, the pattern's pose C is where the corners are least off, in pixels; by how much they are off
   and by their places it has a covariance.
2. A first X and Z by AX = XB in closed form: rotations after Park and Martin 1994, translations by least squares.
3. X and Z where the poses C are least off T, each weighted by its covariance and by that of the arm's own errors, all
   pictures at once. How large the arm's errors are is taken from the pictures, too (restricted maximum likelihood).
   Without errors of the arm this is the least reprojection error; with them that would trust the arm too much.

The stated error is a jackknife: the whole is solved again without each picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_from_vector,
    vector_from_quaternion,
)
from allegro_twin.kinematics.pose import Pose, compose, relative_to
from allegro_twin.types import Array, Vector

FEWEST = 6
"""Pictures. With fewer, leaving one out says little about the error."""
LEAST_TURN = np.radians(8.0)
"""Of the pictures against each other, about the second of their axes, root mean square: with less the position along
the first axis is hardly determined. OWN: at 8° the error is some three times that of a set that turns by 30°."""
MOST = 3.0
"""Pixels, root mean square. Beyond it arm and pictures do not belong together."""
_OUTLIER, _SLIGHT = 5.0, 1.0  # Times the median of the other pictures, and pixels: one that disagrees alone,
_HALF = 0.6  # and without which the others agree so much better; a picture that merely weighs much does not pass this.
_STEPS, _DONE = 30, 1e-10
_EXACT = 1e-6  # Pixels. Corners are never taken for more exact than this.
_BEHIND = 1e-3  # m. A corner that would be nearer, or behind the camera, is far off.
_ARM_POSITIONS = (0.0, *np.geomspace(1e-5, 1e-2, 7))  # m,
_ARM_ROTATIONS = (0.0, *np.radians(np.geomspace(1e-3, 1.0, 7)))  # and rad: the errors of an arm that are tried.


class PatternView(NamedTuple):
    """One picture of the pattern."""

    name: str
    arm: Pose
    """The frame that moves, in the arm's base, as the encoders say."""
    pattern: Pose
    """The pattern in the camera's frame, by this picture alone."""
    points: Array
    """Corners in the pattern's frame, (k, 3), m."""
    pixels: Array
    """Where they are in the picture, without distortion, (k, 2): column and row."""


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeCalibration:
    """Where the camera is, and how far that may be off."""

    camera: Pose
    """In the frame of the arm that moves with it, or in the arm's base where it stands still."""
    pattern: Pose
    """In the arm's base, or in the frame of the arm that moves with it."""
    position_deviation: float
    """Standard deviation of the camera's position, m: root of the sum over three axes."""
    rotation_deviation: float
    """Likewise of its orientation, rad."""
    arm_position: float
    """How far the arm's poses are off by the pictures, standard deviation along each axis, m."""
    arm_rotation: float
    """Likewise about each axis, rad."""
    residual: float
    """Between corners as they were seen and as they are to be, root mean square, pixels."""
    held_out: float
    """The same, of each picture by the others alone."""
    turn: float
    """Of the pictures against each other about the second of their axes, root mean square, rad."""
    views: tuple[tuple[str, float], ...]
    """Each picture, and its root mean square, pixels."""

    @property
    def position_error(self) -> float:
        """The camera is nearer than this to where it is said to be, m, at 95 %."""
        return _student(len(self.views) - 2) * self.position_deviation

    @property
    def rotation_error(self) -> float:
        """Likewise its orientation, rad."""
        return _student(len(self.views) - 2) * self.rotation_deviation


class _Problem(NamedTuple):
    """All pictures, as arrays over them."""

    rotation: Array
    """Of B, (n, 3, 3)."""
    position: Array
    """Of B, (n, 3), m."""
    seen_rotation: Array
    """Of C, (n, 3, 3)."""
    seen_position: Array
    """Of C, (n, 3), m."""
    covariance: Array
    """Of C by the corners, (n, 6, 6): position, m, and rotation vector, rad, in the axes of the pattern."""

    def part(self, kept: NDArray[np.bool_]) -> _Problem:
        """Some of the pictures."""
        return _Problem(*(values[kept] for values in self))


class _ArmError(NamedTuple):
    """Standard deviations of the arm's pose along and about each axis."""

    position: float
    """m."""
    rotation: float
    """rad."""


def calibrate_hand_eye(views: Sequence[PatternView], lens: Intrinsics, *, at_the_wrist: bool) -> HandEyeCalibration:
    """Solve for the camera. `at_the_wrist`: it moves with the arm, and the pattern lies still; otherwise the pattern
    moves with the arm.

    Raises ConfigError, one line, for too few pictures, for postures that turn the camera too little or about one axis
    only, and for arm and pictures that do not belong together.
    """
    if len(views) < FEWEST:
        raise ConfigError(f"{len(views)} pictures show the pattern; hand-eye calibration needs {FEWEST}, better 15")
    moved = [_inverse(view.arm) if at_the_wrist else view.arm for view in views]
    turn = _second_turn(moved)
    if turn < LEAST_TURN:
        raise ConfigError(
            f"the {len(views)} postures turn by {np.degrees(turn):.1f}° about a second axis, less than "
            f"{np.degrees(LEAST_TURN):g}°: take pictures that are tilted by some 30° about two axes"
        )
    seen = [_seen(view, lens) for view in views]
    problem = _problem(moved, seen, views)
    start = _closed_form(moved, [each.pose for each in seen])
    found, arm = _fitted(problem, start, at_the_wrist)
    each = [_rms(_errors(view, lens, B, found)) for view, B in zip(views, moved, strict=True)]
    residual, parts, held_out, left = float(np.sqrt(np.mean(np.square(each)))), [], [], []
    for k in range(len(views)):
        other = _solved(problem.part(np.arange(len(views)) != k), found, arm, at_the_wrist)[0]
        off = [_rms(_errors(view, lens, B, other)) for view, B in zip(views, moved, strict=True)]
        parts.append(other[0])
        held_out.append(off.pop(k))
        left.append(float(np.sqrt(np.mean(np.square(off)))))
    _check(views, residual, held_out, left)
    position, rotation = _jackknife(found[0], parts)
    named = tuple((view.name, error) for view, error in zip(views, each, strict=True))
    out = float(np.sqrt(np.mean(np.square(held_out))))
    return HandEyeCalibration(*found, position, rotation, arm.position, arm.rotation, residual, out, turn, named)


def _check(views: Sequence[PatternView], residual: float, held_out: Sequence[float], left: Sequence[float]) -> None:
    """Raise ConfigError where arm and pictures disagree: all of them, or one alone. `held_out`: of each picture by the
    others; `left`: of these others without it, pixels."""
    worst = int(np.argmax(held_out))
    others = float(np.median([out for k, out in enumerate(held_out) if k != worst]))
    alone = held_out[worst] > max(_OUTLIER * others, others + _SLIGHT) and left[worst] < _HALF * residual
    if alone and left[worst] < MOST:
        raise ConfigError(
            f"{views[worst].name}: its corners are {held_out[worst]:.1f} pixels from where the other pictures have "
            f"them, which agree within {left[worst]:.1f}: its pose of the arm is of another moment; take it anew or "
            "leave it out"
        )
    if not residual < MOST:
        raise ConfigError(
            f"arm and pictures disagree by {residual:.1f} pixels, more than {MOST:g}: are the poses those of the "
            "flange in the base, in m and as w x y z, one for each picture; are the squares as large as stated?"
        )


def _second_turn(moved: Sequence[Pose]) -> float:
    """Of all pairs of poses, the root mean square turn about the second of the three main axes, rad."""
    turns = np.array(
        [
            _vector(one.rotation @ other.rotation.T)
            for k, one in enumerate(moved)
            for other in moved[:k]
        ]
    )  # fmt: skip
    return float(np.linalg.svd(turns, compute_uv=False)[1] / np.sqrt(len(turns)))


def _closed_form(moved: Sequence[Pose], seen: Sequence[Pose]) -> tuple[Pose, Pose]:
    """X and Z by AX = XB, over all pairs: A = Bᵢ Bⱼ⁻¹ of the arm, B = Cᵢ Cⱼ⁻¹ of the pattern in the camera."""
    pairs = [(i, j) for i in range(len(moved)) for j in range(i)]
    arm = [compose(moved[i], _inverse(moved[j])) for i, j in pairs]
    eye = [compose(seen[i], _inverse(seen[j])) for i, j in pairs]
    a, b = (np.array([_vector(each.rotation) for each in poses]) for poses in (arm, eye))
    # B Z = X C, so that A X = X B and log A = R log B: the rotation nearest to all.
    u, _, vt = np.linalg.svd(a.T @ b)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    table = np.concatenate([each.rotation - np.eye(3) for each in arm])
    right = np.concatenate(
        [rotation @ e.position - m.position for e, m in zip(eye, arm, strict=True)]
    )  # fmt: skip
    camera = Pose(np.linalg.lstsq(table, right, rcond=None)[0], rotation)
    patterns = [relative_to(m, compose(camera, c)) for m, c in zip(moved, seen, strict=True)]
    u, _, vt = np.linalg.svd(np.sum([each.rotation for each in patterns], axis=0))
    mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return camera, Pose(np.mean([each.position for each in patterns], axis=0), mean)


class _Seen(NamedTuple):
    """The pattern in one picture alone."""

    pose: Pose
    information: Array
    """Of the pose by the corners, (6, 6), for an error of one pixel."""
    squares: float
    """Sum of the squared errors of the corners, pixels²."""


def _seen(view: PatternView, lens: Intrinsics) -> _Seen:
    """The pose where the corners are least off, by Gauss-Newton from the one that there is."""
    pose = view.pattern
    for _ in range(_STEPS):
        points = view.points @ pose.rotation.T + pose.position
        errors = (lens.pixel(points) - view.pixels).ravel()
        moves = np.concatenate([np.broadcast_to(pose.rotation, (len(points), 3, 3)),
                                -pose.rotation @ _skew(view.points)], axis=2)  # fmt: skip
        table = (_flattened(points, lens) @ moves).reshape(-1, 6)
        information = table.T @ table
        step = np.asarray(np.linalg.solve(information, -table.T @ errors), np.float64)
        pose = _moved(pose, step)
        if float(np.abs(step).max()) < _DONE:
            break
    return _Seen(pose, information, float(errors @ errors))


def _flattened(points: Array, lens: Intrinsics) -> Array:
    """How pixels change with points (k, 3) in the camera's frame, (k, 2, 3), pixels/m."""
    x, y, z = points.T
    flat = np.zeros((len(points), 2, 3))
    flat[:, 0, 0], flat[:, 0, 2] = lens.fx / z, -lens.fx * x / z**2
    flat[:, 1, 1], flat[:, 1, 2] = lens.fy / z, -lens.fy * y / z**2
    return flat


def _problem(moved: Sequence[Pose], seen: Sequence[_Seen], views: Sequence[PatternView]) -> _Problem:
    free = sum(2 * len(view.points) for view in views) - 6 * len(views)
    variance = max(sum(each.squares for each in seen) / free, _EXACT**2)
    return _Problem(
        np.array([each.rotation for each in moved]), np.array([each.position for each in moved]),
        np.array([each.pose.rotation for each in seen]), np.array([each.pose.position for each in seen]),
        variance * np.linalg.inv(np.array([each.information for each in seen])),
    )  # fmt: skip


def _fitted(problem: _Problem, start: tuple[Pose, Pose], at_the_wrist: bool) -> tuple[tuple[Pose, Pose], _ArmError]:
    """X and Z, with the errors of the arm that are likeliest."""
    best, found, arm = np.inf, start, _ArmError(0.0, 0.0)
    for position in _ARM_POSITIONS:
        for rotation in _ARM_ROTATIONS:
            tried = _ArmError(position, rotation)
            solved, cost = _solved(problem, found if np.isfinite(best) else start, tried, at_the_wrist)
            if cost < best:
                best, found, arm = cost, solved, tried
    return found, arm


def _solved(
    problem: _Problem, start: tuple[Pose, Pose], arm: _ArmError, at_the_wrist: bool
) -> tuple[tuple[Pose, Pose], float]:
    """X and Z by Gauss-Newton for given errors of the arm, and -2 log of the restricted likelihood."""
    camera, pattern = start
    for _ in range(_STEPS):
        # T = X⁻¹ B Z, and by what C is off it, in the axes of the pattern.
        on_position = problem.rotation @ pattern.position + problem.position
        rotation = camera.rotation.T @ problem.rotation @ pattern.rotation
        position = (on_position - camera.position) @ camera.rotation
        back = np.swapaxes(rotation, 1, 2)
        shift = np.einsum("nij,nj->ni", back, problem.seen_position - position)
        error = np.concatenate([shift, _vectors(back @ problem.seen_rotation)], axis=1)
        # In the flange's frame the pattern is at B Z or Z: an error of the arm, as the pattern is moved by it.
        if at_the_wrist:
            lever = _adjoint(problem.rotation @ pattern.rotation, on_position)
        else:
            lever = np.broadcast_to(_adjoint(pattern.rotation[None], pattern.position[None]), problem.covariance.shape)
        spread = np.repeat([arm.position**2, arm.rotation**2], 3)
        covariance = problem.covariance + (lever * spread) @ np.swapaxes(lever, 1, 2)
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        moves = np.concatenate([_adjoint(rotation, position), np.broadcast_to(-np.eye(6), lever.shape)], axis=2)
        table, right = (root @ moves).reshape(-1, 12), np.einsum("nij,nj->ni", root, error).ravel()
        normal = table.T @ table
        step = np.asarray(np.linalg.solve(normal, -table.T @ right), np.float64)
        camera, pattern = _moved(camera, step[:6]), _moved(pattern, step[6:])
        if float(np.abs(step).max()) < _DONE:
            break
    whole = -2.0 * float(np.log(np.diagonal(root, axis1=1, axis2=2)).sum())
    return (camera, pattern), float(right @ right) + whole + float(np.linalg.slogdet(normal)[1])


def _errors(view: PatternView, lens: Intrinsics, moved: Pose, found: tuple[Pose, Pose]) -> Array:
    """Corners as seen from where they are to be, (k, 2), pixels."""
    there = relative_to(found[0], compose(moved, found[1]))
    points = view.points @ there.rotation.T + there.position
    points[:, 2] = np.maximum(points[:, 2], _BEHIND)
    return np.asarray(lens.pixel(points) - view.pixels)


def _jackknife(whole: Pose, parts: Sequence[Pose]) -> tuple[float, float]:
    """Standard deviations of position, m, and orientation, rad: (n - 1)/n Σ (xᵢ - x̄)², summed over three axes."""
    n = len(parts)
    places = np.array([part.position for part in parts])
    turns = np.array([_vector(whole.rotation.T @ part.rotation) for part in parts])
    spread = [(n - 1) / n * float(((each - each.mean(axis=0)) ** 2).sum()) for each in (places, turns)]
    return float(np.sqrt(spread[0])), float(np.sqrt(spread[1]))


def _student(freedom: int) -> float:
    """Student's t at 97.5 %, within 1 % (its expansion in 1/ν): where an error is along one axis, 95 % are within."""
    return 1.96 + 2.37 / freedom + 2.82 / freedom**2


def _moved(pose: Pose, step: Vector) -> Pose:
    """A pose moved and turned in its own axes, by (6,), m and rad."""
    turned = matrix_from_quaternion(quaternion_from_vector(step[3:]))
    rotation = matrix_from_quaternion(quaternion_from_matrix(pose.rotation @ turned))
    return Pose(pose.position + pose.rotation @ step[:3], rotation)


def _inverse(pose: Pose) -> Pose:
    return relative_to(pose, Pose(np.zeros(3), np.eye(3)))


def _vector(rotation: Array) -> Vector:
    return _vectors(rotation)


def _vectors(rotation: Array) -> Array:
    """Rotation vectors of matrices (..., 3, 3), (..., 3), rad."""
    return vector_from_quaternion(quaternion_from_matrix(rotation))


def _adjoint(rotation: Array, position: Array) -> Array:
    """From a small motion, position and rotation vector, of a frame to that of another frame at poses (n, 3, 3),
    (n, 3) in it, (n, 6, 6)."""
    back = np.swapaxes(rotation, 1, 2)
    found = np.zeros((len(rotation), 6, 6))
    found[:, :3, :3] = found[:, 3:, 3:] = back
    found[:, :3, 3:] = -back @ _skew(position)
    return found


def _skew(v: Array) -> Array:
    """Matrices of cross products, (k, 3, 3)."""
    zero = np.zeros(len(v))
    rows = [[zero, -v[:, 2], v[:, 1]], [v[:, 2], zero, -v[:, 0]], [-v[:, 1], v[:, 0], zero]]
    return np.moveaxis(np.array(rows), -1, 0)


def _rms(errors: Array) -> float:
    """Root mean square distance of (k, 2), pixels."""
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))
