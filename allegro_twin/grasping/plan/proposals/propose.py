"""Geometry proposes: palms that fit, closed on the object, in contacts that could hold it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allegro_twin.control.controllers import Gains
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.metrics.carrying import least_normal_force
from allegro_twin.grasping.metrics.contacts import cross_product
from allegro_twin.grasping.metrics.preload import GripForces, Preload
from allegro_twin.grasping.metrics.quality import imbalance
from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.grasping.plan.proposals.close_in_geometry import (
    COARSE,
    UNBALANCED,
    close_fingers,
    meet_exactly,
    metric_contacts,
    motor_scale,
    torsion_radius,
)
from allegro_twin.grasping.plan.proposals.opposition import THUMB
from allegro_twin.grasping.plan.proposals.poses import (
    NOISE,
    PoseGuesses,
    Random,
    SurfaceSample,
    guess_poses,
    sample_placed_surface,
    sample_surface,
)
from allegro_twin.grasping.plan.region import SHARE, GraspRegion, to_object_frame
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_vector
from allegro_twin.sim.contact.grasp_scene import GraspScene, TouchPoints
from allegro_twin.sim.objects.catalogue import GraspObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

LOWEST, HIGHER = 0.002, 0.008
"""m, between a hand and the table."""
LOWERED, NEAR = 0.5, 0.03
"""The share of palms that come down to the table where they are not further above it, m."""
RETREAT = (0.025, 0.05, 0.10)
"""m along the way out, where the hand must be free."""
OVERLAP = 0.003
"""m, by which links of a hand may be inside each other before it closes."""
BATCH = 256
_SAMPLED = 40 * BATCH
"""Points of a surface of which those in a region are taken."""
METRES, TURN = 0.007, np.radians(6.0)
"""By how much a variation of a candidate differs (standard deviations), m and rad."""


@dataclass(slots=True)
class Proposer:
    """Candidates that nothing speaks against, for one object on its workbench."""

    bench: GraspScene
    templates: Sequence[Grasp]
    friction: float
    turns: Sequence[float]
    """Angles about the palm's z by which the trial will turn it, rad."""
    random: Random
    step: float = COARSE
    """Step of the closing fingers, rad."""
    region: GraspRegion | None = None
    """By which it is to be held."""
    gains: Gains | None = None
    """With which joints hold: forces are reckoned with them. None: they are not, and candidates are ranked by the
    normal forces that would do."""
    gap: tuple[float, float] = (LOWEST, HIGHER)
    """Between a hand and the table at least: a draw between two lengths, m."""
    centre: Array = field(init=False)

    def __post_init__(self) -> None:
        self.bench.place(np.array([0.0, 0.0, 1.0]), np.eye(3), self.templates[0].preshape)
        self.centre = self.bench.centre

    def fresh(self, tries: int = 2_000_000) -> Iterator[Candidate | None]:
        """New candidates from so many guesses; None after every batch, for whoever counts them."""
        axes = matrix_from_quaternion(np.array(self.bench.placed.quaternion))
        for _ in range(0, tries, BATCH):
            on = self._looked_at()
            guessed = guess_poses(on, axes, self.templates, self.bench.spec, self.random)
            for row in range(len(on.points)):
                candidate = self._grown(guessed, row)
                if candidate is not None:
                    yield candidate
            yield None

    @property
    def preload(self) -> Callable[[Candidate, TouchPoints, Any], Preload] | None:
        """Reckons with what torques contacts are to be squeezed, in a state of the scene's model."""
        gains = self.gains
        if gains is None:
            return None
        return lambda candidate, touch, data: worst_case(
            self.bench, candidate, touch, self.friction, self.turns, gains, data
        ).preload()

    def _looked_at(self) -> SurfaceSample:
        """Points of the surface, in the region where there is one. Raises ConfigError where it is empty."""
        placed = self.bench.placed
        if self.region is None:
            return sample_placed_surface(placed, BATCH, self.random)
        on = sample_placed_surface(placed, _SAMPLED, self.random)
        inside = _rows_inside(self.region, placed.grasp_object, to_object_frame(placed, on.points))[:BATCH]
        return SurfaceSample(on.points[inside], on.normals[inside])

    def grow(self, seeds: Sequence[Candidate]) -> list[Candidate]:
        """Candidates of which palm, pre-shape and the way of closing are known, with their fingers closed and their
        score; without those that cannot be, or cannot hold."""
        grown = (self._grown(_jittered(seed, self.bench.spec, self.random, 0.0), 0) for seed in seeds)
        return [candidate for candidate in grown if candidate is not None]

    def near(self, elite: Sequence[Candidate], count: int, scale: float = 1.0) -> list[Candidate]:
        """So many variations of candidates that came far, in turn; fewer where few of them fit. `scale`: of how much
        they differ."""
        found: list[Candidate] = []
        for k in range(8 * count if elite else 0):
            candidate = self._grown(_jittered(elite[k % len(elite)], self.bench.spec, self.random, scale), 0)
            if candidate is not None:
                found.append(candidate)
            if len(found) == count:
                break
        return found

    def _grown(self, guessed: PoseGuesses, row: int) -> Candidate | None:
        """A guess with its fingers closed, and its score; None for what cannot be, or cannot hold."""
        candidate = fit_palm(self.bench, guessed, row, self.random, self.gap)
        if candidate is None:
            return None
        if self.gains is None:
            candidate, touch = close_fingers(self.bench, candidate, self.step)
        else:
            candidate, touch = meet_exactly(self.bench, candidate)
        if self.region is not None and len(touch.points):
            inside = self.region.contains(to_object_frame(self.bench.placed, touch.points))
            if not inside.mean() > SHARE:
                return None
        if not could_hold(self.bench, touch, self.centre, self.friction):
            return None
        if self.gains is None:
            force = -normal_force(self.bench, candidate, touch, self.centre, self.friction, self.turns)
            return replace(candidate, score=force) if np.isfinite(force) else None
        worst = worst_case(self.bench, candidate, touch, self.friction, self.turns, self.gains)
        held = worst.preload()
        if not np.isfinite(held.share):
            return None
        share = (1.0 - SPRINGS) * worst.limit_share() + SPRINGS * held.share
        return replace(candidate, score=-share, torque=held.torque)


