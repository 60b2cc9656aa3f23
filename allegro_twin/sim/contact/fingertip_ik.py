"""Fingertips brought to several targets at once, inside the limits and clear of each other: numerical IK by mink."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.maths import ARRAYS
from allegro_twin.kinematics.orientation import angle_between, entries_of_matrix, is_rotation
from allegro_twin.sim.contact.self_clearance import colliding_geoms
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector, frozen

# Costs of a metre, a radian of the tip and a radian of a joint. A finger's lever is about 0.05 m: a rotation that
# cannot be had then shifts the tip by 1e-3² · 1 rad / 0.05 m = 20 µm, and the pull toward the start by nothing.
_METRE, _TURN, _JOINT = 1.0, 1e-3, 1e-6
_DAMPING = 0.1  # Levenberg-Marquardt's, times the square of the distance still to go.
_LONGEST = 0.3  # rad. A step's largest change of a joint: further, the linearisation says nothing.
_SETTLED = 1e-6  # rad. A step shorter than this is the last.
_SIGHT = 0.05  # m. Distances are looked for so far.
_REACH = 0.03  # m. Pairs nearer than clearance plus this hold the step back.
_SPARE = 5e-5  # m. Aimed for above the clearance, so that the curvature of a step does not use the clearance up.


@dataclass(frozen=True, slots=True, eq=False)
class FingertipSolution:
    """The posture found, and how near it comes."""

    position: Vector
    """Joint positions in the spec's order, inside the limits less the margin, shape (n,), rad."""
    reached: bool
    """Every tip within the tolerance of its target, and every pair of links as far apart as asked for."""
    distance: Mapping[str, float]
    """From each tip to its target, m."""
    angle: Mapping[str, float]
    """Between the orientation of a tip and the one asked for, rad; only where one was."""
    closest: float
    """Least distance between two fingers, or a finger and the palm, m; 0.05 at most. Negative: that deep inside."""
    pair: tuple[str, str] | None
    """The two geoms of that distance, if they are nearer than 0.05 m."""


