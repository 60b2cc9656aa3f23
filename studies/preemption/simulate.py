"""Trials of one hand side by side: what the arm does, when the hand closes, and what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from allegro_twin.sim.batch.simulations import Rows, Simulations, layout
from allegro_twin.sim.contact.probe import Probe
from allegro_twin.sim.engine.backend import substeps
from allegro_twin.sim.engine.world import World
from allegro_twin.types import Array
from studies.preemption.fingers import Fingers
from studies.preemption.measures import Measures
from studies.preemption.policies import Seen, Yes, begins, due
from studies.preemption.scenes import Bench, Setup, servo_of

LOOK = 2
"""Periods from one look at the contacts to the next, until the thing is up."""
_FAR = 10.0
"""m. Where nothing is that has not diverged."""


def together(bench: Bench, setups: Sequence[Setup]) -> list[dict[str, Any]]:
    """The rows of some trials, in their order; none depends on which others there are."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, setup in enumerate(setups):
        groups.setdefault((*layout(setup.model), setup.model.opt.timestep), []).append(index)
    found: dict[int, dict[str, Any]] = {}
    for indices in groups.values():
        found |= dict(zip(indices, _Group(bench, [setups[i] for i in indices]).run(), strict=True))
    return [found[index] for index in range(len(setups))]


