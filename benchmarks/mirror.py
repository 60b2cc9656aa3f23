"""What the mirror costs a period, and `python -m benchmarks.mirror`: touches noticed, forces told, false alarms.

The hand is simulated at another time step than its mirror, with encoder noise and counts; the mirror has its true
drive. Friction is Coulomb's (matched), or breaks away and grows with the torque (mismatched; unmodelled: and the mirror
knows Coulomb's alone). Something pushes a fingertip, a constant force from its pad side, ± 40° about it, or a stiff
wall in its way, while the finger moves (two joints faster than 0.1 rad/s) or rests. Thresholds are learned on other
motions than those that are judged.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from allegro_twin.control.controllers import PD
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.sim.observer.observer import StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.twin.mirror.contact_detection import (
    NOTHING,
    PERIODS,
    contact_thresholds,
    held_friction,
    joint_thresholds,
    push_ratio,
)
from allegro_twin.twin.mirror.rerun_view import RATE, draw_mirror, mirror_scenery
from allegro_twin.types import Array
from allegro_twin.viewing.rerun.viewer import Viewer
from benchmarks.mirrored_hands import (
    PERIOD,
    N,
    Touch,
    constant,
    disturbances,
    hand,
    heard,
    mirror_of,
    moves,
    simulated,
    touch,
    wall,
)  # fmt: skip

DRAWN = 10.0  # s


def touched_fingers(disturbance: Array, above: Array, spec: HandSpec, held: Array = NOTHING) -> Array:
    """Whether each finger is touched, (k, fingers): it was outside its ellipsoid for the last PERIODS periods.
    Arguments as of `push_ratio`."""
    over = push_ratio(disturbance, above, spec, held=held) > 1.0
    kept = over.copy()
    for back in range(1, PERIODS):
        kept[back:] &= over[:-back]
        kept[:back] = False
    return np.asarray(kept)


def figures() -> Iterator[tuple[str, float, float, str]]:
    """What a period of the mirror takes of real time."""
    spec = load_spec()
    observer = StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), PERIOD)
    middle = (spec.lower + spec.upper) / 2.0
    observer.reset(middle)
    duty, down, took = np.full(N, 0.02), np.array([0.0, 0.0, -9.81]), []
    for _ in range(600):
        began = time.perf_counter()
        observer.step(duty, down, middle)
        took.append(time.perf_counter() - began)
    yield "mirror: prediction and correction, of a period", 100 * statistics.median(took) / PERIOD, 3.0, "%"
    whole, longest = _drawn(spec)
    yield f"mirror: all of it and Rerun at {RATE:g} Hz, of a period", whole, 15.0, "%"
    yield "  the same, the longest of a thousand periods, of its loop alone", longest, 1e3 * PERIOD, "ms"


def _drawn(spec: HandSpec) -> tuple[float, float]:
    """CPU time of a mirror, all threads, that is drawn as for somebody who watches: % of what passes; and the time,
    ms, in which 999 of 1000 periods' work is done."""
    motion = run(simulated(spec, 0), PD(moves(spec, 0, DRAWN), load_gains("v4", spec)))
    samples, each, took = list(heard(until(DRAWN, motion), spec)), mirror_of(spec), []
    with tempfile.TemporaryDirectory() as folder:
        viewer = Viewer(spec, mirror_scenery(spec), rate=RATE, live=True).to_file(Path(folder) / "mirror.rrd")
        viewer.flush()
        began, last = time.process_time(), time.thread_time()
        for _ in draw_mirror(each.watch(samples), each, viewer, None):
            now = time.thread_time()
            took.append(now - last)
            last = now
        viewer.flush()
        whole = time.process_time() - began
        viewer.close()
    return 100 * whole / DRAWN, 1e3 * float(np.percentile(took, 99.9))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--kind", choices=("matched", "mismatched", "unmodelled"), default="matched")
    options.add_argument("--trials", type=int, default=200)
    options.add_argument("--case", default="", help="part of the names of the trials to run; all by default")
    options.add_argument("--hands", type=int, default=5)
    options.add_argument("--first", type=int, default=20, help="seed of the first hand")
    options.add_argument("--minutes", type=float, default=60.0, help="of free motion for false alarms, in all")
    options.add_argument("--learn", type=float, default=60.0, help="s of free motion for thresholds, each hand")
    chosen = options.parse_args()
    for what, measured, bar, unit in figures():
        print(f"{what}: {measured:.2f} {unit}, bar {bar:g}", flush=True)
    seeds = range(chosen.first, chosen.first + chosen.hands)
    coulomb = chosen.kind == "unmodelled"
    specs = [hand(seed, mismatched=chosen.kind != "matched") for seed in seeds]
    above = [learned(seed, spec, chosen.learn, coulomb=coulomb) for seed, spec in zip(seeds, specs, strict=True)]
    for what, moving, force in (
        ("force", True, 0.2), ("force", True, 0.5), ("force", True, 1.0), ("wall", True, 0.2), ("wall", True, 0.5),
        ("force", False, 0.5), ("force", False, 1.0),
    ):  # fmt: skip
        case = f"{what}, {force} N, {'moving' if moving else 'at rest'}"
        if chosen.case not in case:
            continue
        runs = [trial(specs, above, k, what, force, moving=moving, coulomb=coulomb) for k in range(chosen.trials)]
        print(f"{case}: {told(runs)}", flush=True)
    alarms(specs, above, chosen.minutes, coulomb=coulomb)


