"""The loop of grasp trials side by side: simulations with a wrist and an object each, and which of them still run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.separate_models import SeparateModelBatch, layout
from allegro_twin.sim.contact.probe import ObjectProbe
from allegro_twin.sim.engine.backend import substeps
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

if TYPE_CHECKING:
    import mujoco

Result = TypeVar("Result")


class TrialLoop:
    """Trials in step, each bit for bit as if it were alone.

    In every period of control `observe` looks at all that run, `control` and `set_points` say what fingers and wrists
    are told, physics advances, and `check` looks again; the first and the last may `stop` trials. Arrays have a row for
    each trial in `running`. `objects`: the name of each trial's object. Raises ConfigError unless all models have one
    `layout`.
    """

    def __init__(
        self,
        spec: HandSpec,
        models: Sequence[mujoco.MjModel],
        objects: Sequence[str],
        period: float,
        threads: int = 0,
    ) -> None:
        self.spec, self.n, self.period, self._objects = spec, len(models), period, objects
        self.steps = substeps(period, models[0].opt.timestep)
        """Physics steps in a period."""
        self.sims = SeparateModelBatch(spec, models, threads=threads, period=period)
        self.palm = models[0].body("palm_link").id
        self.bodies = np.array([model.body(name).id for model, name in zip(models, objects, strict=True)])
        """Body indices of the objects, (n,)."""
        self.tick = 0
        """Periods that have passed."""
        self.running: Rows = np.arange(self.n)
        self.why = [""] * self.n
        """Why each trial was stopped."""

    def run(self) -> None:
        """Let periods pass until no trial runs."""
        while True:
            self.observe()
            if not len(self.running):
                return
            self.advance(self.control(), self.set_points())
            self.check()

    def observe(self) -> None:
        """Look at the trials that run, before a period."""

    def control(self) -> Array:
        """What the motors are told in the period that comes, (running, joints), as of `SeparateModelBatch.advance`."""
        raise NotImplementedError

    def set_points(self) -> Array:
        """Set-points of the wrists in every physics step of that period, (running, steps, 6)."""
        raise NotImplementedError

    def check(self) -> None:
        """Look at them after it."""

    def advance(self, control: Array, set_points: Array) -> None:
        """Let a period pass."""
        self.sims.advance(self.running, control, set_points, self.steps)
        self.tick += 1

    def stop(self, reasons: Mapping[int, str]) -> None:
        """End trials, for reasons that `why` keeps."""
        for row, reason in reasons.items():
            self.why[row] = reason
        if reasons:
            self.running = np.array([row for row in self.running if row not in reasons], dtype=np.int64)

    def poses(self, rows: Rows | int) -> tuple[Array, Array]:
        """Poses of palms and of objects in some trials: position, m, and quaternion, world, (..., 7)."""
        where, turned, bodies = self.sims.body_position, self.sims.body_quaternion, self.bodies[rows]
        palm, body = (np.concatenate([where[rows, k], turned[rows, k]], axis=-1) for k in (self.palm, bodies))
        return palm, body

    def touch(self, row: int) -> dict[str, Array]:
        """As `ObjectProbe.touch`, of one trial."""
        self.sims.look(row)
        return self._probes[row].touch()

    @cached_property
    def _probes(self) -> list[ObjectProbe]:
        data = self.sims.scratch
        named = zip(self.sims.models, self._objects, strict=True)
        return [ObjectProbe(model, data, self.spec, name) for model, name in named]


def in_layouts(models: Sequence[mujoco.MjModel], run: Callable[[list[int]], list[Result]]) -> list[Result]:
    """What `run` makes of each model, in order: it gets the numbers of all models of one layout at a time."""
    groups: dict[tuple[float, ...], list[int]] = {}
    for index, model in enumerate(models):
        groups.setdefault(layout(model), []).append(index)
    found: dict[int, Result] = {}
    for indices in groups.values():
        found |= dict(zip(indices, run(indices), strict=True))
    return [found[index] for index in range(len(models))]


def stacked(tables: Sequence[Array], steps: int) -> Array:
    """Set-points of wrists, (steps of each, 6), for so many steps, (n, steps, 6); after its last one each stays."""
    return np.stack([table[np.minimum(np.arange(steps), len(table) - 1)] for table in tables])
