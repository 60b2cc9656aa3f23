"""Is what `nearest()` finds the nearest? Against bounded least squares from many starts, which knows `fk` alone.

`python -m benchmarks.nearest [--targets 40] [--seed 0] [--fingers index,thumb]` draws targets for both hands: one half
beside postures, off by 30 mm (σ), the other anywhere within 0.25 m. It prints by how much `nearest()` is further than
the best of the search's runs at most, m (below zero: it is nearer everywhere). The search (SciPy's `least_squares`)
starts at the 16 corners of the limits, in their middle, and at as many random postures as make 24.
"""

from __future__ import annotations

import argparse
from itertools import product

import numpy as np
from scipy.optimize import least_squares  # type: ignore[import-untyped]

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.spec import SIDES
from allegro_twin.types import Array

_STARTS = 24
_INSIDE = 1e-3  # Of a range: the search must not start on a limit.


def searched(finger: ClosedFormFinger, target: Array, random: np.random.Generator) -> float:
    """The least distance that any run ends at, m."""
    low, high, fk = finger.lower, finger.upper, finger.scalar.fk
    shares = np.array([*product((_INSIDE, 1.0 - _INSIDE), repeat=4), (0.5,) * 4])
    shares = np.vstack([shares, random.random((_STARTS - len(shares), 4))])

    def error(q: Array) -> Array:
        return np.subtract(fk(*q.tolist()), target)

    return min(
        float(np.linalg.norm(found.fun))
        for start in low + shares * (high - low)
        for found in [least_squares(error, start, bounds=(low, high), x_scale=0.1, xtol=1e-11, ftol=1e-13, gtol=1e-13)]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--targets", type=int, default=40, help="for each finger; half of them in either way")
    parser.add_argument("--fingers", default="index,middle,ring,thumb")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    print("hand, finger: targets, of these out of reach; further than the search at most, m; nearer at most, m")
    for side in SIDES:
        for finger in asked.fingers.split(","):
            solver, random = ClosedFormFinger(load_spec(side=side), finger), np.random.default_rng(asked.seed)
            half = asked.targets // 2
            postures = random.uniform(solver.lower, solver.upper, (half, 4))
            beside = solver.fk(postures).position + random.normal(0.0, 0.03, (half, 3))
            targets = np.vstack([beside, random.uniform(-0.25, 0.25, (asked.targets - half, 3))])
            ours = solver.ik(targets).nearest().distance
            excess = ours - np.array([searched(solver, target, random) for target in targets])
            print(
                f"{side} {finger}: {len(targets)}, {int((ours > 0.0).sum())}; {excess.max():.1e}; {-excess.min():.1e}",
                flush=True,
            )


if __name__ == "__main__":
    main()
