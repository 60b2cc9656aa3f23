"""Physics closes the hand: fingers press with a share of their torque until they rest on the object where it stands;
then they squeeze, lift and turn it, fast and coarsely, many candidates side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from allegro_twin.control.controllers import Gains, GravityTorque
from allegro_twin.grasping.batch.trial_loop import TrialLoop
from allegro_twin.grasping.metrics.preload import Preload
from allegro_twin.grasping.metrics.quality import imbalance
from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.grasping.plan.proposals.close_in_geometry import (
    UNBALANCED,
    metric_contacts,
    motor_scale,
    torsion_radius,
)
from allegro_twin.grasping.plan.proposals.poses import Random
from allegro_twin.grasping.verdict import pose_in_palm
from allegro_twin.kinematics.orientation import angle_between
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.separate_models import SeparateModelBatch
from allegro_twin.sim.contact.grasp_scene import GraspScene, TouchPoints, wrist_coordinates
from allegro_twin.sim.model.wrist import WRIST_JOINTS, WristSegment, wrist_load, wrist_set_points
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

STEPS = 2
"""Physics steps in a control period."""
OPEN = 0.2
"""rad, by which fingers begin before the posture in which geometry has them touch."""
SETTLING, LIFTING, TURNING = 0.25, 0.4, 1.1
"""s."""
LIGHT, STRONG = 0.35, 1.0
"""Least and greatest share of the torque limit that fingers squeeze with; drawn."""
FIRM = 0.4
"""Least share of its torque limit that the most loaded motor squeezes with, where forces are computed."""
HEIGHT = 0.06
"""m, of the lift."""
DRIFT, ROTATION = 0.012, 18.0
"""m and degrees: what a candidate may move in the hand."""


class ClosingOutcome(NamedTuple):
    """Outcome of closing a candidate."""

    candidate: Candidate
    passed: bool
    where: str
    """The stage in which it failed; `passed` otherwise."""
    reached: float
    """How far it came: 0 closing, 1 to 2 during the lift, 2 to 3 during the turn."""


def close_candidates(
    bench: GraspScene,
    candidates: Sequence[Candidate],
    performer: FingerGains,
    friction: float,
    random: Random,
    preload: Callable[[Candidate, TouchPoints, Any], Preload] | None = None,
) -> list[ClosingOutcome]:
    """All of them, side by side, in order. `preload`: reckons with what torques contacts are to be squeezed, in a state
    of the scene's model; None: fingers press with a share of their torque, and squeeze with a drawn one."""
    run = _ClosingTrials(bench, list(candidates), performer, friction, random, preload)
    run.close()
    run.squeeze()
    run.move([WristSegment(LIFTING, _along(2, HEIGHT), np.zeros(6))], "lift")
    around = -np.pi if bench.spec.side == "left" else np.pi  # As the left hand performs a protocol.
    run.move([WristSegment(TURNING, _along(5, around), np.zeros(6))], "turn")
    return [
        ClosingOutcome(candidate, not why, why or "passed", float(reached))
        for candidate, why, reached in zip(run.candidates, run.why, run.reached, strict=True)
    ]


