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

The stated error is a jackknife: the whole is solved again without each picture. What is wrong with all pictures alike,
a square, a focal length or a principal point, would be taken for an error of the arm. So each of them is tried as one
more unknown: where the pictures are much likelier with it, it is told, and how far it moves the camera is in the stated
error. A principal point that is off is nearly a turn of the camera, by 1/f a pixel, which the pictures hardly show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

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
from allegro_twin.types import Array, Vector, frozen

FEWEST = 6
"""Pictures. With fewer, leaving one out says little about the error."""
LEAST_TURN = np.radians(8.0)
"""Least rotation of the pictures against each other about the second of their axes, root mean square, rad: with less
the position along the first axis is hardly determined. OWN: at 8° the error is some three times that of a set that
turns by 30°."""
MOST = 3.0
"""Pixels, root mean square. Beyond it arm and pictures do not belong together."""
_OUTLIER, _SLIGHT = 5.0, 1.0  # Times the median of the other pictures, and pixels: one that disagrees alone,
_HALF = 0.6  # and without which the others agree so much better; a picture that merely weighs much does not pass this.
_STEPS, _DONE = 30, 1e-10
_EXACT = 1e-6  # Pixels. Corners are never taken for more exact than this.
_BEHIND = 1e-3  # m. A corner that would be nearer, or behind the camera, is far off.
_UNITS = {1e3: "mm", 1e2: "cm"}  # How many are a metre.
_ALIKE = 1.2  # Factor within which poses are taken to be in such a unit.
_TRIED = 2.0  # Standard deviations of a factor, of an arm to whose errors its own are counted: worth a try.
_SIGNIFICANT = 5.0  # Standard deviations by the likelihood with and without the value.
_RIVAL = 10.0  # Of -2 log likelihood: a factor that is less worse than the best by it may be the one as well.
_SECOND = 3.7  # Of -2 log likelihood, that a second parameter has to be worth: as rare by chance as the first's 25.
_FACTOR_STEPS, _FACTOR_DONE, _FACTOR_MOST = 8, 1e-4, 0.69
_SLOPE = 1e-4  # Of a value, for a difference quotient.
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


Stated: TypeAlias = Literal["square", "focal", "principal"]
"""What is stated and not measured by the pictures: the edge of the squares, the focal length, the principal point."""


class Contradiction(NamedTuple):
    """A stated value that the pictures contradict."""

    stated: Stated
    change: Vector
    """What the pictures fit: the factor on the stated length, (1,), or how far the principal point is from the stated
    one, (2,), columns and rows, pixels."""
    deviation: float
    """Standard deviation of the change, as a part of it."""
    camera: Pose
    """Where the camera is by that value."""


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeCalibration:
    """Pose of the camera, and its uncertainty."""

    camera: Pose
    """In the frame of the arm that moves with it, or in the arm's base where it stands still."""
    pattern: Pose
    """In the arm's base, or in the frame of the arm that moves with it."""
    position_deviation: float
    """Standard deviation of the camera's position, m: root of the sum over three axes."""
    rotation_deviation: float
    """Standard deviation of the camera's orientation, rad: root of the sum over three axes."""
    arm_position: float
    """How far the arm's poses are off by the pictures, standard deviation along each axis, m."""
    arm_rotation: float
    """Standard deviation of the arm's orientations by the pictures, about each axis, rad."""
    residual: float
    """Between corners as they were seen and as they are to be, root mean square, pixels."""
    held_out: float
    """Reprojection error of each picture by a calibration from the others alone, root mean square, pixels."""
    turn: float
    """Rotation of the pictures against each other about the second of their axes, root mean square, rad."""
    views: tuple[tuple[str, float], ...]
    """Each picture, and its root mean square, pixels."""
    contradicted: tuple[Contradiction, ...] = ()
    """Stated values of which one is wrong, the likelier first; usually none."""

    @property
    def position_error(self) -> float:
        """The camera is nearer than this to where it is said to be, m, at 95 %."""
        return self._bound(self.position_deviation, lambda there: there.position - self.camera.position)

    @property
    def rotation_error(self) -> float:
        """Bound of the error of the camera's orientation, rad, at 95 %."""
        return self._bound(self.rotation_deviation, lambda there: _vector(self.camera.rotation.T @ there.rotation))

    def _bound(self, deviation: float, apart: Callable[[Pose], Vector]) -> float:
        """Bound by the scatter, and by the farthest camera of another stated value, which is as uncertain as that."""
        times = _student(len(self.views) - 2)
        moved = [
            float(np.linalg.norm(apart(each.camera))) * (1.0 + times * each.deviation) for each in self.contradicted
        ]
        return float(np.hypot(times * deviation, max(moved, default=0.0)))


