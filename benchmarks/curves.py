"""Learning curves as pictures: `python -m benchmarks.curves conf/policies/reach_right.csv docs/images/reach.png`.

Needs matplotlib, which nothing else here does.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np

WINDOW = 8  # Updates that a point of the curve averages over.


def draw(source: Path, target: Path) -> None:
    """Success rate and return over the actions taken; dots are the evaluations without noise on the actions."""
    from matplotlib.figure import Figure

    with source.open(newline="") as file:
        rows = list(csv.DictReader(file))
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    for axes, name in zip(figure.subplots(1, 2), ("success", "return"), strict=True):
        told = [row for row in rows if row[name]]
        steps = np.array([int(row["steps"]) for row in told]) / 1e6
        values = np.array([float(row[name]) for row in told])
        weights = np.array([float(row["episodes"]) for row in told])
        mean = _smooth(values * weights) / _smooth(weights)
        axes.plot(steps, values, color="0.8", linewidth=0.8)
        axes.plot(steps, mean, color="C0", label="while trying out")
        axes.set_xlabel("actions, millions")
        axes.set_ylabel(name)
        axes.grid(alpha=0.3)
        if name == "success":
            done = [row for row in rows if row["evaluated"]]
            places = [int(row["steps"]) / 1e6 for row in done]
            axes.plot(places, [float(row["evaluated"]) for row in done], "o", color="C1", label="evaluated")
            axes.set_ylim(0.0, 1.0)
            axes.legend(loc="lower right")
    minutes = float(rows[-1]["seconds"]) / 60
    figure.suptitle(f"{source.stem}: {int(rows[-1]['steps']):,} actions in {minutes:.0f} min")
    figure.savefig(target, dpi=90)


def _smooth(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.convolve(values, np.ones(WINDOW), mode="full")[: len(values)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("curve", type=Path, help="a training's curve.csv")
    parser.add_argument("picture", type=Path, help="the .png to write")
    given = parser.parse_args()
    draw(given.curve, given.picture)