def learned(seed: int, spec: HandSpec, seconds: float, *, coulomb: bool) -> Array:
    """Thresholds from a free motion, of joints at rest and moving, and what friction may hold at rest, (3, n), N·m."""
    free, moving = disturbances(spec, 1000 + seed, seconds, coulomb=coulomb)
    file = mirror_of(spec, coulomb=coulomb).observer.held
    held = held_friction(free, moving, file, PERIOD)
    above = np.vstack([contact_thresholds(free, moving, file, PERIOD, spec), held])
    for which, (name, rows) in enumerate((("at rest", ~moving[400:]), ("moving", moving[400:]))):
        print(f"hand {seed}, joints {name}: floor {1e3 * free[400:][rows].std():.1f} mN·m, thresholds "
              f"{1e3 * above[which].min():.1f} to {1e3 * above[which].max():.1f}", flush=True)  # fmt: skip
    return above


def trial(
    specs: Sequence[HandSpec], above: Sequence[Array], k: int, what: str, force: float, *, moving: bool, coulomb: bool
) -> Touch:
    """The `k`-th."""
    turn = float(np.radians(np.random.default_rng((k, 5)).uniform(-40.0, 40.0)))
    pushing = constant(force, turn) if what == "force" else wall
    return touch(specs[k % len(specs)], above[k % len(specs)], k, pushing, force, moving=moving, coulomb=coulomb)


def told(runs: Sequence[Touch]) -> str:
    """What a line says of some trials."""
    after, off, moved = (np.array(column) for column in zip(*runs, strict=True))
    return (
        f"{np.mean(after <= 0.0401):.1%} in 40 ms, {np.mean(after <= 0.0601):.1%} in 60 ms, median "
        f"{1e3 * np.median(after):.0f} ms; torque off by {np.median(off):.0%}; of {moved.sum()} that moved a joint "
        f"{np.mean(after[moved] <= 0.0601):.1%} in 60 ms"
    )


def alarms(specs: Sequence[HandSpec], above: Sequence[Array], minutes: float, *, coulomb: bool) -> None:
    """Free motions on end, in runs of a minute."""
    count = 0
    for k in range(round(minutes)):
        which = k % len(specs)
        free, moving = disturbances(specs[which], 2000 + k, 60.0, coulomb=coulomb)
        held = np.where(moving, 0.0, above[which][2])
        count += int(touched_fingers(free, joint_thresholds(above[which], moving), specs[which], held)[400:].any())
    print(f"{count} of {round(minutes)} minutes of free motion with a false alarm", flush=True)


if __name__ == "__main__":
    main()
