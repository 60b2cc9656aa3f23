"""`python -m benchmarks.first_touches`: who notices first that a finger met the object, a force grasp or a mirror.

The grasps with two to four fingertips close softly on objects of the catalogue, placed as `table_pick` draws them, on
hands like those of `benchmarks.mirror` (drives of their own; thresholds learned on free motions). A finger has met the
object when it presses it with LEAST; the grasp says so by torque and stillness (`control/contact.py`), the mirror by
what pushes the finger's joints, from when it says that nothing does. What is said before that, while the fingers
close, is false where the finger has touched nothing, and of something else where it touched that: the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from allegro_twin.build.trials import Bench, Case
from allegro_twin.control.contact import touching
from allegro_twin.control.force_grasp import CentroidGrasp, Gripping
from allegro_twin.evaluate.scenario import load_protocol, load_scenario
from allegro_twin.evaluate.uncertainty import Uncertainty, draws
from allegro_twin.library.named import load_grasp
from allegro_twin.loop import run, until
from allegro_twin.mirror.diagnosis import Calm
from allegro_twin.mirror.mirror import Mirror
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, HandState, TorqueCommand
from benchmarks.mirror import learned
from benchmarks.mirrored_hands import N, hand, heard, mirror_of

GRASPS = ("grasp_3", "grasp_4", "pinch_index", "pinch_middle")
THINGS = ("lemon", "tennis_ball", "tuna_fish_can", "rubiks_cube", "apple", "golf_ball")
LEAST = 0.1  # N


class Met(NamedTuple):
    """One finger."""

    touched: float
    """When it met the object, s; infinite: never before the force was due."""
    other: float
    """When it touched anything at all, the object too, from when it closes, likewise."""
    grasp: float
    """When the grasp said so, likewise."""
    mirror: float
    """When the mirror did, likewise."""


class Watched:
    """A force grasp that lets see what it remembers."""

    def __init__(self, inner: CentroidGrasp) -> None:
        self.inner = inner

    def start(self, state: HandState) -> Gripping:
        self.memory = self.inner.start(state)
        return self.memory

    def __call__(self, state: HandState, memory: Gripping) -> tuple[TorqueCommand, Gripping]:
        command, self.memory = self.inner(state, memory)
        return command, self.memory


def closed(spec: HandSpec, above: Array, grasp: str, thing: str, seed: int, *, coulomb: bool = False) -> list[Met]:
    """The fingers of one grasp, from when they begin to close until the grasp presses."""
    scenario, path = load_scenario(grasp)
    bench, draw = Bench(spec, threads=1), draws(Uncertainty(torque=0.0), 1, seed)[0]
    objects = (load_scenario(thing)[0].objects[0],)
    scenario = scenario.model_copy(update={"objects": objects})
    case = Case(scenario, load_grasp(scenario.grasp, spec), draw, load_protocol("table_pick"), path.parent)
    trial = bench.trial(case)
    controller = bench.controller(trial)
    assert isinstance(controller, CentroidGrasp)
    each = Mirror(
        spec, mirror_of(spec, coulomb=coulomb).observer, np.ones(N), Calm(above, np.full(len(spec.fingers), np.inf))
    )
    watched = Watched(controller)
    fingers = [next(k for k, f in enumerate(spec.fingers) if row[0] in f.joints) for row in controller.joints]
    said, old = (
        np.full((4, len(fingers)), np.inf),
        np.ones(len(fingers), dtype=bool),
    )  # Object, anything, grasp, mirror.
    model, data = trial.backend.model, trial.backend.data
    links = [
        [int(model.joint(name).bodyid[0]) for name in np.array(spec.joints)[list(row)]] for row in controller.joints
    ]
    samples = heard(until(trial.seconds, run(trial.backend, watched)), spec)
    for sample in trial.watched(each.watched(samples)):
        t = sample.state.t
        if t < controller.close_at:
            continue
        force = trial.latest()["contact_force"][fingers]
        mirror = np.array([spec.fingers[k].name in each.contacts for k in fingers])
        old &= mirror
        met = {int(body) for body in model.body_weldid[model.geom_bodyid[data.contact.geom]].reshape(-1)}
        anything = [not met.isdisjoint(own) for own in links]
        now = np.stack([force > LEAST, anything, touching(watched.memory.stall), mirror & ~old])
        said = np.where(now, np.minimum(said, t), said)
        if not np.isnan(watched.memory.contact):
            break
    return [Met(*column) for column in said.T]


def told(found: Sequence[Met], who: str) -> str:
    """What a line says of one who noticed."""
    touched, other, said = np.array([(met.touched, met.other, getattr(met, who)) for met in found]).T
    real, before = np.isfinite(touched), np.isfinite(said) & (said < touched)
    right = real & np.isfinite(said) & ~before
    late = 1e3 * np.percentile(said[right] - touched[right], [50, 90]) if right.any() else (np.nan, np.nan)
    return (
        f"{who}: {right.sum()} of {real.sum()} touches, {late[0]:.0f} ms after in the median, {late[1]:.0f} at the "
        f"90th percentile; {(real & np.isinf(said)).sum()} missed; before: {(before & (said >= other)).sum()} of "
        f"something else, {(before & (said < other)).sum()} of nothing"
    )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=24)
    options.add_argument("--hands", type=int, default=3)
    options.add_argument("--first", type=int, default=40, help="seed of the first hand")
    options.add_argument("--mismatched", action="store_true", help="friction that breaks away and grows with torque")
    options.add_argument("--learn", type=float, default=60.0, help="s of free motion for thresholds, each hand")
    chosen = options.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.hands)
    specs = [hand(seed, mismatched=chosen.mismatched) for seed in seeds]
    above = [learned(seed, spec, chosen.learn, coulomb=False) for seed, spec in zip(seeds, specs, strict=True)]
    found: list[Met] = []
    for k in range(chosen.trials):
        which, grasp, thing = k % len(specs), GRASPS[k % len(GRASPS)], THINGS[k // len(GRASPS) % len(THINGS)]
        mets = closed(specs[which], above[which], grasp, thing, 1000 * chosen.first + k)
        found += mets
        print(f"  {k} {grasp} {thing}: {[tuple(round(each, 3) for each in met) for met in mets]}", flush=True)
    for who in ("grasp", "mirror"):
        print(told(found, who), flush=True)


if __name__ == "__main__":
    main()
