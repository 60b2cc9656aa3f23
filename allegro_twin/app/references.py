"""References for the fingers made from a task: postures, trajectories, grasps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from allegro_twin.app.config import RunConfig
from allegro_twin.app.controller_settings import FollowSettings, PositionSettings
from allegro_twin.files.schema import PerJoint
from allegro_twin.plugins import ControllerContext
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector, frozen

if TYPE_CHECKING:
    from allegro_twin.control.trajectory import Reference
    from allegro_twin.grasping.controller import TimedGrasp
    from allegro_twin.hands.library.grasps import Grasp

SQUEEZE, STAY = 0.5, 1.0
"""s that a grasp in the open squeezes for, and that a hand is watched at the end of its motion."""


@dataclass(frozen=True, slots=True, eq=False)
class Wanted:
    """Goal of a position controller."""

    reference: Reference
    seconds: float | None = None
    """How long it takes; None: as long as the scenario says."""
    grasp: Grasp | None = None
    close_at: float = 0.0
    """When the fingers of a grasp begin to close, s."""
    squeeze_at: float = 0.0
    """When they squeeze, s."""

    def timed(self) -> TimedGrasp:
        """The motion of its grasp."""
        from allegro_twin.control.trajectory import Moves
        from allegro_twin.grasping.controller import TimedGrasp

        assert isinstance(self.reference, Moves)
        return TimedGrasp(self.reference, self.close_at, self.squeeze_at)


def wanted_of(settings: PositionSettings | FollowSettings, context: ControllerContext) -> Wanted:
    """The scenario's grasp, a grasp in the open, or a posture. Raises ConfigError."""
    from allegro_twin.control.trajectory import Moves, Waypoint
    from allegro_twin.hands.library.library import load_grasp
    from allegro_twin.sim.contact.collision_free_paths import CollisionFreeMove

    spec, task, trial = context.spec, context.task, context.trial
    if trial is not None:
        begins = (trial.begin_of("close"), trial.begin_of("squeeze")) if trial.grasp.grip is not None else (0.0, 0.0)
        return Wanted(trial.reference, None, trial.grasp, *begins)
    if task.grasp is not None:
        return _in_the_open(load_grasp(task.grasp, spec), spec)
    seconds = _longest(spec, settings.speed) + STAY
    posture = _first(spec) if task.posture is None else posture_of(task.posture, spec)
    goal = Waypoint(posture, speed=settings.speed, profile=settings.profile)
    if task.posture is None or context.replayed:  # Nobody asked for a posture, or nothing moves.
        return Wanted(Moves([goal]), seconds)
    name = task.posture if isinstance(task.posture, str) else "the posture"
    return Wanted(CollisionFreeMove(spec, goal, name), seconds)


def goal_of(config: RunConfig, spec: HandSpec) -> Vector | None:
    """Where a position controller is to bring the joints, (n,), rad; None where the task is another. Raises
    ConfigError."""
    task, other = config.task, not isinstance(config.controller, PositionSettings | FollowSettings)
    if other or task.scenario is not None or task.grasp is not None:
        return None
    return _first(spec) if task.posture is None else posture_of(task.posture, spec)


def posture_of(value: str | PerJoint, spec: HandSpec) -> Vector:
    """A posture by name or by value, (n,), rad. Raises ConfigError."""
    from allegro_twin.hands.library.library import load_posture

    return load_posture(value, spec) if isinstance(value, str) else spec.posture(value)


def _first(spec: HandSpec) -> Vector:
    """Home, for a hand that has one in the library; else the middle of every joint's range."""
    from allegro_twin.hands.library.library import home_posture

    home = home_posture(spec)
    return frozen((spec.lower + spec.upper) / 2) if home is None else home


def _in_the_open(grasp: Grasp, spec: HandSpec) -> Wanted:
    """To the pre-shape, in a time that suffices from anywhere; closed at the grasp's own speed; squeezed."""
    from allegro_twin.control.trajectory import Moves, travel_time

    approach, close = grasp.waypoint("preshape", _longest(spec, grasp.speed)), grasp.waypoint("close")
    close_at = _longest(spec, grasp.speed)
    squeeze_at = close_at + travel_time(grasp.preshape, close)
    moves = Moves([approach, close, grasp.waypoint("squeeze", SQUEEZE)])
    return Wanted(moves, squeeze_at + SQUEEZE + STAY, grasp, close_at, squeeze_at)


def _longest(spec: HandSpec, speed: float) -> float:
    """s for the widest travel of any joint, whichever the profile: its peak is at most twice its mean."""
    return float((spec.upper - spec.lower).max()) / speed * 2.0
