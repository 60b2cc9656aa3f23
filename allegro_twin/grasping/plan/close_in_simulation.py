"""Physics closes the hand: fingers press with a share of their torque until they rest on the object where it stands;
then they squeeze, lift and turn it, fast and coarsely, many candidates side by side."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.grasping.plan.fingers import OVER, Performer, fingers_of
from allegro_twin.grasping.plan.force_closure import UNBALANCED, gripped, imbalance, torsion_of
from allegro_twin.grasping.plan.surface import Random
from allegro_twin.kinematics.orientation import angle_between, matrix_from_quaternion
from allegro_twin.sim.batch.simulations import Rows, Simulations
from allegro_twin.sim.contact.grasp_scene import Workbench, coordinates
from allegro_twin.sim.model import wrist
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

STEPS = 2
"""Physics steps in a control period."""
OPEN = 0.2
"""rad, by which fingers begin before the posture in which geometry has them touch."""
SETTLING, LIFTING, TURNING = 0.25, 0.4, 1.1
"""s."""
LIGHT, STRONG = 0.35, 1.0
"""Of it that they squeeze with, at least and at most; drawn."""
HEIGHT = 0.06
"""m, of the lift."""
DRIFT, ROTATION = 0.012, 18.0
"""m and degrees: what a candidate may move in the hand."""


class Outcome(NamedTuple):
    """What became of a candidate."""

    candidate: Candidate
    passed: bool
    where: str
    """The stage in which it failed; `passed` otherwise."""
    reached: float
    """How far it came: 0 closing, 1 to 2 during the lift, 2 to 3 during the turn."""


def tried(
    bench: Workbench, candidates: Sequence[Candidate], performer: Performer, friction: float, random: Random
) -> list[Outcome]:
    """All of them, side by side, in order."""
    run = _Run(bench, list(candidates), performer, friction, random)
    run.close()
    run.squeeze()
    run.move([wrist.Segment(LIFTING, _along(2, HEIGHT), np.zeros(6))], "lift")
    run.move([wrist.Segment(TURNING, _along(5, np.pi), np.zeros(6))], "turn")
    return [
        Outcome(candidate, where == "passed", where, float(reached))
        for candidate, where, reached in zip(run.candidates, run.where, run.reached, strict=True)
    ]


class _Run:
    """Candidates in step."""

    def __init__(
        self, bench: Workbench, candidates: list[Candidate], performer: Performer, friction: float, random: Random
    ) -> None:
        self.bench, self.candidates, self.friction, self.random = bench, candidates, friction, random
        self.gains, n = performer.gains, len(candidates)
        self.where, self.reached = ["passed"] * n, np.zeros(n)
        self.alive: Rows = np.arange(n)
        self.period = STEPS * float(bench.model.opt.timestep)
        # A copy, for a hand that closes its own loop has what its motors may give in there.
        self.sims = Simulations(bench.spec, [copy(bench.model)] * n, period=self.period)
        self.base = np.array([coordinates(c.position, c.rotation) for c in candidates])
        self.target = np.array([_opened(c, bench.spec) for c in candidates])
        self.closing = np.array([c.closing for c in candidates])
        close = np.array([c.close for c in candidates])
        self.fingers = fingers_of(self.sims, performer, self.target, self.closing, close)
        self.sims.place(self.target)
        for axis, name in enumerate(wrist.JOINTS):
            self.sims.joint(name)[:, 0] = self.base[:, axis]
        self._table = wrist.commands([], bench.model.opt.timestep, wrist.load(bench.model))
        self.place = np.zeros(6)
        self.sims.begin(self.base + self._table[0])
        self.palm = bench.model.body("palm_link").id

    def close(self) -> None:
        """The joints that close press, the others stay."""
        for k in range(round(self.fingers.seconds / self.period)):
            self._step(self.fingers.press(self.alive, (k + 1) * self.period))
        for row in self.alive.tolist():
            self.sims.look(row, self.bench.scratch)
            touch, centre = self.bench.touch(self.bench.scratch), self.bench.scratch.xipos[self.bench.body].copy()
            if not len(touch.points):
                self.where[row] = "empty"
            elif imbalance(gripped(touch, centre, self.friction, torsion_of(self.bench))) > UNBALANCED:
                self.where[row] = "unbalanced"
        self._drop()

    def squeeze(self) -> None:
        """From where they rest, further by what makes the wanted torque."""
        spec = self.bench.spec
        rest = self.sims.position.copy()
        push = squeezed(self.closing, spec, self.gains, self.random)
        wanted = np.clip(np.where(self.closing != 0.0, rest + push, self.target), spec.lower, spec.upper)
        for row in self.alive.tolist():
            self.candidates[row] = replace(self.candidates[row], close=rest[row], squeeze=wanted[row])
        periods = round(SETTLING / self.period)
        for k in range(periods):
            part = min(1.0, 2.0 * (k + 1) / periods)
            self.target = rest + part * (wanted - rest)
            self._step(self.fingers.go(self.alive, self.target))
        for row in self.alive.tolist():
            self.candidates[row] = replace(self.candidates[row], rest=self.sims.position[row].copy())
        self.began = self._in_palm()

    def move(self, segments: list[wrist.Segment], name: str) -> None:
        """The wrist moves; whoever loses the object is out."""
        timestep = float(self.bench.model.opt.timestep)
        table = wrist.commands(segments, timestep, wrist.load(self.bench.model))
        begun = np.ceil(self.reached)
        for k in range(len(table) // STEPS):
            self.reached[self.alive] = begun[self.alive] + (k + 1) * STEPS / len(table)
            self._step(self.fingers.go(self.alive, self.target), self.place + table[k * STEPS : (k + 1) * STEPS])
            if k % 25 == 24:
                self._judge(name)
        self.place = self.place + sum(segment.move for segment in segments)
        self._judge(name, last=True)

    def _judge(self, name: str, *, last: bool = False) -> None:
        position, turn = self._in_palm()
        drift = np.linalg.norm(position - self.began[0], axis=1)
        angle = np.degrees(angle_between(turn, self.began[1]))
        for row in self.alive.tolist():
            margin = 1.0 - max(drift[row] / DRIFT, angle[row] / ROTATION)
            if not margin > 0.0:
                self.where[row] = name
            elif last:
                self.candidates[row] = replace(self.candidates[row], score=float(margin))
        self._drop()

    def _in_palm(self) -> tuple[Array, Array]:
        """The object in every palm's frame: (n, 3), m, and (n, 3, 3)."""
        sims, body = self.sims, self.bench.body
        palm = matrix_from_quaternion(sims.body_quaternion[:, self.palm])
        away = sims.body_position[:, body] - sims.body_position[:, self.palm]
        turn = np.einsum("kji,kjl->kil", palm, matrix_from_quaternion(sims.body_quaternion[:, body]))
        return np.einsum("kji,kj->ki", palm, away), turn

    def _step(self, told: Array, moved: Array | None = None) -> None:
        rows, sims = self.alive, self.sims
        if not len(rows):
            return
        steady = np.repeat((self.place + self._table[0])[None], STEPS, axis=0)
        drive = self.base[rows][:, None] + (steady if moved is None else moved)
        sims.advance(rows, told, drive, STEPS)
        bad = ~np.isfinite(sims.position[rows]).all(axis=1)
        for row in rows[bad].tolist():
            self.where[row] = "diverged"
        if bad.any():
            self._drop()

    def _drop(self) -> None:
        self.alive = np.array([row for row in self.alive if self.where[row] == "passed"], dtype=np.int64)


def squeezed(closing: Array, spec: HandSpec, gains: Gains, random: Random) -> Array:
    """How far beyond where they touch joints are told to go: for a drawn share of their torque limit, (k, n), rad."""
    share = random.uniform(LIGHT, STRONG, (len(closing), 1))
    further: Array = OVER * share * spec.actuation.torque_limit * closing / gains.kp
    return further


def _opened(candidate: Candidate, spec: HandSpec) -> Array:
    """A little before the fingers touch, but no more open than the pre-shape; as that, where one motor moves several
    joints, of which the first may touch long before the last."""
    if spec.followers:
        return candidate.preshape
    back = candidate.close - OPEN * candidate.closing
    ahead = candidate.closing * (back - candidate.preshape) > 0.0
    posture: Array = np.where(ahead, back, candidate.preshape)
    return posture


def _along(axis: int, by: float) -> Array:
    move = np.zeros(6)
    move[axis] = by
    return move
