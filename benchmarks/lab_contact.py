"""How hard the cell's arms meet the table: the true forces of the simulation, with and without the contact reflex.

`python -m benchmarks.lab_contact [--config lab_allegro …] [--speeds 0.05 0.1 0.2 0.3]` prints the table of
docs/results/arm.md. The hand goes straight down from where it waits at a steady speed, on the cell's spring, until
the arm stops by itself or the set-point is 0.3 m in the table. Forces are those of the flange's sensor at every
millisecond, without noise and with the hand's weight: the peak, the peak behind a low-pass filter of 100 Hz, and the
peak from 5 ms after the first touch on.
"""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.assembly import Cell, make_cell
from allegro_twin.cell.motion.arm_motion import ArmGuide, Straight
from allegro_twin.cell.motion.finger_paths import SteeredReference, finger_controller
from allegro_twin.cell.run import arm_controller
from allegro_twin.cell.settings import LabSettings
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.errors import ArmReflex, HandError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import run
from allegro_twin.types import Array

_BEGINS, _DEEP = 0.3, 0.3  # s until it moves, and m of the set-point below the table at most.
_AFTER = 0.5  # s that are watched after a stop.
_FILTER, _IMPACT = 100.0, 0.005  # Hz and s.
_ASIDE = (0.3, 0.35)  # m: where the thing stands meanwhile.
CONFIGS = ("lab_allegro", "lab_leap", "lab_model_o", "lab_sih", "lab_qb_softhand")


class Touch(NamedTuple):
    """One encounter with the table."""

    peak: float
    """N."""
    filtered: float
    later: float
    last: float
    delay: float
    """From the first touch to the stop, s; NaN where nothing stopped."""
    end: str


class _Probe:
    """A member of the world that reads the flange's force and the touch of the table at every step."""

    substeps, every_step = 1, False

    def __init__(self, cell: Cell) -> None:
        self._world, model = cell.robot.world, cell.robot.world.model
        sensor = model.sensor(f"{cell.robot.spec.flange}_force")
        self._force = slice(int(sensor.adr[0]), int(sensor.adr[0]) + 3)
        self._table = model.geom("table").id
        self._own = int(model.body_rootid[model.body(cell.robot.spec.root).id])
        self.rows: list[tuple[float, float]] = []
        self.touched: float | None = None

    def lay(self) -> None: ...

    def before_step(self, step: int) -> None: ...

    def begin_period(self) -> None:
        data, model, t = self._world.data, self._world.model, self._world.steps * 1e-3
        self.rows.append((t, float(np.linalg.norm(data.sensordata[self._force]))))
        if self.touched is None and data.ncon:
            pairs = data.contact.geom[(data.contact.geom == self._table).any(axis=1)]
            roots = model.body_rootid[model.geom_bodyid[pairs]]
            if (roots == self._own).any():
                self.touched = t


def touch_table(config: str, speed: float, reflex: bool) -> Touch:
    """Go down onto the table at a speed, m/s."""
    settings = load_settings(LabSettings, data_root() / "conf" / f"{config}.yaml")
    aside = settings.objects[0].model_copy(update={"at": _ASIDE})
    arm = settings.arm if reflex else settings.arm.model_copy(update={"collision": None})
    cell = make_cell(settings.model_copy(update={"objects": (aside,), "arm": arm}))
    probe, model = _Probe(cell), cell.robot.model
    cell.robot.world.join(probe)
    guide, home = ArmGuide(cell.posture, model), model.pose(cell.posture)
    guide.let_go()
    arms = run(cell.arm, arm_controller(cell, guide))
    reference = SteeredReference(SmoothSetpoint(cell.open))
    hands = run(cell.hand, finger_controller(reference, settings.hand.gains, cell.hand.spec, cell.model))
    t, stopped, end = 0.0, math.inf, ""
    while t < stopped + _AFTER:
        try:
            if not end:
                t = next(arms).state.t
                deep = 0.0 if probe.touched is None else speed * (t - probe.touched)
                goal = Pose(home.position - [0.0, 0.0, max(t - _BEGINS, 0.0) * speed], home.rotation)
                guide.target.move(goal)
                guide.line = Straight(goal, goal, t, 1.0)
                if deep > _DEEP:
                    break
            t = next(hands).state.t
        except HandError as error:
            if end:
                break
            stopped, end = cell.robot.world.steps * 1e-3, error.name if isinstance(error, ArmReflex) else str(error)
    cell.close()
    return _measured(np.array(probe.rows), probe.touched, stopped, end)


def _measured(rows: Array, touched: float | None, stopped: float, end: str) -> Touch:
    if touched is None:
        return Touch(math.nan, math.nan, math.nan, math.nan, math.nan, end or "not touched")
    force = rows[rows[:, 0] >= touched - 1.5e-3, 1]
    smooth, filtered, share = force[0], [], 1.0 - math.exp(-2.0 * math.pi * _FILTER * 1e-3)
    for each in force:
        smooth += share * (each - smooth)
        filtered.append(smooth)
    later = force[round(1e3 * _IMPACT) :].max()
    delay = stopped - touched if math.isfinite(stopped) else math.nan
    return Touch(force.max(), max(filtered), later, force[-1], delay, end)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--config", nargs="+", default=CONFIGS)
    parser.add_argument("--speeds", nargs="+", type=float, default=[0.05, 0.1, 0.2, 0.3])
    asked = parser.parse_args()
    print("| hand | m/s | reflex | peak, N | at 100 Hz | after 5 ms | at the end | stops after, ms | by |")
    print("|---|---|---|---|---|---|---|---|---|")
    for config in asked.config:
        for speed in asked.speeds:
            for reflex in (True, False):
                t = touch_table(config, speed, reflex)
                numbers = " | ".join(f"{value:.0f}" for value in (t.peak, t.filtered, t.later, t.last, 1e3 * t.delay))
                print(
                    f"| {config[4:]} | {speed:g} | {'yes' if reflex else 'no'} | {numbers} | {t.end[:60]} |", flush=True
                )


if __name__ == "__main__":
    main()
