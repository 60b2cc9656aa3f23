"""Many trials side by side: each as if it were alone, bit for bit, at the cost of its physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from allegro_twin.controller import Controller
from allegro_twin.grasping.batch.batched_control import BatchedControllers
from allegro_twin.grasping.batch.trial_loop import TrialLoop, in_layouts, stacked
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.verdict import Observations, TrialReport, relative_displacement
from allegro_twin.safety import Limits, violation
from allegro_twin.sim.batch.core import Rows
from allegro_twin.types import Array, HandState, frozen

LOOK = 10
"""Periods from one look at the contacts to the next, from the reference on; also at the end of every phase, and only
there in haste where nobody asks for the type."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Outcome of a trial."""

    report: TrialReport | None
    """None where it could not go on."""
    stopped: str = ""
    """Why."""
    mass: float = float("nan")
    """Mass of the object, kg."""
    measured: Mapping[str, float] = field(default_factory=dict)
    """What was asked for at the end of the first phase that checks; empty for a trial that was stopped before."""
    too_fast: bool = False
    """Whether a joint's speed stopped it."""

    @property
    def held(self) -> bool:
        return self.report is not None and self.report.held


LOST_BEFORE = "lost under another push"
"""Why a trial ends that would have gone on."""


class _Fork(NamedTuple):
    """Instant at which a trial parts from one that it is like."""

    tick: int
    of: int
    """Its row."""


Measure: TypeAlias = Callable[[Trial, Any], Mapping[str, float]]
"""Told a trial and MuJoCo's data of it at the end of the first phase that checks."""


def run_trials(
    trials: Sequence[Trial],
    controllers: Sequence[Controller[Any]],
    limits: Limits,
    *,
    threads: int = 0,
    measure: Measure | None = None,
    stop_early: bool = False,
    stems: Sequence[int] | None = None,
) -> list[Verdict]:
    """The verdicts of trials under a controller each, in their order. Motions are those of a trial alone, bit for bit;
    contacts are looked at every `LOOK` periods, so that mean forces differ in their last digits. `stop_early`: a trial
    ends where its object has left the limits at a check, and has no report; for those who only want what holds.
    `stems`: a number for each; trials of one number are alike but for what pushes the object, so that one of them is
    simulated until the first push or check, and the others from there on. Of these `stop_early` ends all with the first
    that is lost."""
    stems = range(len(trials)) if stems is None else stems

    def of_layout(indices: list[int]) -> list[Verdict]:
        group = [trials[i] for i in indices], [controllers[i] for i in indices], [stems[i] for i in indices]
        return _JudgedTrials(*group, limits, threads, measure, stop_early).verdicts()

    return in_layouts([trial.backend.model for trial in trials], of_layout)


