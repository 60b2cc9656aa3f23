"""`python -m benchmarks.anomalies`: faults injected into simulated hands, and what their mirrors call them.

Hands and motions as in `benchmarks.mirror`, amounts as `drive.AILMENTS` draws them; thresholds are learned on other
motions of each hand. A payload sits on one of the outer three links of a finger: the first carries none of its weight.
A fingertip comes loose, no other joint. A fault on a joint that does not move afterwards cannot show; such draws stay
in the table.

A slow drift cannot show where gravity does not turn with its joint: of each it is told how fast the weight on the
finger's joints goes wrong, rate x |column of K| (`encoder_drift`), and whether that is at least FAINT. FAINT was set
on hands 70-74.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np

from allegro_twin.control.controllers import PD
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.sim.drivetrain.backlash import allow_backlash
from allegro_twin.sim.observer.observer import StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import AILMENTS, Ailment
from allegro_twin.twin.identify.results.gap import has_breakaway_friction
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array
from benchmarks.mirrored_hands import PERIOD, N, hand, heard, mirror_of, moves, simulated

KINDS = ("weak", "stuck", "encoder_step", "payload", "friction", "encoder_drift", "loose")
BEGIN = 4.0  # s: when something goes wrong,
WITHIN = {"encoder_drift": 120.0}  # s: and by when it is to be named;
SOON = 3.0  # else.
FAINT = 1.5e-6  # N·m/s.


def learned(seed: int, spec: HandSpec, seconds: float) -> Thresholds:
    """From a free motion."""
    each, disturbance, moving = mirror_of(spec), [], []
    backend = simulated(spec, seed)
    controller = PD(moves(spec, seed, seconds), load_gains("v4", spec))
    for _ in each.watch(heard(until(seconds, run(backend, controller)), spec)):
        disturbance.append(each.columns()["disturbance"])
        moving.append(each.moving)
    gains: Array = np.array(each.fault_detector.gains)
    return Thresholds.from_free_motion(
        np.array(disturbance[1:]), np.array(moving[1:]), each.observer.held, gains, PERIOD, spec
    )


class Called(NamedTuple):
    """What the mirror said."""

    name: str
    joint: int
    true: int
    """Of which joint it was."""
    after: float
    """s."""
    speed: float
    """At which the weight on the finger's joints goes wrong where an encoder drifts, N·m/s."""
    touched: bool
    """Whether it said that something touches a finger."""


def called(spec: HandSpec, calm: Thresholds, seed: int, what: str | None, seconds: float) -> Called:
    """What the mirror says of a hand with which something goes wrong."""
    tips = [finger.joints[-1] for finger in spec.fingers]
    rng, backend = (
        np.random.default_rng((seed, 6)),
        simulated(allow_backlash(spec, tips) if what == "loose" else spec, seed),
    )
    another = hand(seed + 500, mismatched=has_breakaway_friction(spec.drive))
    file = replace(another, drive=spec.drive) if what == "wrong_file" else spec
    each = Mirror(spec, mirror_of(file).observer, np.ones(N), calm)
    joint = int(rng.integers(N)) if what != "payload" else int(4 * rng.integers(4) + 1 + rng.integers(3))
    joint = tips[joint % len(tips)] if what == "loose" else joint
    amount = rng.uniform(*AILMENTS[cast(Ailment, what)]) if what in KINDS else 0.0
    controller = PD(moves(spec, seed, seconds), load_gains("v4", spec))
    done, leaned, touched = False, [], False
    for sample in each.watch(heard(until(seconds, run(backend, controller)), spec)):
        if what in KINDS and not done and sample.state.t >= BEGIN:
            backend.suffer(cast(Ailment, what), joint, float(amount))
            done = True
        if what == "encoder_drift" and sample.state.tick % 100 == 99:
            leaned.append(np.linalg.norm(cast(StateObserver, each.observer).lean()[:, joint]))
        touched |= bool(each.contacts)
        if each.fault is not None:
            break
    said, speed = each.fault, amount * float(np.sqrt(np.mean(np.square(leaned)))) if leaned else 0.0
    if said is None:
        return Called("nothing", -1, joint, float("inf"), speed, touched)
    after = sample.state.t - (BEGIN if what in KINDS else 1.0)
    return Called(said.name, said.joint, joint, after, speed, touched)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--injections", type=int, default=20, help="of each kind")
    options.add_argument("--hands", type=int, default=5)
    options.add_argument("--first", type=int, default=30, help="seed of the first hand")
    options.add_argument("--mismatched", action="store_true", help="friction that breaks away, in hands and mirrors")
    options.add_argument("--minutes", type=float, default=60.0, help="of free motion for false names, in all")
    options.add_argument("--learn", type=float, default=120.0, help="s of free motion for thresholds, each hand")
    options.add_argument("--kinds", nargs="*", choices=(*KINDS, "wrong_file"), default=(*KINDS, "wrong_file"))
    chosen = options.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.hands)
    specs = [hand(seed, mismatched=chosen.mismatched) for seed in seeds]
    calms = [learned(3000 + seed, spec, chosen.learn) for seed, spec in zip(seeds, specs, strict=True)]
    for what in chosen.kinds:
        told, right, late, within = Counter[str](), 0, 0, WITHIN.get(what, SOON)
        for k in range(chosen.injections):
            which = k % len(specs)
            said = called(specs[which], calms[which], 100 * chosen.first + k, what, BEGIN + max(8.0, within))
            same = said.name == what and (said.joint == said.true or what == "wrong_file")
            told[said.name if same or said.name != what else f"{what} of another joint"] += 1
            right += int(same and said.after <= within)
            late += int(same and said.after > within)
            if what == "encoder_drift":
                faint = "" if said.speed >= FAINT else ", faint"
                print(
                    f"  joint {said.true}, {1e6 * said.speed:.1f} µN·m/s{faint}: "
                    f"{said.name} of {said.joint} after {said.after:.0f} s", flush=True,
                )  # fmt: skip
        print(
            f"{what:<14}{right} of {chosen.injections} named right within {within:g} s, {late} later; "
            f"called {dict(told)}",
            flush=True,
        )
    minutes = [
        called(specs[k % len(specs)], calms[k % len(specs)], 7000 + k, None, 60.0) for k in range(round(chosen.minutes))
    ]
    false, touched = sum(each.name != "nothing" for each in minutes), sum(each.touched for each in minutes)
    print(f"{len(minutes)} minutes of free motion: {false} with something named, {touched} with a touch", flush=True)


if __name__ == "__main__":
    main()