def check_region(region: GraspRegion, grasp_object: GraspObject, random: Random) -> None:
    """Raises ConfigError where nothing of an object's surface is in the region. It needs the surface alone: to cut a
    mesh into convex pieces takes minutes."""
    _rows_inside(region, grasp_object, sample_surface(grasp_object, _SAMPLED, random).points)


def _rows_inside(region: GraspRegion, grasp_object: GraspObject, points: Array) -> NDArray[np.int_]:
    """Which points of a surface (k, 3), m, in the object's frame, are in the region. Raises ConfigError for none."""
    inside = np.flatnonzero(region.contains(points))
    if not len(inside):
        ends = zip("xyz", points.min(axis=0), points.max(axis=0), strict=True)
        reach = ", ".join(f"{axis} {low:.3f} to {high:.3f}" for axis, low, high in ends)
        raise ConfigError(
            f"object {grasp_object.name}: nothing of its surface is in the region {region}; it reaches over {reach}, m "
            "in its own frame"
        )
    return inside


def _jittered(candidate: Candidate, spec: HandSpec, random: Random, scale: float = 1.0) -> PoseGuesses:
    turn = matrix_from_quaternion(quaternion_from_vector(scale * TURN * random.normal(size=3)))
    noise = scale * NOISE * random.normal(size=spec.n_joints) * motor_scale(spec)
    preshape = np.clip(candidate.preshape + noise, spec.lower, spec.upper)
    position = candidate.position + scale * METRES * random.normal(size=3)
    return PoseGuesses(
        position[None], (turn @ candidate.rotation)[None], preshape[None], candidate.closing[None], [candidate.template]
    )


def fit_palm(
    bench: GraspScene, guessed: PoseGuesses, row: int, random: Random, gap: tuple[float, float] = (LOWEST, HIGHER)
) -> Candidate | None:
    """A guess that is free where it is and on its way there, lifted off the table if it must be, by a draw of `gap`, m;
    or None."""
    position, rotation, preshape = guessed.position[row], guessed.rotation[row], guessed.preshape[row]
    lowest = bench.lowest(position, rotation, preshape)
    above = random.uniform(*gap)
    if lowest < above or (lowest < NEAR and random.random() < LOWERED):
        position = position + np.array([0.0, 0.0, above - lowest])
    if position[2] > 0.5 or np.linalg.norm(position - guessed.position[row]) > 0.06:
        return None
    bench.place(position, rotation, preshape)
    if bench.meets_anything() or bench.overlap() > OVERLAP:
        return None
    for way in (-rotation[:, 0], np.array([0.0, 0.0, 1.0])):
        if all(_free(bench, position + far * way, rotation, preshape) for far in RETREAT):
            closing = guessed.closing[row]
            return Candidate(
                position,
                rotation,
                RETREAT[-1] * way,
                preshape,
                closing,
                preshape,
                preshape,
                preshape,
                guessed.template[row],
            )
    return None


