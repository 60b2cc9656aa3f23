"""Physics closes the hand: fingers press with a share of their torque until they rest on the object where it stands;
then they squeeze, lift and turn it, fast and coarsely, many candidates side by side."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allegro_twin.control.controllers import Gains
from allegro_twin.grasping.batch.trial_loop import TrialLoop
from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.grasping.plan.fingers import OVER, Performer, fingers_of
from allegro_twin.grasping.plan.force_closure import UNBALANCED, gripped, imbalance, torsion_of
from allegro_twin.grasping.plan.surface import Random
from allegro_twin.grasping.verdict import in_palm
from allegro_twin.kinematics.orientation import angle_between
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
    run = _Closing(bench, list(candidates), performer, friction, random)
    run.close()
    run.squeeze()
    run.move([wrist.Segment(LIFTING, _along(2, HEIGHT), np.zeros(6))], "lift")
    run.move([wrist.Segment(TURNING, _along(5, np.pi), np.zeros(6))], "turn")
    return [
        Outcome(candidate, not why, why or "passed", float(reached))
        for candidate, why, reached in zip(run.candidates, run.why, run.reached, strict=True)
    ]


class _Closing(TrialLoop):
    """Candidates in step."""

    def __init__(
        self, bench: Workbench, candidates: list[Candidate], performer: Performer, friction: float, random: Random
    ) -> None:
        n, self.timestep = len(candidates), float(bench.model.opt.timestep)
        # A copy, for a hand that closes its own loop has what its motors may give in there.
        models, names = [copy(bench.model)] * n, [bench.name] * n
        super().__init__(bench.spec, models, names, STEPS * self.timestep)
        self.bench, self.candidates, self.friction, self.random = bench, candidates, friction, random
        self.gains, self.reached = performer.gains, np.zeros(n)
        self.base = np.array([coordinates(c.position, c.rotation) for c in candidates])
        self.target = np.array([_opened(c, bench.spec) for c in candidates])
        self.closing = np.array([c.closing for c in candidates])
        close = np.array([c.close for c in candidates])
        self.fingers = fingers_of(self.sims, performer, self.target, self.closing, close)
        self.sims.place(self.running, self.target)
        for axis, name in enumerate(wrist.JOINTS):
            self.sims.joint(name)[:, 0] = self.base[:, axis]
        self._still = wrist.commands([], self.timestep, wrist.load(bench.model))
        self.place = np.zeros(6)
        self.sims.begin(self.base + self._still[0])

    def close(self) -> None:
        """The joints that close press, the others stay."""
        for k in range(round(self.fingers.seconds / self.period)):
            self._step(self.fingers.press(self.running, (k + 1) * self.period))
        reasons = {}
        for row in self.running.tolist():
            data = self.sims.look(row)
            touch, centre = self.bench.touch(data), data.xipos[self.bench.body].copy()
            if not len(touch.points):
                reasons[row] = "empty"
            elif imbalance(gripped(touch, centre, self.friction, torsion_of(self.bench))) > UNBALANCED:
                reasons[row] = "unbalanced"
        self.stop(reasons)

    def squeeze(self) -> None:
        """From where they rest, further by what makes the wanted torque."""
        spec = self.bench.spec
        rest = self.sims.position.copy()
        push = squeezed(self.closing, spec, self.gains, self.random)
        wanted = np.clip(np.where(self.closing != 0.0, rest + push, self.target), spec.lower, spec.upper)
        for row in self.running.tolist():
            self.candidates[row] = replace(self.candidates[row], close=rest[row], squeeze=wanted[row])
        periods = round(SETTLING / self.period)
        for k in range(periods):
            part = min(1.0, 2.0 * (k + 1) / periods)
            self.target = rest + part * (wanted - rest)
            self._step(self.fingers.go(self.running, self.target))
        for row in self.running.tolist():
            self.candidates[row] = replace(self.candidates[row], rest=self.sims.position[row].copy())
        self.began = in_palm(*self.poses(np.arange(self.n)))

    def move(self, segments: list[wrist.Segment], name: str) -> None:
        """The wrist moves; whoever loses the object is out."""
        table = wrist.commands(segments, self.timestep, wrist.load(self.bench.model))
        begun = np.ceil(self.reached)
        for k in range(len(table) // STEPS):
            self.reached[self.running] = begun[self.running] + (k + 1) * STEPS / len(table)
            self._step(self.fingers.go(self.running, self.target), table[k * STEPS : (k + 1) * STEPS])
            if k % 25 == 24:
                self._judge(name)
        self.place = self.place + sum(segment.move for segment in segments)
        self._judge(name, last=True)

    def _judge(self, name: str, *, last: bool = False) -> None:
        rows = self.running
        position, turn = in_palm(*self.poses(rows))
        drift = np.linalg.norm(position - self.began[0][rows], axis=1)
        margins = 1.0 - np.maximum(drift / DRIFT, np.degrees(angle_between(turn, self.began[1][rows])) / ROTATION)
        self.stop({row: name for row, margin in zip(rows.tolist(), margins, strict=True) if not margin > 0.0})
        for row, margin in zip(rows.tolist(), margins.tolist(), strict=True):
            if last and margin > 0.0:
                self.candidates[row] = replace(self.candidates[row], score=margin)

    def _step(self, control: Array, moved: Array | None = None) -> None:
        """Let a period pass, with the wrist at its place, or moved from there by a table, (steps, 6)."""
        rows = self.running
        if not len(rows):
            return
        self.advance(control, self.base[rows][:, None] + (self.place + (self._still if moved is None else moved)))
        diverged = rows[~np.isfinite(self.sims.position[rows]).all(axis=1)]
        self.stop(dict.fromkeys(diverged.tolist(), "diverged"))


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