class _Group:
    """Trials of one layout."""

    def __init__(self, bench: Bench, setups: Sequence[Setup]) -> None:
        study = self.study = bench.study
        self.setups, self.n, self.period = setups, len(setups), study.period
        self.motion, self.rest, self.check = study.motion, study.arm.rest, study.check
        model = setups[0].model
        self.steps = substeps(self.period, model.opt.timestep)
        self.sims = Simulations(bench.spec, [setup.model for setup in setups], 1, self.period)
        self.fingers = Fingers([s.grasp for s in setups], self.motion, bench.gains, bench.gravity, bench.limits)
        self.bodies = np.array([s.model.body(s.job.case.object).id for s in setups])
        self.palm = model.body("palm_link").id
        place = model.joint(setups[0].job.case.object).qposadr[0]
        self.sims.place(self.fingers.open)
        self.sims.joint(setups[0].job.case.object)[:] = np.array([setup.thing for setup in setups])
        assert all(s.model.joint(s.job.case.object).qposadr[0] == place for s in setups)
        longest = max(len(setup.drive) for setup in setups)
        self.drive = np.stack([s.drive[np.minimum(np.arange(longest), len(s.drive) - 1)] for s in setups])
        self.sims.begin(self.drive[:, 0])
        self.slide, self.spring = self.sims.joint("wrist_z"), servo_of(study.arm, 0.0).stiffness[2]
        self.arrival = np.array([setup.job.case.approach for setup in setups])
        self.way = np.array([round(t / self.period) for t in self.arrival])
        up, hold, end = np.cumsum([round(t / self.period) for t in self._after()])
        self.up, self.hold, self.end = int(up), int(hold), int(end)
        self.lift = np.full(self.n, np.iinfo(np.int64).max)
        """In which period the arm begins to lift."""
        self.goal = np.array([setup.goal for setup in setups])
        self.touched, self.width = np.zeros(self.n), np.array([setup.width for setup in setups])
        self.sigma = np.array([setup.job.case.sigma for setup in setups])
        self.phase = np.array([setup.job.case.phase for setup in setups])
        self.weight = np.array([setup.weight for setup in setups])
        self.before = self.sims.body_position[:, self.palm].copy()
        self.scratch = World(model).data
        self.probes = [Probe(s.model, self.scratch, bench.spec, s.job.case.object) for s in setups]
        self.kept = [Measures() for _ in setups]

    def _after(self) -> tuple[float, float, float]:
        return self.motion.lifting, self.motion.hold, self.motion.shaking

    def run(self) -> list[dict[str, Any]]:
        rows, tick = np.arange(self.n), 0
        while len(rows):
            self._decide(rows, tick)
            told = self.fingers(rows, tick * self.period, self.sims)
            self.sims.advance(rows, told, self._led(rows, tick), self.steps)
            tick += 1
            rows = self._watch(rows, tick)
        return [kept.row(setup, self.check, self.motion.close)
                for kept, setup in zip(self.kept, self.setups, strict=True)]  # fmt: skip

    def _led(self, rows: Rows, tick: int) -> Array:
        """The arm's set-points of one period, (rows, steps, 6): on its way, waiting at its end, or lifting."""
        lifting = tick >= self.lift[rows]
        place = np.where(lifting, self.way[rows] + tick - np.where(lifting, self.lift[rows], 0), tick)
        waits = ~lifting & (tick >= self.way[rows])
        steps = place[:, None] * self.steps + np.arange(self.steps)
        steps = np.where(waits[:, None], (self.way[rows] * self.steps - 1)[:, None], steps)
        return np.asarray(self.drive[rows[:, None], np.minimum(steps, self.drive.shape[1] - 1)])

    def _decide(self, rows: Rows, tick: int) -> None:
        """Which hands begin to close, and which arms begin to lift."""
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
                self.lift[row], self.kept[row].marks["lift"] = tick, self._poses(row)

    def _begin(self, rows: Rows, yes: Yes, tick: int) -> None:
        for row in rows[yes & np.isinf(self.fingers.begun[rows])].tolist():
            self.fingers.begun[row] = self.kept[row].begun = tick * self.period
            self.kept[row].pushed = self._gone(row)

    def _watch(self, rows: Rows, tick: int) -> Rows:
        """Look where it is due; those that go on."""
        over = []
        height = self.slide[:, 0]
        for row in rows.tolist():
            kept, lifted = self.kept[row], tick - self.lift[row]
            if lifted <= self.up and (tick % LOOK == 0 or lifted == self.up):
                self._touch(row, tick)
            if tick == self.way[row]:
                kept.carried = self._gone(row)
            if self.hold - self.check.samples < lifted <= self.hold:
                led = self.drive[row, (self.way[row] + lifted) * self.steps - 1, 2]
                pulled = self.spring * (led - height[row]) - self.weight[row]
                kept.felt += pulled / self.check.samples
            if lifted in (self.up, self.hold, self.end) and self._judged(row, lifted):
                over.append(row)
            elif not np.abs(self.sims.body_position[row, self.bodies[row]]).max() < _FAR:
                kept.why = "diverged"
                over.append(row)
        return rows if not over else np.setdiff1d(rows, over)

    def _judged(self, row: int, lifted: int) -> bool:
        """Whether a trial is over at a moment at which the thing must be held."""
        kept = self.kept[row]
        if lifted == self.up:
            kept.lifted = float(self.lift[row] + self.up) * self.period
        if not self._held(row):
            names = {self.up: "not lifted", self.hold: "lost in the hold", self.end: "lost in the shake"}
            kept.why = names[lifted]
            return True
        if lifted == self.hold:
            kept.at_hold(*self._poses(row))
        if lifted == self.end:
            kept.at_end(*self._poses(row))
        return lifted == self.end

    def _held(self, row: int) -> bool:
        self.sims.look(row, self.scratch)
        touch = self.probes[row].touch()
        rise = self.sims.body_position[row, self.bodies[row], 2] - self.setups[row].thing[2]
        return bool(touch["contact_force"].any() and not touch["on_table"][0] and rise >= self.check.rise)

    def _touch(self, row: int, tick: int) -> None:
        self.sims.look(row, self.scratch)
        force = float(self.probes[row].touch()["contact_force"].sum())
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

    def _poses(self, row: int) -> tuple[Array, Array]:
        where, turned = self.sims.body_position[row], self.sims.body_quaternion[row]
        palm, body = self.palm, self.bodies[row]
        return np.concatenate([where[palm], turned[palm]]), np.concatenate([where[body], turned[body]])