class _ClosingTrials(TrialLoop):
    """Candidates in step."""

    def __init__(
        self,
        bench: GraspScene,
        candidates: list[Candidate],
        performer: FingerGains,
        friction: float,
        random: Random,
        preload: Callable[[Candidate, TouchPoints, Any], Preload] | None,
    ) -> None:
        n, self.timestep = len(candidates), float(bench.model.opt.timestep)
        # A copy, for a hand that closes its own loop has what its motors may give in there.
        models, names = [copy(bench.model)] * n, [bench.name] * n
        super().__init__(bench.spec, models, names, STEPS * self.timestep)
        self.bench, self.candidates, self.friction, self.random = bench, candidates, friction, random
        self.preload = preload
        self.gains, self.reached = performer.gains, np.zeros(n)
        self.base = np.array([wrist_coordinates(c.position, c.rotation) for c in candidates])
        self.target = np.array([_opened(c, bench.spec) for c in candidates])
        self.closing = np.array([c.closing for c in candidates])
        close, pressing = np.array([c.close for c in candidates]), CAP
        if preload is not None:
            close, pressing = close + OVER * np.array([c.torque for c in candidates]) / self.gains.kp, 0.0
        self.fingers = make_finger_drive(self.sims, performer, self.target, self.closing, close, pressing)
        self.sims.place(self.running, self.target)
        for axis, name in enumerate(WRIST_JOINTS):
            self.sims.joint(name)[:, 0] = self.base[:, axis]
        self._still = wrist_set_points([], self.timestep, wrist_load(bench.model))
        self.place = np.zeros(6)
        self.sims.begin(self.base + self._still[0])

    def close(self) -> None:
        """The joints that close press, or go to where they are to meet the object; the others stay."""
        for k in range(round(self.fingers.seconds / self.period)):
            self._step(self.fingers.press(self.running, (k + 1) * self.period))
        reasons = {}
        for row in self.running.tolist():
            data = self.sims.look(row)
            touch, centre = self.bench.touch(data), data.xipos[self.bench.body].copy()
            if not len(touch.points):
                reasons[row] = "empty"
            elif (
                self.preload is None
                and imbalance(metric_contacts(touch, centre, self.friction, torsion_radius(self.bench))) > UNBALANCED
            ):
                reasons[row] = "unbalanced"
        self.stop(reasons)

    def squeeze(self) -> None:
        """From where they rest, further by what makes the wanted torque."""
        spec = self.bench.spec
        rest = self.sims.position.copy()
        if self.preload is None:
            push = squeeze_offsets(self.closing, spec, self.gains, self.random)
            wanted = np.where(self.closing != 0.0, rest + push, self.target)
        else:
            wanted = rest + OVER * self._torques() / self.gains.kp
        wanted = np.clip(wanted, spec.lower, spec.upper)
        for row in self.running.tolist():
            self.candidates[row] = replace(self.candidates[row], close=rest[row], squeeze=wanted[row])
        periods = round(SETTLING / self.period)
        for k in range(periods):
            part = min(1.0, 2.0 * (k + 1) / periods)
            self.target = rest + part * (wanted - rest)
            self._step(self.fingers.go(self.running, self.target))
        for row in self.running.tolist():
            self.candidates[row] = replace(self.candidates[row], rest=self.sims.position[row].copy())
        self.began = pose_in_palm(*self.poses(np.arange(self.n)))

    def _torques(self) -> Array:
        """Torques of the motors of all candidates, (n, joints), N·m: for their present contacts; where these do not
        suffice, for those of the geometry."""
        assert self.preload is not None
        found = np.zeros((self.n, self.bench.spec.n_joints))
        for row in self.running.tolist():
            data, candidate = self.sims.look(row), self.candidates[row]
            held = self.preload(candidate, self.bench.touch(data), data)
            torque = held.torque if np.isfinite(held.share) else candidate.torque
            assert torque is not None
            # Firmly enough for what is light, too: scaled, forces that move nothing still move nothing.
            share = float((np.abs(torque) / self.bench.spec.actuation.torque_limit).max())
            torque = torque * max(1.0, FIRM / max(share, 1e-9))
            found[row] = torque
            self.candidates[row] = replace(candidate, torque=torque)
        return found

    def move(self, segments: list[WristSegment], name: str) -> None:
        """The wrist moves; whoever loses the object is out."""
        table = wrist_set_points(segments, self.timestep, wrist_load(self.bench.model))
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
        position, turn = pose_in_palm(*self.poses(rows))
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


def squeeze_offsets(closing: Array, spec: HandSpec, gains: Gains, random: Random) -> Array:
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


CAP = 0.45
"""Share of their torque limit that fingers close with."""
OVER = 1.15
"""A position grasp is told to go so much further than the torque needs: contacts give."""
SECONDS, RISE = 0.45, 0.1
"""s that closing takes at least, and until fingers press as hard as they are to."""
SPEED = 4.0
"""rad/s at most at which what closes is to turn."""


