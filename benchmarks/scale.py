"""What evaluating many grasps takes: `python -m benchmarks.scale docs/results/scale.md` makes the tables of that page.

`--sizes 100 1000 10000` takes other sizes for the curve; 10,000 trials are some 20 minutes of two cores.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from allegro_twin.grasping.batch.trials import run_cases
from allegro_twin.grasping.evaluation.campaign import JUDGE
from allegro_twin.grasping.uncertainty import Uncertainty, sample_perturbations
from allegro_twin.sim.engine.backend import ENGINE
from allegro_twin.sweep.jobs import Sweep
from allegro_twin.sweep.local import Local
from allegro_twin.sweep.processors import core_count
from allegro_twin.sweep.runner import run
from allegro_twin.sweep.store import Store

BRIEF = """version: 1
floating: true
physics: {gravity: [0, 0, 0]}
phases:
  - {name: close, seconds: 0.15, hand: close}
  - {name: squeeze, seconds: 0.15, hand: squeeze}
  - {name: push, seconds: 0.15, push: [10, 0, 0], check: true}
reference: squeeze
"""
"""A trial of half a second: what grows with the number of trials shows the sooner."""
SIZES, UNIT = (100, 1000), 32
PROTOCOLS, SAMPLE = ("quick", "fc", "table_pick"), 12
ROWS, WIDE = (1_000, 10_000, 100_000), 40
"""Of the sweep without physics; columns of its rows, some more than those of an evaluation."""
MACHINES = {"2 cores": 2, "a node of 64": 64, "100 nodes of 64": 6400}
RAY = 0.95
"""Throughput on a Ray cluster over that of processes here (python -m benchmarks.sweeping; bar 0.90)."""


class Run(NamedTuple):
    """One sweep in programs of its own."""

    n: int
    wall: float
    """s, with start-up."""
    cpu: float
    """s of all processes."""
    worker: float
    """Peak memory of the largest process that computes, MB."""
    program: float
    """Of the program that keeps the results, MB."""


def noted(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows as wide as those of a trial, of nothing."""
    return [{f"figure_{k}": float(item["number"] + k) for k in range(WIDE)} for item in items]


def one(kind: str, n: int) -> Run:
    """A sweep of n items, measured in this process and its children, which must be fresh."""
    with tempfile.TemporaryDirectory() as folder:
        brief = Path(folder) / "brief.yaml"
        brief.write_text(BRIEF)
        sweep = Sweep("benchmarks.scale:noted", [{"number": k} for k in range(n)], unit=200)
        if kind == "trials":
            sweep = Sweep(JUDGE, list(_items(n, str(brief))), {"threads": 1}, UNIT)
        began = time.perf_counter()
        run(sweep, Store(Path(folder) / "rows"), Local())
        wall = time.perf_counter() - began
    mine, theirs = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    cpu = sum(usage.ru_utime + usage.ru_stime for usage in (mine, theirs))
    return Run(n, wall, cpu, theirs.ru_maxrss / 1024, mine.ru_maxrss / 1024)


def apart(kind: str, n: int) -> Run:
    """`one` in a program of its own."""
    command = [sys.executable, "-m", "benchmarks.scale", "--one", kind, str(n)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return Run(*json.loads(done.stdout))


def costs() -> dict[str, float]:
    """CPU s of one core for a grasp under each protocol, scenes and verdicts included."""
    found = {}
    for protocol in PROTOCOLS:
        items = list(_items(SAMPLE, protocol))
        run_cases({"threads": 1}, items[:1])  # What is read once.
        began = time.process_time()
        run_cases({"threads": 1}, items)
        found[protocol] = (time.process_time() - began) / SAMPLE
    return found


def _items(n: int, protocol: str) -> Iterator[dict[str, Any]]:
    for draw in sample_perturbations(Uncertainty(), n):
        yield {"scenario": "mug", "protocol": protocol, "draw": asdict(draw)}


def tables(sizes: Sequence[int]) -> Iterator[str]:
    """As Markdown, each as soon as it is measured."""
    yield f"### Trials of half a second on {core_count()} cores ({ENGINE})\n"
    yield "| trials | wall s | CPU ms a trial | a process, MB | the program, MB |\n|---|---|---|---|---|"
    for made in (apart("trials", n) for n in sizes):
        each = 1000 * made.cpu / made.n
        yield f"| {made.n:,} | {made.wall:.0f} | {each:.0f} | {made.worker:.0f} | {made.program:.0f} |"
    yield "\n### The sweep alone: rows of nothing\n"
    yield "| rows | wall s | rows a second | the program, MB |\n|---|---|---|---|"
    rate = 0.0
    for made in (apart("rows", n) for n in ROWS):
        rate = made.n / made.wall
        yield f"| {made.n:,} | {made.wall:.1f} | {rate:,.0f} | {made.program:.0f} |"
    found = costs()
    yield "\n### A grasp, and from it larger machines (not measured there)\n"
    yield f"| protocol | CPU s a grasp | {' | '.join(f'{name}: grasps an hour' for name in MACHINES)} |"
    yield "|---|---|" + "---|" * len(MACHINES)
    for protocol, seconds in found.items():
        speeds = [count / seconds * (RAY if count > 64 else 1.0) for count in MACHINES.values()]
        shown = (f"{3600 * min(speed, rate):,.0f}{'*' if speed > rate else ''}" for speed in speeds)
        yield f"| `{protocol}` | {seconds:.2f} | {' | '.join(shown)} |"
    yield f"\n\\* as many as one program keeps, {rate:,.0f} rows a second; its computers could do more."


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("page", nargs="?", type=Path)
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES)
    parser.add_argument("--one", nargs=2)
    asked = parser.parse_args()
    if asked.one:
        print(json.dumps(one(asked.one[0], int(asked.one[1]))))
        return
    lines = []
    for line in tables(asked.sizes):
        print(line, flush=True)
        lines.append(line)
    if asked.page is not None:
        head = asked.page.read_text().split("<!-- tables -->")[0]
        asked.page.write_text(f"{head}<!-- tables -->\n\n" + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