class _JudgedTrials(TrialLoop):
    """Trials of one layout."""

    def __init__(
        self,
        trials: list[Trial],
        controllers: list[Controller[Any]],
        stems: list[int],
        limits: Limits,
        threads: int,
        measure: Measure | None,
        stop_early: bool,
    ) -> None:
        backends, names = [trial.backend for trial in trials], [trial.scenario.objects[0].name for trial in trials]
        super().__init__(backends[0].spec, [each.model for each in backends], names, backends[0].period, threads)
        self.trials, self.limits = trials, limits
        self.periods = np.array([round(trial.seconds / self.period) for trial in trials])
        most = int(self.periods.max()) + 1
        self._drive = stacked([backend.drive for backend in backends], most * self.steps)
        self._push = np.zeros((self.n, most, 3))
        for row, backend in enumerate(backends):
            if backend.pushing is not None:
                self._push[row, : len(backend.pushing.force)] = backend.pushing.force
        self.sims.place(self.running, np.array([backend.posture for backend in backends]))
        self.sims.begin(self._drive[:, 0])
        states = [self._state(row) for row in range(self.n)]
        self._controllers = BatchedControllers(controllers, states, limits, self.sims)
        self._looks = [{last, *(round(w.end / self.period) for w in trial.windows)}
                       for last, trial in zip(self.periods.tolist(), trials, strict=True)]  # fmt: skip
        checks = [next((w.end for w in trial.windows if w.check), trial.seconds) for trial in trials]
        self._moment = [round(end / self.period) for end in checks]
        self._begin = np.array([round(trial.begin / self.period) for trial in trials])
        self._judged = [_checked(trial, self.period) if stop_early else frozenset[int]() for trial in trials]
        self._closely = [trial.typed or not stop_early for trial in trials]
        self._measure, self._measured = measure, [dict[str, float]() for _ in trials]
        self._poses = np.empty((2, self.n, most, 7))
        """Poses of palms and objects."""
        self._torque = np.empty((self.n, most, self.spec.n_joints))
        self._seen: list[list[dict[str, Array]]] = [[] for _ in trials]
        self._stems, self._stop_early = np.array(stems), stop_early
        self._waiting = self._forks()
        self._too_fast = set[int]()
        self.running = np.array([row for row in self.running.tolist() if row not in self._waiting])

    def verdicts(self) -> list[Verdict]:
        self.run()
        found = []
        for row, (trial, why) in enumerate(zip(self.trials, self.why, strict=True)):
            report = None if why else trial.judged(self._observed(row))
            found.append(Verdict(report, why, trial.mass, self._measured[row], row in self._too_fast))
        return found

    def observe(self) -> None:
        """Keep what a verdict needs; stop what is at its end, and what is lost where somebody wants to know early."""
        rows, tick = self.running, self.tick
        self._poses[:, rows, tick] = self.poses(rows)
        self._torque[rows, tick] = self.sims.applied_torque[rows]
        for row in rows.tolist():
            if tick in self._looks[row] or (self._closely[row] and tick % LOOK == 0 and tick >= self._begin[row]):
                self._look(row)
        self.running = rows[self.periods[rows] > tick]
        if judged := [row for row in self.running.tolist() if tick in self._judged[row]]:
            lost = zip(judged, self._lost(np.array(judged)), strict=True)
            self.stop({row: why for row, why in lost if why})

    def control(self) -> Array:
        told = self._controllers(self.running, self.tick * self.period, self._state)
        joining = [row for row, fork in self._waiting.items() if fork.tick == self.tick]
        return self._join(np.array(joining), told) if joining else told

    def stop(self, reasons: Mapping[int, str]) -> None:
        """What waits for one that is stopped would have been stopped as well."""
        same = {row: reasons[fork.of] for row, fork in self._waiting.items() if fork.of in reasons}
        tied = np.isin(self._stems, self._stems[list(reasons)]) if self._stop_early else np.zeros(self.n, dtype=bool)
        others = dict.fromkeys(self.running[tied[self.running]].tolist(), LOST_BEFORE)
        self._waiting = {row: fork for row, fork in self._waiting.items() if row not in same}
        super().stop(others | same | dict(reasons))

    def set_points(self) -> Array:
        rows, first = self.running, self.tick * self.steps
        self.sims.push[rows, self.bodies[rows], :3] = self._push[rows, self.tick]
        return self._drive[rows, first : first + self.steps]

    def check(self) -> None:
        """Stop what has diverged or is too fast."""
        rows = self.running
        position, velocity = self.sims.position[rows], self.sims.velocity[rows]
        if np.isfinite(position.sum()) and (np.abs(velocity) <= self.limits.velocity).all():
            return
        finite, slow = np.isfinite(position).all(axis=1), (np.abs(velocity) <= self.limits.velocity).all(axis=1)
        fast = rows[finite & ~slow].tolist()
        self._too_fast |= {*fast, *(row for row, fork in self._waiting.items() if fork.of in fast)}
        self.stop({row: self._stopped(row) for row in rows[~(finite & slow)].tolist()})

    def _forks(self) -> dict[int, _Fork]:
        """Which trials join later."""
        forks, first = dict[int, _Fork](), dict[int, int]()
        for row, (stem, trial) in enumerate(zip(self._stems.tolist(), self.trials, strict=True)):
            of = first.setdefault(stem, row)
            begins = [round(window.begin / self.period) for window in trial.windows if window.check]
            apart = np.flatnonzero((self._push[row] != self._push[of]).any(axis=1))
            # What a body's place is in the world is known after a step: the last one before they differ is its own.
            tick = min([int(self.periods[row]), *begins, *apart[:1].tolist()]) - 1
            if of != row and tick > 0:
                forks[row] = _Fork(tick, of)
        return forks

    def _join(self, rows: Rows, told: Array) -> Array:
        """Let trials run on from where those are that they have been like so far; what all are told, (running,
        joints)."""
        of = np.array([self._waiting.pop(row).of for row in rows.tolist()])
        self.sims.copy(rows, of)
        self._controllers.copy(rows, of)
        self._poses[:, rows], self._torque[rows] = self._poses[:, of], self._torque[of]
        for row, other in zip(rows.tolist(), of.tolist(), strict=True):
            self._seen[row] = list(self._seen[other])
        told = np.concatenate([told, told[np.searchsorted(self.running, of)]])
        running = np.concatenate([self.running, rows])
        order = np.argsort(running)
        self.running = running[order]
        return told[order]

    def _look(self, row: int) -> None:
        self._seen[row].append(self.touch(row) | {"tick": np.array([self.tick])})
        self.trials[row].feel(self.tick * self.period, self.sims.scratch)
        if self._measure is not None and self.tick == self._moment[row]:
            self._measured[row] |= self._measure(self.trials[row], self.sims.scratch)

    def _stopped(self, row: int) -> str:
        if not np.isfinite(self.sims.position[row]).all():
            return "the simulation diverged"
        return str(violation(self._state(row), self.limits, self.spec))

    def _lost(self, rows: Rows) -> list[str]:
        """Why each of some trials cannot be held any more; empty where it may be."""
        rules, (palm, body) = [self.trials[row].rule for row in rows], self._poses
        start = self._begin[rows]
        drift, rotation = relative_displacement(
            palm[rows, start], body[rows, start], palm[rows, self.tick], body[rows, self.tick]
        )
        return [
            f"moved {d * 1000:.1f} mm and {r:.1f}° in the hand" if d > rule.drift or r > rule.rotation else ""
            for d, r, rule in zip(drift, rotation, rules, strict=True)
        ]

    def _state(self, row: int) -> HandState:
        sims = self.sims
        unknown = frozen(np.full(self.spec.n_actuators, np.nan))
        return HandState(
            self.tick * self.period, self.tick, frozen(sims.position[row]), frozen(sims.velocity[row]),
            frozen(sims.applied_torque[row]), unknown, frozen(sims.gravity[row]),
        )  # fmt: skip

    def _observed(self, row: int) -> Observations:
        count, looks = int(self.periods[row]) + 1, self._seen[row]
        last = np.searchsorted([int(look["tick"][0]) for look in looks], np.arange(count), side="right") - 1
        last = np.maximum(last, 0)  # Before the first nobody asks.

        def column(name: str) -> Array:
            return np.array([look[name] for look in looks])[last]

        t: Array = self.period * np.arange(count, dtype=np.float64)
        palm, body = self._poses[:, row, :count]
        return Observations(
            t, palm, body, column("contact_force"), column("on_table")[:, 0], column("contacts")[:, 0],
            column("penetration")[:, 0], self._torque[row, :count],
        )  # fmt: skip


def _checked(trial: Trial, period: float) -> frozenset[int]:
    """The periods at which a trial's limits hold: the ends of phases that check, or all along them."""
    ends = {round(window.end / period) for window in trial.windows if window.check}
    if trial.rule.throughout:
        for window in trial.windows:
            if window.check:
                ends |= set(range(round(window.begin / period) + LOOK, round(window.end / period), LOOK))
    return frozenset(ends)
