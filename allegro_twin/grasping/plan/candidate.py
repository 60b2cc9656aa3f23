"""A grasp on its way from a guess to a proof."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.scenario import Scenario, Wrist, as_written
from allegro_twin.grasping.trial import Trial
from allegro_twin.hands.library.entries import Grip, LatchGrip
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.sim.drivetrain.transmission import ActuatorLengths
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Grasp candidate: the palm's pose beside an object that stands at its place, and the fingers' postures."""

    position: Array
    """Position of the palm's origin in the world, (3,), m."""
    rotation: Array
    """Rotation of the palm, (3, 3); its x points out of the palm, its z to the fingertips."""
    retreat: Array
    """From there to where the approach begins, (3,), m."""
    preshape: Vector
    """(n,), rad."""
    closing: Vector
    """Which way each joint closes: 1, -1, or 0 for one that does not, (n,)."""
    close: Vector
    """Where the fingers meet the object, (n,), rad."""
    squeeze: Vector
    """What they are told to do there, (n,), rad."""
    rest: Vector
    """Where they come to then, (n,), rad."""
    template: str
    """The library's grasp that it began as."""
    score: float = 0.0
    """Larger is better; of the last step that judged it."""
    torque: Vector | None = None
    """What the motors have to give before the load comes, (n,), N·m; None: nobody has reckoned it."""

    @property
    def direction(self) -> str:
        """From where the hand comes: `above`, `side` or between."""
        down = -float(self.rotation[2, 0])
        return "above" if down > np.cos(np.radians(30.0)) else "side" if abs(down) < 0.5 else "oblique"


@dataclass(frozen=True, slots=True, eq=False)
class ObjectSymmetry:
    """Pose of an object, and the rotations about the vertical that leave it unchanged."""

    centre: Array
    """Its middle, (3,), m, world."""
    turns: Array = field(default_factory=lambda: np.eye(3)[None])
    """Rotations, (k, 3, 3); the identity is one."""
    ball: bool = False
    """Whether any turn leaves it as it is: a sphere, where no table says which way is up."""


def palm_distance(first: Candidate, second: Candidate, symmetry: ObjectSymmetry) -> tuple[float, float]:
    """How far two palms are from each other in the world, m and rad; of the object's images the nearest counts: which
    places a search has looked at, and the arm reaches."""
    away = symmetry.turns @ (second.position - symmetry.centre) - (first.position - symmetry.centre)
    positions = np.linalg.norm(away, axis=1)
    cosines = (np.einsum("kij,ij->k", symmetry.turns @ second.rotation, first.rotation) - 1.0) / 2.0
    angles = np.arccos(np.clip(cosines, -1.0, 1.0))
    best = int(np.argmin(positions / 0.02 + angles / np.radians(20.0)))
    return float(positions[best]), float(angles[best])


def grasp_distance(first: Candidate, second: Candidate, symmetry: ObjectSymmetry) -> tuple[float, float]:
    """How far two grasps are from each other: by how much its middle moves in the palm's frame
    from the one to the other, m, which no turn about that middle changes; and by how much the palm turns, rad, of the
    object's images the nearest. What the fingers do does not count."""
    there, here = (each.rotation.T @ (symmetry.centre - each.position) for each in (first, second))
    cosines = (np.einsum("kij,ij->k", symmetry.turns @ second.rotation, first.rotation) - 1.0) / 2.0
    turned = 0.0 if symmetry.ball else float(np.arccos(np.clip(cosines.max(), -1.0, 1.0)))
    return float(np.linalg.norm(there - here)), turned


def is_different(candidate: Candidate, others: list[Candidate], symmetry: ObjectSymmetry) -> bool:
    """Whether a candidate is 2 cm or 20° from every other one, by `grasp_distance`."""
    for other in others:
        far, turned = grasp_distance(candidate, other, symmetry)
        if far < 0.02 and turned < np.radians(20.0):
            return False
    return True


ROUND = 36
"""Turns that stand for any turn of something round: every 10°, half of what makes grasps different."""


def object_symmetry(placed: PlacedObject) -> ObjectSymmetry:
    """On a table: of a body of revolution that stands on its axis, and of a sphere, any turn about the vertical; of a
    box and of what lies, two or four; of a mesh, none."""
    grasp_object = placed.grasp_object
    _w, x, y, _z = placed.quaternion
    upright = abs(x) < 1e-6 and abs(y) < 1e-6
    vertical = np.abs(matrix_from_quaternion(np.array(placed.quaternion))[2]) > 1.0 - 1e-6
    match grasp_object.shape:
        case "sphere":
            count = ROUND
        case "cylinder":
            count = ROUND if vertical[2] else 2
        case "ellipsoid":
            count = (
                ROUND if vertical[0] or np.isclose(grasp_object.size[0], grasp_object.size[1]) else 2
            )  # Its x is its axis.
        case "box":
            half = grasp_object.half_extents()
            square = np.isclose(*sorted(half)[:2]) if not upright else np.isclose(half[0], half[1])
            count = 4 if square and (upright or np.allclose(half, half[0])) else 2
        case _:
            count = 1
    angles = 2.0 * np.pi * np.arange(count) / count
    c, s, zero, one = np.cos(angles), np.sin(angles), np.zeros(count), np.ones(count)
    turns: Array = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
    return ObjectSymmetry(np.array(placed.position), turns)


