"""Geometry proposes: palms that fit, closed on the object, in contacts that could hold it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from allegro_twin.evaluate.metrics.carrying import least_normal_force
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.library.grasps import Grasp
from allegro_twin.plan.balance import UNBALANCED, gripped, imbalance
from allegro_twin.plan.candidate import Candidate
from allegro_twin.plan.closing import COARSE, closed
from allegro_twin.plan.poses import Guesses, guesses
from allegro_twin.plan.surface import Random, placed_surface
from allegro_twin.sim.workbench import Meetings, Workbench
from allegro_twin.types import Array

LOWEST, HIGHER = 0.002, 0.008
"""m, between a hand and the table."""
LOWERED, NEAR = 0.5, 0.03
"""The share of palms that come down to the table where they are not further above it, m."""
RETREAT = (0.025, 0.05, 0.10)
"""m along the way out, where the hand must be free."""
BATCH = 256


def proposals(
    bench: Workbench, templates: Sequence[Grasp], friction: float, turns: Sequence[float], random: Random,
    tries: int = 2_000_000, step: float = COARSE,
) -> Iterator[Candidate]:  # fmt: skip
    """Of so many guesses those that nothing speaks against. `turns`: angles about the palm's z by which the trial will
    turn it, rad; `step`: of the closing fingers, rad."""
    axes = matrix_from_quaternion(np.array(bench.placed.quaternion))
    bench.place(np.array([0.0, 0.0, 1.0]), np.eye(3), templates[0].preshape)
    centre = bench.centre
    for _ in range(0, tries, BATCH):
        guessed = guesses(placed_surface(bench.placed, BATCH, random), axes, templates, bench.spec, random)
        for row in range(BATCH):
            candidate = fitting(bench, guessed, row, random)
            if candidate is not None:
                candidate, touch = closed(bench, candidate, step)
                score = promise(bench, candidate, touch, centre, friction, turns)
                if score is not None:
                    yield replace(candidate, score=score)


def fitting(bench: Workbench, guessed: Guesses, row: int, random: Random) -> Candidate | None:
    """A guess that is free where it is and on its way there, lifted off the table if it must be; or None."""
    position, rotation, preshape = guessed.position[row], guessed.rotation[row], guessed.preshape[row]
    lowest = bench.lowest(position, rotation, preshape)
    gap = random.uniform(LOWEST, HIGHER)
    if lowest < gap or (lowest < NEAR and random.random() < LOWERED):
        position = position + np.array([0.0, 0.0, gap - lowest])
    if position[2] > 0.5 or np.linalg.norm(position - guessed.position[row]) > 0.06:
        return None
    bench.place(position, rotation, preshape)
    if bench.meets_anything():
        return None
    for way in (-rotation[:, 0], np.array([0.0, 0.0, 1.0])):
        if all(_free(bench, position + far * way, rotation, preshape) for far in RETREAT):
            closing = guessed.closing[row]
            return Candidate(
                position, rotation, RETREAT[-1] * way, preshape, closing, preshape, preshape, guessed.template[row]
            )
    return None


def _free(bench: Workbench, position: Array, rotation: Array, posture: Array) -> bool:
    bench.place(position, rotation, posture)
    return not bench.meets_anything()


def promise(
    bench: Workbench, candidate: Candidate, touch: Meetings, centre: Array, friction: float, turns: Sequence[float]
) -> float | None:
    """How little force would do, as a score; None for contacts that cannot hold."""
    palm = len(bench.spec.fingers)
    fingers = set(touch.part.tolist())
    if len(fingers) < 2 or bench.meets_table() or not fingers & {palm, palm - 1}:
        return None  # A finger alone, or fingers without anything against them.
    held = gripped(touch, centre, friction)
    if imbalance(held) > UNBALANCED:
        return None
    force = float(least_normal_force(held, loads(candidate.rotation, bench.mass, turns)).max())
    return -force if np.isfinite(force) else None


def loads(rotation: Array, mass: float, turns: Sequence[float]) -> Array:
    """The weight as the contacts feel it when the palm has turned about its z axis, (k, 6), N, in the world's axes of
    the unturned palm."""
    weight = np.array([0.0, 0.0, -9.81 * mass])
    found = np.zeros((len(turns), 6))
    for row, angle in enumerate(turns):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        found[row, :3] = rotation @ turn.T @ rotation.T @ weight
    return found
