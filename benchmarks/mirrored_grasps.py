"""`python -m benchmarks.mirrored_grasps`: what a mirror says of hands that hold something.

Objects picked off the table as `table_pick` has it, with its uncertainty of place, mass, size and friction, by hands
like those of `benchmarks.mirror` (drives of their own; thresholds learned on free motions). Held for a second they are
made slippery, by `drive.AILMENTS`, and it counts what slips: moves in the hand by more than SLIPS, seen from the palm.
And grasps with nothing wrong, held, turned over and shaken: there every name is a false one, but for a slip within
0.3 s of which the object moved in the hand by more than SLIPS, which is told apart.
"""

from __future__ import annotations

import argparse
from collections import Counter
from functools import cache
from typing import NamedTuple

import numpy as np

from allegro_twin.grasping.batch.trials import TrialCase, TrialRunner
from allegro_twin.grasping.scenario import TrialProtocol, load_protocol, load_scenario
from allegro_twin.grasping.uncertainty import Uncertainty, sample_perturbations
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.loop import run, until
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import AILMENTS
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.faults import Fault
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array
from benchmarks.anomalies import learned
from benchmarks.mirrored_hands import N, hand, heard, mirror_of

OBJECTS = (
    "apple", "foam_brick", "gelatin_box", "golf_ball", "lemon", "mug", "potted_meat_can", "pudding_box",
    "rubiks_cube", "tennis_ball", "tomato_soup_can", "tuna_fish_can", "envelop", "envelop_above", "grasp_3", "grasp_4",
    "pinch_index", "pinch_middle", "chips_can", "cracker_box", "master_chef_can", "orange", "peach", "pear",
    "racquetball", "softball", "sugar_box", "wood_block",
)  # fmt: skip
HELD, TAIL = 1.0, 4.0  # s of the hold before the object grows slippery, and after.
SLIPS = 0.002  # m.
SOON = 3.0  # s.


class Said(NamedTuple):
    """Of one grasp."""

    found: Fault | None
    at: float
    """s."""
    t: Array
    """(k,), s."""
    place: Array
    """Of the object in the palm frame, (k, 3), m."""
    slippery: float
    """When it grew so; infinite: never."""
    touched: int
    """How many parts of the hand touched it then."""

    def moved(self, begin: float, end: float) -> float:
        """How far the object went in the hand from one time to another, at most, m."""
        rows = (self.t >= begin) & (self.t <= end)
        return float(np.linalg.norm(self.place[rows] - self.place[rows][0], axis=1).max()) if rows.any() else 0.0

    def slipped(self) -> float:
        """When it had, s; infinite: it did not."""
        rows = self.t >= self.slippery
        off = np.linalg.norm(self.place[rows] - self.place[rows][:1], axis=1) if rows.any() else np.zeros(0)
        return float(self.t[rows][off > SLIPS][0]) if (off > SLIPS).any() else np.inf


@cache
def rules(*, slippery: bool) -> TrialProtocol:
    """`table_pick`; `slippery`: to a longer hold, which ends it."""
    protocol = load_protocol("table_pick")
    if not slippery:
        return protocol
    until_held = protocol.phases[: 1 + [phase.name for phase in protocol.phases].index("hold")]
    hold = until_held[-1].model_copy(update={"seconds": HELD + TAIL})
    return protocol.model_copy(update={"phases": (*until_held[:-1], hold)})


