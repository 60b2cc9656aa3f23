"""Objects for an evaluation that no training has seen: `python -m benchmarks.shapes [--count 10] [--seed 20261124]`.

Prints `held_out` of a recipe. For each: an object of the catalogue that the hand knows a scenario of, drawn without
replacement; round or edged as that one is, but drawn anew which (sphere or ellipsoid, cylinder or box); every dimension
that one's times a factor from 0.88 to 1.12 of its own; and its density. No policy is asked.
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from allegro_twin.learning.tasks.scenes import known_scenarios
from allegro_twin.sim.objects.catalogue import object_catalogue

SEED, FACTOR = 20261124, (0.88, 1.12)


def drawn(count: int, seed: int) -> list[dict[str, Any]]:
    """As a recipe has them, sizes in whole mm."""
    rng = np.random.default_rng(seed)
    templates = [name for name in known_scenarios() if name in object_catalogue()]
    return [_like(name, rng) for name in sorted(rng.choice(templates, count, replace=False).tolist())]


def _like(name: str, rng: np.random.Generator) -> dict[str, Any]:
    template = object_catalogue()[name]
    along = 2.0 * template.half_extents() * rng.uniform(*FACTOR, 3)
    round_one = template.shape in ("sphere", "ellipsoid")
    shape = str(rng.choice(["sphere", "ellipsoid"] if round_one else ["cylinder", "box"]))
    size = {"sphere": along[:1], "ellipsoid": along[[1, 0]], "cylinder": along[[0, 2]], "box": along}[shape]
    short = np.round(size, 3).tolist()
    mass = template.mass * _volume(shape, short) / _volume(template.shape, template.size)
    return {"name": f"new_{name}", "shape": shape, "size": short, "mass": round(mass, 3), "like": name}


def _volume(shape: str, size: Any) -> float:
    match shape, tuple(size):
        case "sphere", (d,):
            return math.pi / 6.0 * float(d) ** 3
        case "ellipsoid", (short, long):
            return math.pi / 6.0 * float(short * short * long)
        case "cylinder", (d, h):
            return math.pi / 4.0 * float(d * d * h)
        case _:
            return float(np.prod(size))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=SEED)
    asked = parser.parse_args()
    for each in drawn(asked.count, asked.seed):
        print("  {" + ", ".join(f"{name}: {value}" for name, value in each.items()) + "},")


if __name__ == "__main__":
    main()