@dataclass(frozen=True, slots=True)
class FingerGains:
    """Controller that holds the fingers at their set-points."""

    gains: Gains
    """Gains of the controller, or of the loop that the hand closes."""
    gravity: GravityTorque


class FingerDrive(Protocol):
    """Both ways give what `SeparateModelBatch.advance` tells the motors of some rows in a period, (rows, n)."""

    @property
    def seconds(self) -> float:
        """That closing takes."""
        ...

    def press(self, rows: Rows, at: float) -> Array:
        """While joints close, `at` s after they have begun: with a share of their torque; the others stay."""
        ...

    def go(self, rows: Rows, target: Array) -> Array:
        """To positions, (candidates, n), rad, with all that they have."""
        ...


def make_finger_drive(
    sims: SeparateModelBatch, performer: FingerGains, start: Array, closing: Array, close: Array, pressing: float = CAP
) -> FingerDrive:
    """`start`: where they begin, `closing`: which way they go, and `close`: where geometry has them meet something,
    (candidates, n). `pressing`: the share of their torque limit with which they go on from there; 0: they stay
    there."""
    if not sims.closes_loop:
        return TorqueFingers(sims, performer, start.copy(), closing, close, pressing)
    return ServoFingers(sims, performer, start.copy(), closing, close, pressing)


@dataclass(frozen=True, slots=True, eq=False)
class TorqueFingers:
    """Fingers that take torques: PD, and their weight carried."""

    sims: SeparateModelBatch
    performer: FingerGains
    start: Array
    closing: Array
    close: Array
    pressing: float

    @property
    def seconds(self) -> float:
        return SECONDS if self.pressing else SECONDS + SETTLING

    def press(self, rows: Rows, at: float) -> Array:
        gains, sims = self.performer.gains, self.sims
        limit = sims.spec.actuation.torque_limit
        if self.pressing:
            push = min(1.0, at / RISE) * self.pressing * limit * self.closing
        else:
            push = gains.kp * (self.start + min(1.0, at / SECONDS) * (self.close - self.start) - sims.position)
        push = push - gains.kd * sims.velocity
        stay = gains.kp * (self.start - sims.position) - gains.kd * sims.velocity
        return self._carried(rows, np.where(self.closing != 0.0, push, stay))

    def go(self, rows: Rows, target: Array) -> Array:
        gains, sims = self.performer.gains, self.sims
        return self._carried(rows, gains.kp * (target - sims.position) - gains.kd * sims.velocity)

    def _carried(self, rows: Rows, torque: Array) -> Array:
        wanted, down, sims = torque[rows], self.sims.gravity, self.sims
        for place, row in enumerate(rows.tolist()):
            wanted[place] += self.performer.gravity(sims.position[row], down[row])
        return wanted


@dataclass(frozen=True, slots=True, eq=False)
class ServoFingers:
    """Fingers whose firmware closes the loop: they are told to go evenly to a little beyond where they should meet the
    object, with a share of their effort where the hand can limit it."""

    sims: SeparateModelBatch
    performer: FingerGains
    start: Array
    closing: Array
    close: Array
    pressing: float

    @property
    def seconds(self) -> float:
        travel = np.abs(self._goal() - self.start) / motor_scale(self.sims.spec)
        return max(SECONDS, float(travel.max()) / SPEED)

    def press(self, rows: Rows, at: float) -> Array:
        limit, goal = self.sims.spec.actuation.torque_limit, self._goal()[rows]
        limited = "limited_position" in self.sims.spec.commands
        effort = np.tile(CAP * limit if limited else limit, (len(rows), 1))
        wanted = self.start[rows] + min(1.0, at / (0.8 * self.seconds)) * (goal - self.start[rows])
        return self.sims.servo_control(rows, wanted, effort)

    def go(self, rows: Rows, target: Array) -> Array:
        return self.sims.servo_control(rows, target[rows])

    def _goal(self) -> Array:
        spec = self.sims.spec
        beyond = OVER * self.pressing * spec.actuation.torque_limit / self.performer.gains.kp
        goal: Array = np.clip(self.close + beyond * self.closing, spec.lower, spec.upper)
        return np.where(self.closing != 0.0, goal, self.start)
