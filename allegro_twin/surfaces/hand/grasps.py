"""A named grasp on a hand that is already open: its timing, its width, and its outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from allegro_twin.control.controllers import PositionControl
from allegro_twin.control.trajectory import Moves, Waypoint, travel_time
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.controller import ContactSource, TimedGrasp, make_grasp_controller
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.kinematics.hand import HandKinematics
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.hand.motion import Goal, MotionControl, MotionRequest
from allegro_twin.types import HandState, Vector

SQUEEZE = 0.5  # s.
_TIP_RADIUS = 0.012  # m. The fingertip's sphere, models/allegro.yaml.
_TELLS = 0.004  # m. Encoders and pads that give do not tell narrower objects from none.
_TOUCH = 0.05  # rad short of where the fingers were sent: something is in the way.


@dataclass(frozen=True, slots=True)
class GraspOutcome:
    """Outcome of a grasp, from positions and torques alone."""

    name: str
    touching: tuple[str, ...]
    """Fingers that were stopped on their way: by an object, or by each other (`met`)."""
    force: dict[str, float]
    """What each of their tips presses with, estimated from the joint torques, N."""
    width: float
    """Between the thumb's pad and the other touching pads, m; NaN unless the thumb and another touch."""
    met: tuple[str, ...] = ()
    """Fingers that touch each other where they are, by the model of the hand."""
    empty: bool = False
    """Whether nothing as wide as the object was said to be is there: no finger was stopped, or the pads are not half
    as far from each other. False where no width was said."""

    def describe(self) -> str:
        """One sentence, without the forces."""
        width = "" if np.isnan(self.width) else f", pads {self.width * 1000:.0f} mm apart"
        text = f"in the way of: {', '.join(self.touching) or 'nothing'}{width}"
        if self.met:
            text += f"; {', '.join(self.met[:-1])} and {self.met[-1]} touch each other"
        return text + ("; nothing as wide as the object is there" if self.empty else "")


def chosen(name: str, width: float | None, model: HandKinematics, spec: HandSpec) -> Grasp:
    """A grasp of the library, for an object's width, m. Raises ConfigError."""
    stored = load_grasp(name, spec)
    return stored if width is None else for_width(stored, width, model, spec)


def begin(
    grasp: Grasp,
    mover: MotionControl,
    spec: HandSpec,
    limits: tuple[Vector, Vector],
    force: float | None,
    request: MotionRequest,
    touched: ContactSource | None = None,
) -> None:
    """Hand over to the grasp, by a way inside joint limits on which no finger meets another before it closes. Raises
    ConfigError before anything moves."""
    goal, what = grasp.waypoint("preshape"), f"grasp {grasp.name}"
    closing = Moves([grasp.waypoint("close"), grasp.waypoint("squeeze", SQUEEZE)])
    mover.check_speed(closing.begin(grasp.preshape).peak, what)
    approach = mover.planned(lambda start: mover.paths.legs(start, goal, limits, what), request)
    state = mover.state
    motion = timed(grasp, state.position, approach)
    controller: Controller[Any]
    if "torque" in spec.commands:
        controller = make_grasp_controller(
            grasp, motion, spec, mover.gains, mover.gravity, mover.model, force=force, touched=touched
        )
    elif grasp.grip is not None or force is not None or touched is not None:
        raise ConfigError(
            f"{what}: a force is for hands that take torques; {spec.name} takes {', '.join(spec.commands)}"
        )
    else:
        controller = PositionControl(motion.moves)
    path = motion.moves.begin(state.position)
    mover.drive(what, controller, Goal(path, mover.soon, path.seconds, what, motion.close_at), request)


def timed(grasp: Grasp, start: Vector, approach: Sequence[Waypoint]) -> TimedGrasp:
    """The grasp's motion from a posture: to its pre-shape, closed at its own speed, then the squeeze."""
    close = grasp.waypoint("close")
    to_preshape = Moves(approach).begin(start).seconds
    to_close = to_preshape + travel_time(grasp.preshape, close)
    return TimedGrasp(Moves([*approach, close, grasp.waypoint("squeeze", SQUEEZE)]), to_preshape, to_close)


def for_width(grasp: Grasp, width: float, model: HandKinematics, spec: HandSpec) -> Grasp:
    """The grasp with its fingers closed to an object's width (m), and its squeeze moved along.

    Between pre-shape and squeeze the posture is taken whose thumb pad is `width` away from the others. Raises
    ConfigError with the widths that this grasp spans when it is not among them.
    """
    parts = np.linspace(0.0, 1.0, 101)
    postures = grasp.preshape + parts[:, None] * (grasp.squeeze - grasp.preshape)
    widths = np.array([aperture(model, posture, spec) for posture in postures])
    if not widths.min() <= width <= widths.max():
        raise ConfigError(
            f"grasp {grasp.name} spans {widths.min() * 1000:.0f} to {widths.max() * 1000:.0f} mm; "
            f"an object of {width * 1000:.0f} mm needs another grasp"
        )
    part = parts[int(np.argmin(np.abs(widths - width)))]
    close = grasp.preshape + part * (grasp.squeeze - grasp.preshape)
    squeeze = spec.posture(np.clip(close + grasp.squeeze - grasp.close, spec.lower, spec.upper))
    return replace(grasp, close=spec.posture(close), squeeze=squeeze)


def aperture(model: HandKinematics, position: Vector, spec: HandSpec, fingers: tuple[str, ...] = ()) -> float:
    """Between the thumb's pad and the middle of the other fingers' pads, m."""
    tips = model.fingertips(position)
    thumb = spec.fingers[-1].name
    others = [tips[name].position for name in (fingers or tuple(tips)) if name != thumb]
    return float(np.linalg.norm(tips[thumb].position - np.mean(others, axis=0)) - 2 * _TIP_RADIUS)


def grasp_outcome(
    grasp: Grasp, state: HandState, model: HandKinematics, spec: HandSpec, weight: Vector,
    sized: bool = False, met: Sequence[tuple[str, str]] = (),
) -> GraspOutcome:  # fmt: skip
    """What is known at the end of a grasp. `weight`: torques that carry the hand itself, (n,), N·m; `sized`: whether a
    width was said, to which it closes; `met`: parts of the hand that touch each other."""
    short = np.abs(grasp.squeeze - state.position)
    touching = tuple(f.name for f in spec.fingers if short[list(f.joints)].max() > _TOUCH)
    _, jacobians = model.fingertip_jacobians(state.position, [f.name for f in spec.fingers])
    force: dict[str, float] = {}
    for finger, jacobian in zip(spec.fingers, jacobians, strict=True):
        if finger.name in touching:
            mine = list(finger.joints)
            solved: Any = np.linalg.lstsq(jacobian[:, mine].T, (state.torque - weight)[mine], rcond=None)
            force[finger.name] = float(np.linalg.norm(solved[0]))
    thumb = spec.fingers[-1].name
    opposed = tuple(name for name in touching if name != thumb)
    between = aperture(model, state.position, spec, opposed) if opposed else np.nan
    width = between if thumb in touching else float("nan")
    told = aperture(model, grasp.close, spec, opposed)  # Between the same pads, on the object.
    empty = sized and (not touching or bool(between < told - max(_TELLS, told / 2.0)))
    fingers = [finger.name for finger in spec.fingers]
    pairs = [pair for pair in met if pair[0] != pair[1] and set(pair) <= set(fingers)]  # Not with the palm.
    together = tuple(name for name in fingers if any(name in pair for pair in pairs))
    return GraspOutcome(grasp.name, touching, force, width, together, empty)
