"""`python -m benchmarks.first_touches`: who notices first that a finger met the object, a force grasp or a mirror.

The grasps with two to four fingertips close softly on objects of the catalogue, placed as `table_pick` draws them, on
hands like those of `benchmarks.mirror` (drives of their own; thresholds learned on free motions). A finger has met the
object when it presses it with LEAST; the grasp says so by torque and stillness (`control/force_grasp.py`), the mirror
by what pushes the finger's joints, from when it says that nothing does. What is said before that, while the fingers
close, is false where the finger has touched nothing, and of something else where it touched that: the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allegro_twin.control.force_grasp import CentroidGrasp, CentroidMemory, fingers_in_contact
from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.scenario import load_protocol, load_scenario
from allegro_twin.grasping.trial import Trial
from allegro_twin.grasping.uncertainty import Uncertainty, sample_perturbations
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.loop import run, until
from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.mirror import Mirror
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

    def start(self, state: HandState) -> CentroidMemory:
        self.memory = self.inner.start(state)
        return self.memory

    def __call__(self, state: HandState, memory: CentroidMemory) -> tuple[TorqueCommand, CentroidMemory]:
        command, self.memory = self.inner(state, memory)
        return command, self.memory


def prepared(spec: HandSpec, above: Array, grasp: str, thing: str, seed: int) -> tuple[Trial, CentroidGrasp, Mirror]:
    """A trial of a grasp with an object, its controller, and a mirror that knows what a touch is."""
    scenario, path = load_scenario(grasp)
    bench, draw = TrialRunner(spec, threads=1), sample_perturbations(Uncertainty(torque=0.0), 1, seed)[0]
    scenario = scenario.model_copy(update={"objects": load_scenario(thing)[0].objects[:1]})
    case = TrialCase(scenario, load_grasp(scenario.grasp, spec), draw, load_protocol("table_pick"), path.parent)
    trial = bench.trial(case)
    controller = bench.controller(trial)
    assert isinstance(controller, CentroidGrasp)
    calm = Thresholds(above[:2], np.full(len(spec.fingers), np.inf), held=above[2])
    return trial, controller, Mirror(spec, mirror_of(spec).observer, np.ones(N), calm)


def closed(spec: HandSpec, trial: Trial, controller: CentroidGrasp, each: Mirror) -> list[Met]:
    """The fingers of one grasp, from when they begin to close until the grasp presses."""
    watched, model, data = Watched(controller), trial.backend.model, trial.backend.data
    names = np.array(spec.joints)
    links = [{int(model.joint(name).bodyid[0]) for name in names[list(row)]} for row in controller.joints]
    fingers = [next(k for k, f in enumerate(spec.fingers) if row[0] in f.joints) for row in controller.joints]
    said, old = np.full((4, len(fingers)), np.inf), np.ones(len(fingers), dtype=bool)
    for sample in trial.watched(each.watch(heard(until(trial.seconds, run(trial.backend, watched)), spec))):
        t = sample.state.t
        if t < controller.close_at:
            continue
        mirror = np.array([spec.fingers[k].name in each.contacts for k in fingers])
        old &= mirror
        met = set(model.body_weldid[model.geom_bodyid[data.contact.geom]].reshape(-1).tolist())
        anything = [not met.isdisjoint(own) for own in links]
        force = trial.latest()["contact_force"][fingers]
        now = np.stack([force > LEAST, anything, fingers_in_contact(watched.memory.stall), mirror & ~old])
        said = np.where(now, np.minimum(said, t), said)
        if not np.isnan(watched.memory.contact):
            break
    return [Met(*map(float, column)) for column in said.T]


def held(spec: HandSpec, trial: Trial, controller: CentroidGrasp, each: Mirror, *, by_mirror: bool) -> bool:
    """Whether a whole trial holds the object."""
    names = [next(f.name for f in spec.fingers if row[0] in f.joints) for row in controller.joints]
    if by_mirror:
        controller = replace(controller, contacts=lambda: np.array([name in each.contacts for name in names]))
    for _ in trial.watched(each.watch(heard(until(trial.seconds, run(trial.backend, controller)), spec))):
        pass
    return trial.report().held


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
    options.add_argument("--whole", action="store_true", help="whole trials: what holds, either way")
    options.add_argument("--learn", type=float, default=60.0, help="s of free motion for thresholds, each hand")
    chosen = options.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.hands)
    specs = [hand(seed, mismatched=chosen.mismatched) for seed in seeds]
    above = [learned(seed, spec, chosen.learn, coulomb=False) for seed, spec in zip(seeds, specs, strict=True)]
    found: list[Met] = []
    kept = np.zeros(2, dtype=int)
    for k in range(chosen.trials):
        which, grasp, thing = k % len(specs), GRASPS[k % len(GRASPS)], THINGS[k // len(GRASPS) % len(THINGS)]
        case = specs[which], above[which], grasp, thing, 1000 * chosen.first + k
        if chosen.whole:
            kept += [held(specs[which], *prepared(*case), by_mirror=by_mirror) for by_mirror in (False, True)]
        else:
            found += closed(specs[which], *prepared(*case))
    if chosen.whole:
        print(f"of {chosen.trials} held: {kept[0]} by torque and stillness, {kept[1]} by the mirror")
        return
    for who in ("grasp", "mirror"):
        print(told(found, who), flush=True)


if __name__ == "__main__":
    main()
