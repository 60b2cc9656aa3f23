"""Trials of one hand side by side: what the arm does, when the hand closes, and what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from allegro_twin.grasping.batch import TrialLoop, in_layouts, stacked
from allegro_twin.sim.batch import Rows
from allegro_twin.types import Array
from studies.preemption.fingers import Fingers
from studies.preemption.measures import Measures
from studies.preemption.policies import Seen, Yes, begins, due
from studies.preemption.scenes import Bench, Job, Setup, servo_of

LOOK = 2
"""Periods from one look at the contacts to the next, until the thing is up."""
_FAR = 10.0
"""m. Where nothing is that has not diverged."""


class SpringBench(Bench):
    """Makes trials of one hand on a spring, many at a time."""

    def rows(self, jobs: Sequence[Job]) -> list[dict[str, Any]]:
        """The rows of some trials, in their order."""
        return simulate(self, [self.setup(job) for job in jobs])


def simulate(bench: Bench, setups: Sequence[Setup]) -> list[dict[str, Any]]:
    """The rows of some trials, in their order; none depends on which others there are."""
    models = [setup.model for setup in setups]
    return in_layouts(models, lambda indices: _Trials(bench, [setups[i] for i in indices]).rows())


class _Trials(TrialLoop):
    """Trials of one layout."""

    def __init__(self, bench: Bench, setups: Sequence[Setup]) -> None:
        study = self.study = bench.study
        names = [setup.job.case.object for setup in setups]
        super().__init__(bench.spec, [setup.model for setup in setups], names, study.period, 1)
        self.setups, self.motion, self.rest, self.force = setups, study.motion, study.arm.rest, study.check
        self.fingers = Fingers([s.grasp for s in setups], self.motion, bench.gains, bench.gravity, bench.limits)
        self.sims.place(self.running, self.fingers.open)
        self.sims.joint(names[0])[:] = np.array([setup.thing for setup in setups])
        self.drive = stacked([setup.drive for setup in setups], max(len(setup.drive) for setup in setups))
        self.sims.begin(self.drive[:, 0])
        self.slide, self.spring = self.sims.joint("wrist_z")[:, 0], servo_of(study.arm, 0.0).stiffness[2]
        self.arrival = np.array([setup.job.case.approach for setup in setups])
        self.way = np.array([round(t / self.period) for t in self.arrival])
        after = self.motion.lifting, self.motion.hold, self.motion.shaking
        self.up, self.hold, self.end = np.cumsum([round(t / self.period) for t in after]).tolist()
        self.lift = np.full(self.n, np.iinfo(np.int64).max)
        """In which period the arm begins to lift."""
        self.goal = np.array([setup.goal for setup in setups])
        self.touched, self.width = np.zeros(self.n), np.array([setup.width for setup in setups])
        self.sigma = np.array([setup.job.case.sigma for setup in setups])
        self.phase = np.array([setup.job.case.phase for setup in setups])
        self.weight = np.array([setup.weight for setup in setups])
        self.before = self.sims.body_position[:, self.palm].copy()
        self.kept = [Measures() for _ in setups]

    def rows(self) -> list[dict[str, Any]]:
        self.run()
        for kept, why in zip(self.kept, self.why, strict=True):
            kept.why = why
        return [kept.row(setup.job.case, self.force, self.motion.close)
                for kept, setup in zip(self.kept, self.setups, strict=True)]  # fmt: skip

    def control(self) -> Array:
        return self.fingers(self.running, self.tick * self.period, self.sims)

    def set_points(self) -> Array:
        """The arm is on its way, waits at its end, or lifts."""
        rows, tick = self.running, self.tick
        lifting = tick >= self.lift[rows]
        place = np.where(lifting, self.way[rows] + tick - np.where(lifting, self.lift[rows], 0), tick)
        waits = ~lifting & (tick >= self.way[rows])
        steps = place[:, None] * self.steps + np.arange(self.steps)
        steps = np.where(waits[:, None], (self.way[rows] * self.steps - 1)[:, None], steps)
        return np.asarray(self.drive[rows[:, None], np.minimum(steps, self.drive.shape[1] - 1)])

    def observe(self) -> None:
        """Decide which hands begin to close, and which arms begin to lift."""
        rows, tick = self.running, self.tick
        t = tick * self.period
        place = self.sims.body_position[rows, self.palm]
        speed = np.linalg.norm(place - self.before[rows], axis=1) / self.period
        self.before[rows] = place
        remaining = np.linalg.norm(place - self.goal[rows], axis=1)
        late = t - self.arrival[rows]
        rests = (remaining <= self.rest.distance) & (speed <= self.rest.speed)
        settled = (late >= -1e-9) & (rests | (late >= self.rest.patience - 1e-9))
        seen = Seen(t, self.arrival[rows], settled, remaining, speed, self.touched[rows], self.width[rows],
                    self.sigma[rows])  # fmt: skip
        closed = self.fingers.done(rows, t)
        for policy in self.study.policies:
            mine = np.array([self.setups[row].job.policy.name == policy.name for row in rows])
            if not mine.any():
                continue
            looks = mine & due(policy.rate, self.phase[rows], t, self.period)
            self._begin(rows, looks & begins(policy, seen, self.motion.close), tick)
            for row in rows[looks & closed & settled & (self.lift[rows] > tick)].tolist():
                self.lift[row], self.kept[row].marks["lift"] = tick, self.poses(row)

    def _begin(self, rows: Rows, yes: Yes, tick: int) -> None:
        for row in rows[yes & np.isinf(self.fingers.begun[rows])].tolist():
            self.fingers.begun[row] = self.kept[row].begun = tick * self.period
            self.kept[row].pushed = self._gone(row)

    def check(self) -> None:
        """Look where it is due."""
        over = dict[int, str]()
        tick = self.tick
        for row in self.running.tolist():
            kept, lifted = self.kept[row], tick - int(self.lift[row])
            if lifted <= self.up and (tick % LOOK == 0 or lifted == self.up):
                self._touch(row, tick)
            if tick == self.way[row]:
                kept.carried = self._gone(row)
            if self.hold - self.force.samples < lifted <= self.hold:
                led = self.drive[row, (self.way[row] + lifted) * self.steps - 1, 2]
                pulled = self.spring * (led - self.slide[row]) - self.weight[row]
                kept.felt += pulled / self.force.samples
            if lifted in (self.up, self.hold, self.end) and (why := self._judged(row, lifted)) is not None:
                over[row] = why
            elif not np.abs(self.sims.body_position[row, self.bodies[row]]).max() < _FAR:
                over[row] = "diverged"
        self.stop(over)

    def _judged(self, row: int, lifted: int) -> str | None:
        """Why a trial is over at a moment at which the thing must be held: empty at its end, None where it goes on."""
        kept = self.kept[row]
        if lifted == self.up:
            kept.lifted = float(self.lift[row] + self.up) * self.period
        if not self._held(row):
            return {self.up: "not lifted", self.hold: "lost in the hold", self.end: "lost in the shake"}[lifted]
        if lifted == self.hold:
            kept.at_hold(*self.poses(row))
        if lifted == self.end:
            kept.at_end(*self.poses(row))
        return "" if lifted == self.end else None

    def _held(self, row: int) -> bool:
        touch = self.touch(row)
        rise = self.sims.body_position[row, self.bodies[row], 2] - self.setups[row].thing[2]
        return bool(touch["contact_force"].any() and not touch["on_table"][0] and rise >= self.force.rise)

    def _touch(self, row: int, tick: int) -> None:
        force = float(self.touch(row)["contact_force"].sum())
        kept = self.kept[row]
        kept.peak = max(kept.peak, force)
        self.touched[row] = max(self.touched[row], force)
        if tick <= self.way[row] and force > 0.0:
            kept.premature += LOOK * self.period
            kept.impulse += force * LOOK * self.period

    def _gone(self, row: int) -> float:
        """How far the thing is along the table from where it stood, m."""
        way = self.sims.body_position[row, self.bodies[row], :2] - self.setups[row].thing[:2]
        return float(np.linalg.norm(way))