def grasped(spec: HandSpec, calm: Thresholds, name: str, seed: int, *, slippery: bool) -> Said:
    """One grasp with a mirror beside it."""
    scenario, path = load_scenario(name)
    bench, draw = TrialRunner(spec, threads=1), sample_perturbations(Uncertainty(torque=0.0), 1, seed)[0]
    trial = bench.trial(
        TrialCase(scenario, load_grasp(scenario.grasp, spec), draw, rules(slippery=slippery), path.parent)
    )
    each = Mirror(spec, mirror_of(spec).observer, np.ones(N), calm)
    amount = float(np.random.default_rng((seed, 8)).uniform(*AILMENTS["slippery"]))
    at = next(window.begin for window in trial.windows if window.name == "hold") + HELD
    touched, suffered, rows = 0, np.inf, []
    samples = heard(until(trial.seconds, run(trial.backend, bench.controller(trial))), spec)
    for sample in trial.watched(each.watch(samples)):
        t, seen = sample.state.t, trial.latest()
        palm, thing = seen["palm"], seen["object"]
        rows.append((t, matrix_from_quaternion(palm[3:]).T @ (thing[:3] - palm[:3])))
        if slippery and suffered > t >= at:
            trial.backend.suffer("slippery", 0, amount)
            suffered, touched = t, int((seen["contact_force"] > 0.05).sum())
    times, places = zip(*rows, strict=True)
    # The first, or the first since it grew slippery.
    names = [report for report in each.faults if not slippery or report.named >= suffered] or list(each.faults)
    found, when = (names[0].fault, names[0].named) if names else (None, np.inf)
    return Said(found, when, np.array(times), np.array(places), suffered, touched)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=56, help="of either kind")
    options.add_argument("--hands", type=int, default=5)
    options.add_argument("--first", type=int, default=40, help="seed of the first hand")
    options.add_argument("--learn", type=float, default=60.0, help="s of free motion for thresholds, each hand")
    chosen = options.parse_args()
    specs = [hand(seed) for seed in range(chosen.first, chosen.first + chosen.hands)]
    calms = [learned(3000 + chosen.first + k, spec, chosen.learn) for k, spec in enumerate(specs)]

    def each(k: int, *, slippery: bool) -> Said:
        return grasped(
            specs[k % len(specs)], calms[k % len(specs)], OBJECTS[k % len(OBJECTS)], 1000 * chosen.first + k,
            slippery=slippery,
        )  # fmt: skip

    _slips([(k, each(k, slippery=True)) for k in range(chosen.trials)])
    _calm([(k, each(k, slippery=False)) for k in range(chosen.trials)])


def _slips(all_said: list[tuple[int, Said]]) -> None:
    named, late, told, count = 0, [], Counter[str](), 0
    for k, said in all_said:
        if not said.touched or not np.isfinite(said.slipped()):
            continue
        count += 1
        name: str = "nothing" if said.found is None else said.found.name
        after, right = said.at - said.slipped(), name == "slip" and said.at >= said.slippery
        name = name if right or name != "slip" else "slip before"
        told[name] += 1
        if right and after <= SOON:
            named += 1
            late.append(after)
        else:
            print(
                f"  {k} {OBJECTS[k % len(OBJECTS)]}: {name}; it moved {1000 * said.moved(said.slippery, np.inf):.0f} mm"
            )
    print(
        f"{named} of {count} slips named within {SOON:g} s, in the median {1000 * np.median(late):+.0f} ms after the "
        f"first {1000 * SLIPS:g} mm; called {dict(told)}", flush=True,
    )  # fmt: skip


def _calm(all_said: list[tuple[int, Said]]) -> None:
    wrong, true, minutes = Counter[str](), 0, sum(said.t[-1] for _, said in all_said) / 60.0
    for k, said in all_said:
        if said.found is None:
            continue
        far = said.moved(said.at - 0.3, said.at + 0.3)
        if said.found.name == "slip" and far > SLIPS:
            true += 1
            continue
        wrong[said.found.name] += 1
        what = f"{said.found.name} of {said.found.joint} at {said.at:.2f} s"
        print(f"  {k} {OBJECTS[k % len(OBJECTS)]}: {what}, {1000 * far:.1f} mm", flush=True)
    print(
        f"{len(all_said)} grasps with nothing wrong, {minutes:.0f} minutes: {sum(wrong.values())} false names "
        f"{dict(wrong)}; {true} times the object did move in the hand", flush=True,
    )  # fmt: skip


if __name__ == "__main__":
    main()