DIGITS = 4
"""Decimal digits of angles in rad and of lengths in m in files: what is proven is what is written."""


def candidate_scenario(candidate: Candidate, bench: GraspScene, scenario: Scenario) -> Scenario:
    """The scenario with the candidate's palm, as scenarios have it: of a left hand the mirror image."""
    mirror, away = as_written(bench.spec.side), candidate.position - bench.begun
    wrist = Wrist.model_validate(
        {
            "position": round_vector(mirror * away), "facing": round_vector(mirror * candidate.rotation[:, 0]),
            "fingers": round_vector(mirror * candidate.rotation[:, 2]),
            "retreat": round_vector(mirror * candidate.retreat),
        }
    )  # fmt: skip
    return scenario.model_copy(update={"wrist": wrist, "hand": bench.spec.model_reference, "side": bench.spec.side})


def candidate_grasp(
    candidate: Candidate, template: Grasp, spec: HandSpec, squeeze: float = 1.0, grip: Grip | None = None
) -> Grasp:
    """The candidate's postures as a grasp, of its template's type. `squeeze`: factor on how far the fingers are told to
    go beyond where they touch. `grip`: how it controls force."""
    told = candidate.close + squeeze * (candidate.squeeze - candidate.close)
    preshape, close, told = (round_posture(each, spec) for each in (candidate.preshape, candidate.close, told))
    return replace(template, preshape=preshape, close=close, squeeze=told, grip=grip, observed=None)


def round_posture(posture: Vector, spec: HandSpec) -> Vector:
    """A posture as files have it, inside the joint limits, (n,), rad."""
    fine = 10.0**DIGITS
    inside: Vector = np.clip(
        np.round(posture, DIGITS), np.ceil(spec.lower * fine) / fine, np.floor(spec.upper * fine) / fine
    )
    return inside


def round_vector(vector: Array) -> tuple[float, float, float]:
    """Three lengths as files have them, m."""
    x, y, z = np.round(vector, DIGITS).tolist()
    return x, y, z


SHARE = 0.9
"""Share of its torque limit that a joint holds with at most: the rest is for motion and unknown parameters."""


def check_efforts(spec: HandSpec) -> None:
    """Raise ConfigError for a hand of which the effort of a motor is unknown: a grasp could rest on a torque that no
    motor gives."""
    limits = spec.actuation.torque_limit
    unknown = [name for name, limit in zip(spec.joints, limits, strict=True) if np.isinf(limit)]
    if unknown:
        which = "all motors" if len(unknown) == len(limits) else ", ".join(unknown)
        raise ConfigError(
            f"{spec.card or spec.name}: the effort of {which} is unknown, so nobody could say what a grasp may ask of "
            "the hand: write the maker's figure, N·m, as `effort` into the card"
        )


def check_stiffness(spec: HandSpec) -> None:
    """Raises ConfigError for a hand that closes its own loop where nobody says how stiff that is: no squeeze could be
    reckoned with."""
    if "torque" not in spec.commands and spec.actuation.stiffness is None:
        raise ConfigError(f"{spec.name}: its card says no `stiffness` of what is driven; `hand new` writes it")


def rest_positions(trial: Trial, data: Any) -> Mapping[str, float]:
    """Positions of what is driven by name, rad: what a batch of trials measures for `limit_squeeze`."""
    spec, lengths = trial.backend.spec, ActuatorLengths(trial.backend.spec, trial.backend.model)
    at = lengths.position(data.qpos) if lengths.sums else lengths.look(trial.backend.model, data)[0]
    return dict(zip(spec.joints, at.tolist(), strict=True))


def limit_squeeze(grasp: Grasp, rest: Vector, gains: Gains, spec: HandSpec, share: float = SHARE) -> Grasp:
    """The grasp with its squeeze no further from where its joints come to `rest` (n,), rad, than what `share` of their
    torque limits makes: kp |squeeze - rest| ≤ share · limit. One that latches squeezes from where it closes."""
    rest = grasp.close if isinstance(grasp.grip, LatchGrip) else rest
    reach = share * spec.actuation.torque_limit / gains.kp
    return replace(grasp, squeeze=round_posture(np.clip(grasp.squeeze, rest - reach, rest + reach), spec))