def _free(bench: GraspScene, position: Array, rotation: Array, posture: Array) -> bool:
    bench.place(position, rotation, posture)
    return not bench.meets_anything()


def could_hold(bench: GraspScene, touch: TouchPoints, centre: Array, friction: float) -> bool:
    """Whether contacts could hold the object at all: thumb or palm against something else, away from the table, and
    their forces can balance."""
    names, parts = [finger.name for finger in bench.spec.fingers], set(touch.part.tolist())
    against = {names.index(THUMB), len(names)} if THUMB in names else parts  # Thumb and palm.
    if len(parts) < 2 or bench.meets_table() or not parts & against:
        return False  # A finger alone, or fingers with nothing against them.
    return imbalance(metric_contacts(touch, centre, friction, torsion_radius(bench))) <= UNBALANCED


def normal_force(
    bench: GraspScene, candidate: Candidate, touch: TouchPoints, centre: Array, friction: float, turns: Sequence[float]
) -> float:
    """The least that carries the weight through the turns, N; inf where none does."""
    held = metric_contacts(touch, centre, friction, torsion_radius(bench))
    return float(least_normal_force(held, weight_loads(candidate.rotation, bench.mass, turns)).max())


WORN, HEAVIER = 0.75, 1.2
"""Factors on the stated friction and mass for which a squeeze is computed, since draws bring less and more."""
SHAKEN = 1.3
"""Times the weight, when the palm has turned: it is shaken there."""
SPRINGS = 0.2
"""The part of a score that is the share of the squeeze that springs answer from; the rest is by limit analysis. The
first alone refuses grasps that wrap round; what held more draws is measured in docs/results/planning.md."""
PATCH = 0.004
"""m, radius of what a fingertip touches: where there are two contacts alone, each stands for three points around it,
for about the line between two points nothing would resist."""


class WorstCase(NamedTuple):
    """A grasp with less friction and more weight than are told."""

    forces: GripForces
    stiffness: Vector
    loads: Array

    def preload(self) -> Preload:
        """The squeeze that carries the weight through the turns with the smallest share of any motor."""
        return self.forces.least_preload(self.stiffness, self.loads)

    def limit_share(self) -> float:
        """The share of any motor that the same loads need at least, whatever the springs."""
        return self.forces.limit_share(self.loads)


def worst_case(
    bench: GraspScene, candidate: Candidate, touch: TouchPoints, friction: float, turns: Sequence[float], gains: Gains,
    data: Any = None,
) -> WorstCase:  # fmt: skip
    """The worst case of a candidate that touches the object so. `data`: another state of the scene's model in which it
    does."""
    centre, limit = bench.centre if data is None else data.xipos[bench.body], bench.spec.actuation.torque_limit
    touch = _as_patches(touch) if len(touch.points) < 3 else touch
    loads = weight_loads(candidate.rotation, HEAVIER * bench.mass, turns)
    loads[1:] *= np.linspace(1.0, SHAKEN, len(loads))[1:, None]
    held = metric_contacts(touch, centre, WORN * friction)
    return WorstCase(
        GripForces(held, bench.jacobians(touch, data), limit), np.broadcast_to(gains.kp, limit.shape), loads
    )


def _as_patches(touch: TouchPoints) -> TouchPoints:
    """Three points around each contact, in its plane."""
    contacts = metric_contacts(touch, np.zeros(3), 0.0)
    first, second = contacts.tangents, cross_product(contacts.normals, contacts.tangents)
    around = [np.cos(a) * first + np.sin(a) * second for a in 2.0 * np.pi * np.arange(3) / 3.0]
    points = np.concatenate([touch.points + PATCH * way for way in around])
    return TouchPoints(points, *(np.concatenate([each] * 3) for each in touch[1:]))


def weight_loads(rotation: Array, mass: float, turns: Sequence[float]) -> Array:
    """The weight as the contacts feel it when the palm has turned about its z axis, (k, 6), N, in the world's axes of
    the unturned palm."""
    weight = np.array([0.0, 0.0, -9.81 * mass])
    found = np.zeros((len(turns), 6))
    for row, angle in enumerate(turns):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        found[row, :3] = rotation @ turn.T @ rotation.T @ weight
    return found