class FingertipSolver:
    """Inverse kinematics of the whole hand, a quadratic program a step
    (docs/explanation/kinematics.md#several-tips-at-once).

    Minimises Σ |tip - target|² over the fingers named, with a weak pull toward the start, inside the joint limits and
    with every finger clear of the others, of itself and of the palm. All in the palm frame.
    """

    def __init__(self, spec: HandSpec) -> None:
        try:
            import daqp  # noqa: F401  # The solver that mink is told to take; it would miss it only at the first step.
            import mink
        except ImportError as error:
            raise ConfigError("FingertipSolver needs mink: pip install 'allegro-twin[ik]'") from error
        self._mink: Any = mink
        self._spec = spec
        self._model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
        joints = [self._model.joint(name).id for name in spec.joints]
        self._qpos, self._dof = self._model.jnt_qposadr[joints], self._model.jnt_dofadr[joints]
        self.pairs = colliding_geoms(self._model)
        """The geoms that are kept apart, by id."""

    def solve(
        self,
        targets: Mapping[str, ArrayLike],
        start: ArrayLike,
        *,
        rotations: Mapping[str, ArrayLike] | None = None,
        margin: float = 0.0,
        clearance: float | None = 0.003,
        tolerance: float = 1e-4,
        steps: int = 200,
    ) -> FingertipSolution:
        """The posture near `start`, shape (n,), rad, that brings each finger's tip to its target, shape (3,), m.

        `rotations` are wanted too, shape (3, 3), as far as the position leaves them free. `margin`, rad, is taken off
        both ends of every range. `clearance`, m, is kept between fingers and to the palm: from a start that has it,
        every step does; a start that has not is never brought nearer. None lets them pass through each other. A search
        from one start: it can miss a posture that exists, and then says how far it came. Raises ConfigError for
        arguments that do not fit.
        """
        self._check(margin, clearance, tolerance, steps)
        lower, upper = self._spec.lower + margin, self._spec.upper - margin
        begin = np.clip(self._spec.vector(start, "start"), lower, upper)
        frames = self._tasks(targets, rotations or {})
        configuration = self._mink.Configuration(self._model)
        configuration.update(self._placed(begin))
        posture = self._mink.PostureTask(self._model, cost=_JOINT)
        posture.set_target(self._placed(begin))
        limits = [self._mink.ConfigurationLimit(self._model, min_distance_from_limits=margin)]
        if clearance is not None and self.pairs:
            limits.append(
                self._mink.CollisionAvoidanceLimit(
                    self._model,
                    [([a], [b]) for a, b in self.pairs],
                    minimum_distance_from_collisions=clearance + _SPARE,
                    collision_detection_distance=clearance + _REACH,
                )
            )
        self._descend(configuration, [*frames.values(), posture], limits, (lower, upper), clearance, steps)
        return self._report(configuration, frames, rotations or {}, clearance, tolerance)

    def _descend(
        self, configuration: Any, tasks: list[Any], limits: list[Any], ends: tuple[Vector, Vector],
        clearance: float | None, steps: int,
    ) -> None:  # fmt: skip
        """Moves the configuration step by step until it settles, is blocked, or the steps are used up."""
        low, high = (self._placed(end) for end in ends)
        for _ in range(steps):
            cost = self._cost(configuration, tasks)
            try:
                change = self._mink.solve_ik(configuration, tasks, 1.0, "daqp", limits=limits)
            except self._mink.NoSolutionFound:
                return  # The posture so far is inside all limits, and is reported with its distances.
            change = change * min(1.0, _LONGEST / max(float(np.abs(change).max()), 1e-12))
            best = before = configuration.q.copy()
            floor = -np.inf if clearance is None else min(clearance, self._closest(configuration.data)[0])
            # A whole step can overshoot where a target is out of reach, and its curvature can use up the clearance:
            # it is halved until that makes it no better.
            while np.abs(change).max() >= _SETTLED:
                # One hinge a degree of freedom: positions and speeds have the same indices.
                configuration.update(np.clip(before + change, low, high))
                now = self._cost(configuration, tasks)
                if now < cost and self._closest(configuration.data)[0] >= floor:
                    best, cost = configuration.q.copy(), now
                elif best is not before:
                    break
                change = change / 2
            configuration.update(best)
            if best is before:
                return

    def _cost(self, configuration: Any, tasks: list[Any]) -> float:
        """What a step makes less. Mink's error of a frame is the logarithm of its pose: its part of the position is the
        straight line to the target only if no rotation is left, so a free rotation is taken as met."""
        for task in tasks:
            if isinstance(task, self._mink.FrameTask) and not task.cost[3:].any():
                turn = configuration.get_transform_frame_to_world(task.frame_name, "site").rotation()
                point = task.transform_target_to_world.translation()
                task.set_target(self._mink.SE3.from_rotation_and_translation(turn, point))
        return sum(float(np.square(task.cost * task.compute_error(configuration)).sum()) for task in tasks)

    def _tasks(self, targets: Mapping[str, ArrayLike], rotations: Mapping[str, ArrayLike]) -> dict[str, Any]:
        if not targets:
            raise ConfigError("no targets: give at least one finger its point, shape (3,), m")
        if loose := [name for name in rotations if name not in targets]:
            raise ConfigError(f"rotation for {loose[0]}, which has no target position")
        tasks = {}
        for name, target in targets.items():
            point = _finite(target, (3,), f"target of {name}")
            turn = _rotation(rotations[name], name) if name in rotations else np.eye(3)
            task = self._mink.FrameTask(
                self._spec.finger(name).tip,
                "site",
                position_cost=_METRE,
                orientation_cost=_TURN if name in rotations else 0.0,
                lm_damping=_DAMPING,
            )
            lie = self._mink.SE3.from_rotation_and_translation(self._mink.SO3.from_matrix(turn), point)
            task.set_target(lie)
            tasks[name] = task
        return tasks

    def _report(
        self, configuration: Any, frames: Mapping[str, Any], rotations: Mapping[str, ArrayLike],
        clearance: float | None, tolerance: float,
    ) -> FingertipSolution:  # fmt: skip
        distance, angle = {}, {}
        for name, task in frames.items():
            site = configuration.data.site(task.frame_name)
            target = task.transform_target_to_world
            distance[name] = float(np.linalg.norm(site.xpos - target.translation()))
            if name in rotations:
                wanted = target.rotation().as_matrix()
                angle[name] = float(angle_between(site.xmat.reshape(3, 3), wanted))
        closest, pair = self._closest(configuration.data)
        clear = clearance is None or closest >= clearance
        near = all(d <= tolerance for d in distance.values())
        position = frozen(configuration.q[self._qpos].copy())
        return FingertipSolution(position, near and clear, distance, angle, closest, pair)

    def _closest(self, data: mujoco.MjData) -> tuple[float, tuple[str, str] | None]:
        model, least, found = self._model, _SIGHT, None
        first, second = np.array(self.pairs, dtype=int).reshape(-1, 2).T
        gap = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1)
        gap -= model.geom_rbound[first] + model.geom_rbound[second]
        for k in np.argsort(gap):
            if gap[k] >= least:
                break  # Their bounding spheres are further apart than the nearest pair.
            a, b = self.pairs[k]
            apart = mujoco.mj_geomDistance(model, data, a, b, least, None)
            if apart < least:
                least, found = float(apart), (model.geom(a).name, model.geom(b).name)
        return least, found

    def _placed(self, position: Vector) -> Vector:
        """Our order in MuJoCo's."""
        qpos = np.zeros(self._model.nq)
        qpos[self._qpos] = position
        return qpos

    def _check(self, margin: float, clearance: float | None, tolerance: float, steps: int) -> None:
        half = float((self._spec.upper - self._spec.lower).min()) / 2
        if not 0.0 <= margin < half:
            raise ConfigError(f"margin {margin} rad does not fit; half the least range is {half:.3f} rad")
        if clearance is not None and not 0.0 <= clearance <= _SIGHT - _REACH:
            raise ConfigError(f"clearance {clearance} m is not between 0 and {_SIGHT - _REACH:g} m; None turns it off")
        if not tolerance > 0.0 or steps < 1:
            raise ConfigError(f"tolerance {tolerance} m and steps {steps} must be above zero")


def _finite(values: ArrayLike, shape: tuple[int, ...], what: str) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigError(f"{what} needs finite numbers of shape {shape}; it is {array.tolist()}")
    return array


def _rotation(values: ArrayLike, name: str) -> Array:
    matrix = _finite(values, (3, 3), f"rotation of {name}")
    if not is_rotation(ARRAYS, entries_of_matrix(matrix)):
        raise ConfigError(f"rotation of {name} is not a rotation matrix: {matrix.tolist()}")
    return matrix
