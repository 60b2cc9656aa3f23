"""What a period costs through the wire of a hand that answers when asked, as a multiple of the simulation alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import perf_counter

import numpy as np

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.types import PositionCommand
from benchmarks.servo_line import PERIODS, Figure, ratio

HANDS = {"qb_softhand": "qb", "sih": "schunk"}


def figures() -> Iterator[Figure]:
    for hand, kind in HANDS.items():
        for period in (0.02, 0.01):
            found, sim, line = ratio(timer(hand, "sim", period), timer(hand, kind, period))
            yield f"{1000 * period:.0f} ms through the wire of a {hand} ({sim:.0f} → {line:.0f} µs)", found, 2.5, "x"


def timer(hand: str, kind: str, period: float) -> Callable[[], float]:
    """Write and read, without controller and guard, a little further each time."""
    rig = assemble(
        RunConfig.model_validate(
            {
                "hand": {"model": hand},
                "backend": {"kind": kind} | ({} if kind == "sim" else {"port": "virtual"}),
                "controller": {"kind": "position"},
                "period": period,
            }
        )
    )
    inner = rig.driver
    spec = rig.spec
    middle, width = 0.3 * (spec.lower + spec.upper), 0.05 * (spec.upper - spec.lower)
    inner.reset()

    def timed() -> float:
        begin = perf_counter()
        for k in range(PERIODS):
            inner.write(PositionCommand(middle + width * np.sin(0.05 * k + np.arange(float(spec.n_actuators)))))
            inner.read()
        return (perf_counter() - begin) / PERIODS

    return timed


if __name__ == "__main__":
    for what, measured, bar, unit in figures():
        print(f"{what:<84}{measured:>8.2f} {unit:<2}{bar:>6} {unit}")