class _Problem(NamedTuple):
    """All pictures, as arrays over them."""

    rotation: Array
    """Rotations B, (n, 3, 3)."""
    position: Array
    """Positions of B, (n, 3), m."""
    seen_rotation: Array
    """Rotations C, (n, 3, 3)."""
    seen_position: Array
    """Positions of C, (n, 3), m."""
    covariance: Array
    """Covariance of C by the corners, (n, 6, 6): position, m, and rotation vector, rad, in the axes of the pattern."""

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

    Raises ConfigError, one line, for too few pictures, for one that is there twice, for postures that turn the camera
    too little or about one axis only, and for arm and pictures that do not belong together.
    """
    if len(views) < FEWEST:
        raise ConfigError(f"{len(views)} pictures show the pattern; hand-eye calibration needs {FEWEST}, better 15")
    _check_different(views)
    moved = [_inverse(view.arm) if at_the_wrist else view.arm for view in views]
    turn = _second_turn(moved)
    if turn < LEAST_TURN:
        raise ConfigError(
            f"the {len(views)} postures turn by {np.degrees(turn):.1f}° about a second axis, less than "
            f"{np.degrees(LEAST_TURN):g}°: take pictures that are tilted by some 30° about two axes"
        )
    seen = [_seen(view, lens) for view in views]
    _check_unit(moved, [each.pose for each in seen])
    problem = _problem(moved, seen, views)
    start = _closed_form(moved, [each.pose for each in seen])
    try:
        fit = _fitted(problem, start, at_the_wrist)
    except np.linalg.LinAlgError as error:
        raise ConfigError(f"arm and pictures do not belong together: {_ASK}") from error
    found, arm, _ = fit
    each = [_rms(_errors(view, lens, B, found)) for view, B in zip(views, moved, strict=True)]
    residual, parts, held_out, left = float(np.sqrt(np.mean(np.square(each)))), [], [], []
    for k in range(len(views)):
        other = _solved(problem.part(np.arange(len(views)) != k), found, arm, at_the_wrist)[0]
        off = [_rms(_errors(view, lens, B, other)) for view, B in zip(views, moved, strict=True)]
        parts.append(other[0])
        held_out.append(off.pop(k))
        left.append(float(np.sqrt(np.mean(np.square(off)))))
    wrong = _contradicted(views, lens, moved, seen, fit, at_the_wrist)
    _check(views, residual, held_out, left, wrong)
    position, rotation = _jackknife(found[0], parts)
    named = tuple((view.name, error) for view, error in zip(views, each, strict=True))
    out = float(np.sqrt(np.mean(np.square(held_out))))
    return HandEyeCalibration(*found, position, rotation, arm.position, arm.rotation, residual, out, turn, named, wrong)


_ASK = (
    "are the poses those of the flange in the base, in m and as w x y z, one for each picture; are the squares as "
    "large as stated?"
)


def _check_different(views: Sequence[PatternView]) -> None:
    """Raise ConfigError for a picture that is there twice, under its name or another: no two pictures of a camera have
    the same corners to the last bit, and a copy says nothing new of the error."""
    names = dict[bytes, str]()
    for view in views:
        corners = np.ascontiguousarray(view.pixels).tobytes()
        if corners in names:
            same = "is listed twice" if names[corners] == view.name else f"is the same picture as {names[corners]}"
            raise ConfigError(f"{view.name} {same}: a picture counts once; leave one out")
        names[corners] = view.name


def _check_unit(moved: Sequence[Pose], seen: Sequence[Pose]) -> None:
    """Raise ConfigError for poses of an arm that are not in m, as the pattern is. By AX = XB with the unit as one more
    unknown."""
    arm, eye = _pairs(moved), _pairs(seen)
    rotation = _turn_between(arm, eye)
    table = np.concatenate([np.column_stack([a.rotation - np.eye(3), a.position]) for a in arm])
    right = np.concatenate([rotation @ b.position for b in eye])
    metres = float(np.linalg.lstsq(table, right, rcond=None)[0][3])
    for count, unit in _UNITS.items():
        if count / _ALIKE < 1.0 / max(abs(metres), 1e-9) < count * _ALIKE:
            raise ConfigError(
                f"the arm's positions are {count:.0f} times as far apart as the pictures: they are in "
                f"{unit}; state them in m"
            )
        if count / _ALIKE < abs(metres) < count * _ALIKE:
            raise ConfigError(
                f"the pattern is {count:.0f} times as large as the pictures: its `square` is in {unit}; state it in m"
            )


def _check(
    views: Sequence[PatternView], residual: float, held_out: Sequence[float], left: Sequence[float],
    wrong: Sequence[Contradiction],
) -> None:  # fmt: skip
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
            f"arm and pictures disagree by {residual:.1f} pixels, more than {MOST:g}: {_ASK}"
            + "".join(f" They fit {_fitting(each)} the stated one." for each in wrong)
        )


def _fitting(wrong: Contradiction) -> str:
    if wrong.stated == "principal":
        return "a principal point {:.1f} columns and {:.1f} rows from".format(*wrong.change)
    return f"a {'square' if wrong.stated == 'square' else 'focal length'} {wrong.change[0]:.3g} times"


def _second_turn(moved: Sequence[Pose]) -> float:
    """Root mean square rotation of all pairs of poses about the second of the three main axes, rad."""
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
    arm, eye = _pairs(moved), _pairs(seen)
    rotation = _turn_between(arm, eye)
    table = np.concatenate([each.rotation - np.eye(3) for each in arm])
    right = np.concatenate(
        [rotation @ e.position - m.position for e, m in zip(eye, arm, strict=True)]
    )  # fmt: skip
    camera = Pose(np.linalg.lstsq(table, right, rcond=None)[0], rotation)
    patterns = [relative_to(m, compose(camera, c)) for m, c in zip(moved, seen, strict=True)]
    u, _, vt = np.linalg.svd(np.sum([each.rotation for each in patterns], axis=0))
    mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return camera, Pose(np.mean([each.position for each in patterns], axis=0), mean)


def _pairs(poses: Sequence[Pose]) -> list[Pose]:
    """Each pose after the inverse of each before it."""
    return [compose(poses[i], _inverse(poses[j])) for i in range(len(poses)) for j in range(i)]


def _turn_between(arm: Sequence[Pose], eye: Sequence[Pose]) -> Array:
    """Rotation of X. B Z = X C, so that A X = X B and log A = R log B: the rotation nearest to all."""
    a, b = (np.array([_vector(each.rotation) for each in poses]) for poses in (arm, eye))
    u, _, vt = np.linalg.svd(a.T @ b)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


class _Seen(NamedTuple):
    """The pattern in one picture alone."""

    pose: Pose
    information: Array
    """Information matrix of the pose by the corners, (6, 6), for an error of one pixel."""
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


def _freedom(views: Sequence[PatternView]) -> int:
    return sum(2 * len(view.points) for view in views) - 6 * len(views)


def _variance(seen: Sequence[_Seen], views: Sequence[PatternView]) -> float:
    """Variance of a corner along each axis, pixels², by each picture alone."""
    return max(sum(each.squares for each in seen) / _freedom(views), _EXACT**2)


def _problem(moved: Sequence[Pose], seen: Sequence[_Seen], views: Sequence[PatternView]) -> _Problem:
    variance = _variance(seen, views)
    return _Problem(
        np.array([each.rotation for each in moved]), np.array([each.position for each in moved]),
        np.array([each.pose.rotation for each in seen]), np.array([each.pose.position for each in seen]),
        variance * np.linalg.inv(np.array([each.information for each in seen])),
    )  # fmt: skip


class _Fit(NamedTuple):
    """X and Z, with the errors of the arm that are likeliest."""

    found: tuple[Pose, Pose]
    arm: _ArmError
    cost: float
    """-2 log of the restricted likelihood of the poses C."""


def _fitted(problem: _Problem, start: tuple[Pose, Pose], at_the_wrist: bool) -> _Fit:
    best, found, arm = np.inf, start, _ArmError(0.0, 0.0)
    for position in _ARM_POSITIONS:
        for rotation in _ARM_ROTATIONS:
            tried = _ArmError(position, rotation)
            solved, cost = _solved(problem, found if np.isfinite(best) else start, tried, at_the_wrist)
            if cost < best:
                best, found, arm = cost, solved, tried
    return _Fit(found, arm, best)


_PARAMETERS: dict[Stated, int] = {"square": 1, "focal": 1, "principal": 2}


def _contradicted(
    views: Sequence[PatternView], lens: Intrinsics, moved: Sequence[Pose], seen: Sequence[_Seen], fit: _Fit,
    at_the_wrist: bool,
) -> tuple[Contradiction, ...]:  # fmt: skip
    """The stated values with which, set free, the pictures are much likelier, the likeliest first."""
    right = fit.cost + _freedom(views) * float(np.log(_variance(seen, views)))
    found: list[tuple[float, Contradiction]] = []
    for stated, count in _PARAMETERS.items():
        try:
            cost, wrong = _freed(views, lens, moved, stated, fit, right, at_the_wrist)
        except np.linalg.LinAlgError:
            continue  # Nothing fits, with whatever value.
        cost += _SECOND * (count - 1)
        if cost < right - _SIGNIFICANT**2:
            found.append((cost, wrong))
    found.sort(key=lambda each: each[0])
    return tuple(wrong for cost, wrong in found if cost < found[0][0] + _RIVAL)


def _freed(
    views: Sequence[PatternView], lens: Intrinsics, moved: Sequence[Pose], stated: Stated, fit: _Fit, right: float,
    at_the_wrist: bool,
) -> tuple[float, Contradiction]:  # fmt: skip
    """A stated value as one more unknown, or two, and -2 log likelihood then; `right`: as it is stated."""
    values, cost = np.zeros(_PARAMETERS[stated]), right
    for _ in range(_FACTOR_STEPS):
        step, information = _value_step(views, lens, moved, stated, values, fit, at_the_wrist)
        if float(np.abs(step).max()) < _FACTOR_DONE or (
            not values.any() and float(step @ information @ step) < _TRIED**2
        ):
            break
        values = values + step
        if not float(np.abs(values).max()) < _FACTOR_MOST:
            return right, Contradiction(stated, np.zeros(0), np.inf, fit.found[0])
        changed, through = _changed(views, lens, stated, values)
        seen = [_seen(view, through) for view in changed]
        fit = _fitted(_problem(moved, seen, changed), _closed_form(moved, [each.pose for each in seen]), at_the_wrist)
        cost = fit.cost + _freedom(views) * float(np.log(_variance(seen, changed)))
    change = lens.fx * values if stated == "principal" else np.exp(values)
    part = float(values @ information @ values) ** -0.5 if values.any() else np.inf
    return cost, Contradiction(stated, frozen(change), part, fit.found[0])


def _value_step(
    views: Sequence[PatternView], lens: Intrinsics, moved: Sequence[Pose], stated: Stated, values: Vector, fit: _Fit,
    at_the_wrist: bool,
) -> tuple[Vector, Array]:  # fmt: skip
    """By how much the values of `_changed` are to change, (k,), by one Gauss-Newton step of X, Z and them, and the
    information on them, (k, k)."""

    def poses(values: Vector) -> tuple[Sequence[PatternView], list[_Seen]]:
        changed, through = _changed(views, lens, stated, values)
        return changed, [_seen(view, through) for view in changed]

    changed, one = poses(values)
    slopes = [
        [
            np.concatenate([
                a.pose.rotation.T @ (b.pose.position - a.pose.position), _vector(a.pose.rotation.T @ b.pose.rotation),
            ]) / _SLOPE
            for a, b in zip(one, poses(values + _SLOPE * unit)[1], strict=True)
        ]
        for unit in np.eye(len(values))
    ]  # fmt: skip
    root, moves, error = _linearised(_problem(moved, one, changed), *fit.found, fit.arm, at_the_wrist)
    table = (root @ np.concatenate([moves, np.moveaxis(np.array(slopes), 0, 2)], axis=2)).reshape(-1, 12 + len(values))
    inverse = np.linalg.inv(table.T @ table)
    step = -inverse @ table.T @ np.einsum("nij,nj->ni", root, error).ravel()
    return step[12:], np.linalg.inv(inverse[12:, 12:])


def _changed(
    views: Sequence[PatternView], lens: Intrinsics, stated: Stated, values: Vector
) -> tuple[Sequence[PatternView], Intrinsics]:
    """The views and the lens, with another stated value: the logarithm of the factor on a length, or by what angles,
    rad, the principal point is elsewhere, along columns and rows."""
    if stated == "principal":
        column, row = values
        return views, lens._replace(cx=lens.cx + lens.fx * column, cy=lens.cy + lens.fx * row)
    factor = float(np.exp(values[0]))
    if stated == "focal":
        return views, lens._replace(fx=factor * lens.fx, fy=factor * lens.fy)
    larger = [
        view._replace(points=factor * view.points, pattern=Pose(factor * view.pattern.position, view.pattern.rotation))
        for view in views
    ]
    return larger, lens


def _linearised(
    problem: _Problem, camera: Pose, pattern: Pose, arm: _ArmError, at_the_wrist: bool
) -> tuple[Array, Array, Array]:
    """How far the poses C are off T = X⁻¹ B Z, (n, 6), in the axes of the pattern, after its derivative by motions of X
    and Z in their own axes, (n, 6, 12), and the root of the inverse covariance, (n, 6, 6)."""
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
    return root, moves, error


def _solved(
    problem: _Problem, start: tuple[Pose, Pose], arm: _ArmError, at_the_wrist: bool
) -> tuple[tuple[Pose, Pose], float]:
    """X and Z by Gauss-Newton for given errors of the arm, and -2 log of the restricted likelihood."""
    camera, pattern = start
    for _ in range(_STEPS):
        root, moves, error = _linearised(problem, camera, pattern, arm, at_the_wrist)
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
