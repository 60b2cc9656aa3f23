"""Many trials side by side: each as if it were alone, bit for bit, at the cost of its physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from allegro_twin.controller import Controller
from allegro_twin.grasping.batch.position_control import Goals
from allegro_twin.grasping.batch.torque_control import Torques
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.verdict import Observations, Report, moved
from allegro_twin.safety import Limits, violation
from allegro_twin.sim.batch.simulations import Rows, Simulations, layout
from allegro_twin.sim.contact.probe import Probe
from allegro_twin.sim.engine.backend import substeps
from allegro_twin.types import Array, HandState, frozen

LOOK = 10
"""Periods from one look at the contacts to the next, from the reference on; also at the end of every phase."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a trial ended."""

    report: Report | None
    """None where it could not go on."""
    stopped: str = ""
    """Why."""
    mass: float = float("nan")
    """Of the object, kg."""
    measured: Mapping[str, float] = field(default_factory=dict)
    """What was asked for at the end of the first phase that checks; empty for a trial that was stopped before."""

    @property
    def held(self) -> bool:
        return self.report is not None and self.report.held


Measure: TypeAlias = Callable[[Trial, Any], Mapping[str, float]]
"""Told a trial and MuJoCo's data of it at the end of the first phase that checks."""


def together(
    trials: Sequence[Trial],
    controllers: Sequence[Controller[Any]],
    limits: Limits,
    *,
    threads: int = 0,
    measure: Measure | None = None,
    hasty: bool = False,
) -> list[Verdict]:
    """The verdicts of trials under a controller each, in their order. Motions are those of a trial alone, bit for bit;
    contacts are looked at every `LOOK` periods, so that mean forces differ in their last digits. `hasty`: a trial ends
    where its object has left the limits at a check, and has no report; for those who only want what holds."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for index, trial in enumerate(trials):
        groups.setdefault(layout(trial.backend.model), []).append(index)
    found: dict[int, Verdict] = {}
    for indices in groups.values():
        group = _Group([trials[i] for i in indices], [controllers[i] for i in indices], limits, threads, measure, hasty)
        found |= dict(zip(indices, group.run(), strict=True))
    return [found[index] for index in range(len(trials))]


class _Group:
    """Trials of one layout."""

    def __init__(
        self,
        trials: list[Trial],
        controllers: list[Controller[Any]],
        limits: Limits,
        threads: int,
        measure: Measure | None,
        hasty: bool,
    ) -> None:
        backends = [trial.backend for trial in trials]
        self.trials, self.limits, self.n = trials, limits, len(trials)
        self.spec, self.period = backends[0].spec, backends[0].period
        self.steps = substeps(self.period, backends[0].model.opt.timestep)
        self.sims = sims = Simulations(self.spec, [backend.model for backend in backends], threads, self.period)
        self.periods = np.array([round(trial.seconds / self.period) for trial in trials])
        most = int(self.periods.max()) + 1
        self._drive = _lasting([backend.drive for backend in backends], most * self.steps)
        self._push = np.zeros((self.n, most, 3))
        for row, backend in enumerate(backends):
            if backend.pushing is not None:
                self._push[row, : len(backend.pushing.force)] = backend.pushing.force
        self._bodies = np.array([t.backend.model.body(t.scenario.objects[0].name).id for t in trials])
        self._palm = backends[0].model.body("palm_link").id
        sims.place(np.array([backend.posture for backend in backends]))
        sims.begin(self._drive[:, 0])
        states = [self._state(row, 0) for row in range(self.n)]
        self._told = (
            Torques(controllers, states, limits)
            if sims.servos is None
            else Goals(controllers, states, limits, self.spec)
        )
        self._scratch = backends[0].data
        self._probes = [Probe(b.model, self._scratch, self.spec, t.scenario.objects[0].name)
                        for b, t in zip(backends, trials, strict=True)]  # fmt: skip
        self._looks = [{last, *(round(w.end / self.period) for w in trial.windows)}
                       for last, trial in zip(self.periods.tolist(), trials, strict=True)]  # fmt: skip
        checks = [next((w.end for w in trial.windows if w.check), trial.seconds) for trial in trials]
        self._moment = [round(end / self.period) for end in checks]
        self._begin = np.array([round(trial.begin / self.period) for trial in trials])
        self._judged = [_checked(trial, self.period) if hasty else frozenset[int]() for trial in trials]
        self._measure, self._measured = measure, [dict[str, float]() for _ in trials]
        self.palm, self.thing = np.empty((self.n, most, 7)), np.empty((self.n, most, 7))
        self.torque = np.empty((self.n, most, self.spec.n_joints))
        self.seen: list[list[dict[str, Array]]] = [[] for _ in trials]

    def run(self) -> list[Verdict]:
        stopped = [""] * self.n
        alive = np.arange(self.n)
        tick = 0
        while True:
            self._keep(alive, tick)
            alive = self._going_on(alive, tick, stopped)
            if not len(alive):
                break
            self._advance(alive, tick)
            tick += 1
            wrong = self._wrong(alive)
            if len(wrong):
                for row in wrong.tolist():
                    stopped[row] = self._stopped(row)
                alive = np.array([row for row in alive if not stopped[row]], dtype=np.int64)
        return [
            Verdict(
                None if stopped[row] else self.trials[row].judged(self._observed(row)),
                stopped[row],
                self.trials[row].mass,
                self._measured[row],
            )
            for row in range(self.n)
        ]

    def _going_on(self, rows: Rows, tick: int, stopped: list[str]) -> Rows:
        """Those that are not at their end yet, and not lost where somebody asked for haste."""
        rows = rows[self.periods[rows] > tick]
        judged = [row for row in rows.tolist() if tick in self._judged[row]]
        if judged:
            for row, why in zip(judged, self._lost(np.array(judged), tick), strict=True):
                stopped[row] = why
            rows = np.array([row for row in rows if not stopped[row]], dtype=np.int64)
        return rows

    def _advance(self, rows: Rows, tick: int) -> None:
        told = self._told(rows, tick * self.period, self.sims, lambda row: self._state(row, tick))
        first = tick * self.steps
        self.sims.push[rows, self._bodies[rows], :3] = self._push[rows, tick]
        self.sims.advance(rows, told, self._drive[rows, first : first + self.steps], self.steps)

    def _wrong(self, rows: Rows) -> Rows:
        """Of some rows those that may have to stop."""
        position, velocity = self.sims.position[rows], self.sims.velocity[rows]
        if np.isfinite(position.sum()) and (np.abs(velocity) <= self.limits.velocity).all():
            return rows[:0]
        fine = np.isfinite(position).all(axis=1) & (np.abs(velocity) <= self.limits.velocity).all(axis=1)
        wrong: Rows = rows[~fine]
        return wrong

    def _stopped(self, row: int) -> str:
        if not np.isfinite(self.sims.position[row].sum()):
            return "the simulation diverged"
        if (np.abs(self.sims.velocity[row]) > self.limits.velocity).any():
            return violation(self._state(row, 0), self.limits, self.spec) or ""
        return ""

    def _lost(self, rows: Rows, tick: int) -> list[str]:
        """Why each of some trials cannot be held any more; empty where it may be."""
        rules = [self.trials[row].rule for row in rows]
        palm, thing, start = self.palm, self.thing, self._begin[rows]
        drift, rotation = moved(palm[rows, start], thing[rows, start], palm[rows, tick], thing[rows, tick])
        return [
            f"moved {d * 1000:.1f} mm and {r:.1f}° in the hand" if d > rule.drift or r > rule.rotation else ""
            for d, r, rule in zip(drift, rotation, rules, strict=True)
        ]

    def _state(self, row: int, tick: int) -> HandState:
        sims = self.sims
        unknown = frozen(np.full(self.spec.n_actuators, np.nan))
        return HandState(
            tick * self.period, tick, frozen(sims.position[row]), frozen(sims.velocity[row]), frozen(sims.torque[row]),
            unknown, frozen(sims.gravity[row]),
        )  # fmt: skip

    def _keep(self, rows: Rows, tick: int) -> None:
        sims = self.sims
        self.palm[rows, tick, :3] = sims.body_position[rows, self._palm]
        self.palm[rows, tick, 3:] = sims.body_quaternion[rows, self._palm]
        self.thing[rows, tick, :3] = sims.body_position[rows, self._bodies[rows]]
        self.thing[rows, tick, 3:] = sims.body_quaternion[rows, self._bodies[rows]]
        self.torque[rows, tick] = sims.torque[rows]
        for row in rows.tolist():
            if tick not in self._looks[row] and (tick % LOOK or tick < self._begin[row]):
                continue
            sims.look(row, self._scratch)
            self.seen[row].append(self._probes[row].touch() | {"tick": np.array([tick])})
            self.trials[row].feel(tick * self.period, self._scratch)
            if self._measure is not None and tick == self._moment[row]:
                self._measured[row] |= self._measure(self.trials[row], self._scratch)

    def _observed(self, row: int) -> Observations:
        count = int(self.periods[row]) + 1
        looks = self.seen[row]
        last = np.searchsorted([int(look["tick"][0]) for look in looks], np.arange(count), side="right") - 1
        last = np.maximum(last, 0)  # Before the first nobody asks.

        def column(name: str) -> Array:
            return np.array([look[name] for look in looks])[last]

        t: Array = self.period * np.arange(count, dtype=np.float64)
        return Observations(
            t, self.palm[row, :count], self.thing[row, :count], column("contact_force"),
            column("on_table")[:, 0], column("contacts")[:, 0], column("penetration")[:, 0], self.torque[row, :count],
        )  # fmt: skip


def _lasting(drives: Sequence[Array], steps: int) -> Array:
    """The set-points of so many steps, (n, steps, 6); after its last one each wrist stays."""
    return np.stack([drive[np.minimum(np.arange(steps), len(drive) - 1)] for drive in drives])


def _checked(trial: Trial, period: float) -> frozenset[int]:
    """The periods at which a trial's limits hold: the ends of phases that check, or all along them."""
    ends = {round(window.end / period) for window in trial.windows if window.check}
    if trial.rule.throughout:
        for window in trial.windows:
            if window.check:
                ends |= set(range(round(window.begin / period) + LOOK, round(window.end / period), LOOK))
    return frozenset(ends)
