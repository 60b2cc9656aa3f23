"""What a search begins with: the pre-shapes of the library, and which way their fingers close."""

from __future__ import annotations

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.plan.candidate import check_stiffness
from allegro_twin.grasping.plan.poses import closing_directions
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import Library
from allegro_twin.hands.library.taxonomy import claim_type
from allegro_twin.kinematics.hand import HandKinematics, hand_kinematics
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector

FEWEST = 3
"""Joints that a template closes; all, of a hand with fewer."""
GATHERS = 0.05
"""The share by which fingertips come nearer to each other where a motor is said to close them."""
OPEN, CLOSED, FURTHER = 0.3, 0.6, 0.8
"""Of a motor's way, in the postures of a template that no library has."""


def grasp_templates(spec: HandSpec, taxonomy: int | str | None = None) -> list[Grasp]:
    """All of the library that close on something, or those of a type of the taxonomy where there are any: only the
    contacts tell of which type is what comes of them. For a hand of which the library has none at all, one that its
    kinematics make. Raises ConfigError for what is no type, for a hand that cannot plan, and where nothing closes."""
    check_stiffness(spec)
    library = Library()
    listed = library.list(kind="grasp", taxonomy=taxonomy, hand=spec)
    if taxonomy is not None:
        of_type = [library.grasp(each.name, spec) for each in listed]
        return [grasp for grasp in of_type if _closes(grasp, spec)] or grasp_templates(spec)
    found = [library.grasp(each.name, spec) for each in listed]
    closing = [grasp for grasp in found if _closes(grasp, spec)]
    if not closing and not found:
        return [gathering_grasp(spec)]
    if not closing:
        raise ConfigError(f"the library has no grasp that closes the fingers of {spec.name}")
    return closing


def _closes(grasp: Grasp, spec: HandSpec) -> bool:
    """Whether it closes joints by position, and enough of them."""
    return grasp.grip is None and int((closing_directions(grasp, spec) != 0.0).sum()) >= min(FEWEST, spec.n_joints)


def gathering_grasp(spec: HandSpec) -> Grasp:
    """A grasp that closes every motor which brings fingertips together, from what the hand's kinematics say. Raises
    ConfigError for a hand without two fingertips, or of which none does."""
    if len(spec.fingers) < 2:
        raise ConfigError(f"{spec.name} has fewer than two fingertips: name them in its card")
    lower, upper, model = spec.lower, spec.upper, hand_kinematics(spec)
    middle, spans = (lower + upper) / 2.0, upper - lower
    closing = np.zeros(spec.n_joints)
    for motor in range(spec.n_joints):
        ends = [np.where(np.arange(spec.n_joints) == motor, end, middle) for end in (lower, upper)]
        apart = [_apart(model, posture) for posture in ends]
        if abs(apart[0] - apart[1]) > GATHERS * max(apart):
            closing[motor] = 1.0 if apart[0] > apart[1] else -1.0
    if not closing.any():
        raise ConfigError(f"{spec.name}: no motor brings its fingertips together: store a grasp of it in the library")
    opened = np.where(closing > 0.0, lower, np.where(closing < 0.0, upper, middle))
    preshape, close, squeeze = (opened + part * closing * spans for part in (OPEN, CLOSED, FURTHER))
    return Grasp("gathering", claim_type(None), float(spans.max()), "minimum_jerk", preshape, close, squeeze)


def _apart(model: HandKinematics, posture: Vector) -> float:
    """How far fingertips are from their middle, m: root mean square."""
    tips = np.array([pose.position for pose in model.fingertips(posture).values()])
    return float(np.sqrt(np.square(tips - tips.mean(axis=0)).sum(axis=1).mean()))
