"""`python -m benchmarks.anomalies`: faults injected into simulated hands, and what their mirrors call them.

Hands and motions as in `benchmarks.mirror`, amounts as `drive.AILMENTS` draws them; thresholds are learned on other
motions of each hand. A payload sits on one of the outer three links of a finger: the first carries none of its weight.
A fingertip comes loose, no other joint. A fault on a joint that does not move afterwards cannot show; such draws stay
in the table.

`touch`: nothing goes wrong, but something pushes a fingertip, with 0.3, 0.5 or 1 N for 0.3, 1 or 3 s, in any direction:
every name is false. `two`: a second fault, of another kind and finger, comes 4 s after the first; both are to be named.

A slow drift cannot show where gravity does not turn with its joint: of each it is told how fast the weight on the
finger's joints goes wrong, rate x |column of K| (`encoder_drift`), and whether that is at least FAINT. FAINT was set
on hands 70-74.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from itertools import product
from typing import NamedTuple, cast

import mujoco
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
from benchmarks.mirrored_hands import PERIOD, N, hand, heard, mirror_of, moves, simulated

KINDS = ("weak", "stuck", "encoder_step", "payload", "friction", "encoder_drift", "loose")
PAIRS = ("weak", "stuck", "encoder_step", "payload", "friction")
PUSHES = tuple(product((0.3, 1.0, 3.0), (0.3, 0.5, 1.0)))  # s, N
SECOND = 8.0  # s: when a second thing goes wrong.
BEGIN = 4.0  # s: when something goes wrong,
WITHIN = {"encoder_drift": 120.0}  # s: and by when it is to be named;
SOON = 3.0  # else.
FAINT = 1.5e-6  # N·m/s.


def learned(seed: int, spec: HandSpec, seconds: float) -> Thresholds:
    """From a free motion."""
    each, disturbance, moving = mirror_of(spec), [], []
    each.fault_detector.keep_rows()
    backend = simulated(spec, seed)
    controller = PD(moves(spec, seed, seconds), load_gains("v4", spec))
    for _ in each.watch(heard(until(seconds, run(backend, controller)), spec)):
        disturbance.append(each.columns()["disturbance"])
        moving.append(each.moving)
    return Thresholds.from_free_motion(
        np.array(disturbance[1:]),
        np.array(moving[1:]),
        each.observer.held,
        each.fault_detector.free_shapes(),
        PERIOD,
        spec,
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
    others: int = 0
    """Names beside it."""


def drawn(rng: np.random.Generator, spec: HandSpec, what: str) -> tuple[int, float]:
    """A joint and an amount."""
    tips = [finger.joints[-1] for finger in spec.fingers]
    joint = int(rng.integers(N)) if what != "payload" else int(4 * rng.integers(4) + 1 + rng.integers(3))
    joint = tips[joint % len(tips)] if what == "loose" else joint
    return joint, float(rng.uniform(*AILMENTS[cast(Ailment, what)])) if what in KINDS else 0.0


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
    joint, amount = drawn(rng, spec, what or "")
    controller = PD(moves(spec, seed, seconds), load_gains("v4", spec))
    done, leaned, touched = False, [], False
    for sample in each.watch(heard(until(seconds, run(backend, controller)), spec)):
        if what in KINDS and not done and sample.state.t >= BEGIN:
            backend.suffer(cast(Ailment, what), joint, amount)
            done = True
        if what == "encoder_drift" and sample.state.tick % 100 == 99:
            leaned.append(np.linalg.norm(cast(StateObserver, each.observer).lean()[:, joint]))
        touched |= bool(each.contacts)
        if each.faults and what in WITHIN:
            break
    speed = amount * float(np.sqrt(np.mean(np.square(leaned)))) if leaned else 0.0
    if not each.faults:
        return Called("nothing", -1, joint, float("inf"), speed, touched)
    first, *rest = each.faults
    after = first.named - (BEGIN if what in KINDS else 1.0)
    return Called(first.fault.name, first.fault.joint, joint, after, speed, touched, len(rest))


def push_fingertip(spec: HandSpec, calm: Thresholds, seed: int) -> tuple[list[str], list[str]]:
    """Names that a push gives, with the times when they came and ended, and the fingers that were touched."""
    lasts, force = PUSHES[seed % len(PUSHES)]
    rng, backend, finger = np.random.default_rng((seed, 8)), simulated(spec, seed), spec.fingers[seed % 4]
    model, data, way = backend.model, backend.data, rng.standard_normal(3)
    way *= force / np.linalg.norm(way)
    body, site = model.body(f"link_{finger.joints[-1]}.0").id, model.site(finger.tip).id
    each, ends, fingers = Mirror(spec, mirror_of(spec).observer, np.ones(N), calm), BEGIN + lasts, set[str]()
    controller = PD(moves(spec, seed, ends + 5.0), load_gains("v4", spec))
    for sample in each.watch(heard(until(ends + 5.0, run(backend, controller)), spec)):
        torque = np.zeros(model.nv)
        if BEGIN <= sample.state.t < ends:
            mujoco.mj_applyFT(model, data, way, np.zeros(3), data.site_xpos[site].copy(), body, torque)
        backend.push(torque[:N])
        fingers.update(each.contacts)
    names = [
        f"{one.fault.name} after {one.named - BEGIN:.1f} s"
        + (f", withdrawn {one.ended - ends:+.1f} s after its end" if np.isfinite(one.ended) else "")
        for one in each.faults
    ]
    return [f"{force:g} N for {lasts:g} s: {name}" for name in names], sorted(fingers)


def two_faults(spec: HandSpec, calm: Thresholds, seed: int) -> tuple[int, int, list[str]]:
    """How many of two faults were named right within SOON, how many later, and what else was named."""
    rng, backend = np.random.default_rng((seed, 9)), simulated(spec, seed)
    first, second = (cast(Ailment, str(each)) for each in rng.choice(PAIRS, 2, replace=False))
    one, other = drawn(rng, spec, first), drawn(rng, spec, second)
    while other[0] // 4 == one[0] // 4:
        other = drawn(rng, spec, second)
    todo = [(BEGIN, first, *one), (SECOND, second, *other)]
    each, wanted = Mirror(spec, mirror_of(spec).observer, np.ones(N), calm), list(todo)
    controller = PD(moves(spec, seed, SECOND + 6.0), load_gains("v4", spec))
    for sample in each.watch(heard(until(SECOND + 6.0, run(backend, controller)), spec)):
        if todo and sample.state.t >= todo[0][0]:
            _, what, joint, amount = todo.pop(0)
            backend.suffer(what, joint, amount)
    right = late = 0
    named: dict[tuple[str, int], float] = {
        (report.fault.name, report.fault.joint): report.named for report in each.faults
    }
    for begin, what, joint, _ in wanted:
        when = named.pop((what, joint), np.inf)
        right, late = right + (when <= begin + SOON), late + (begin + SOON < when < np.inf)
    return right, late, [f"{name} of {joint} at {t:.1f} s beside {wanted}" for (name, joint), t in named.items()]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--injections", type=int, default=20, help="of each kind")
    options.add_argument("--hands", type=int, default=5)
    options.add_argument("--first", type=int, default=30, help="seed of the first hand")
    options.add_argument("--mismatched", action="store_true", help="friction that breaks away, in hands and mirrors")
    options.add_argument("--minutes", type=float, default=60.0, help="of free motion for false names, in all")
    options.add_argument("--learn", type=float, default=120.0, help="s of free motion for thresholds, each hand")
    options.add_argument(
        "--kinds", nargs="*", choices=(*KINDS, "wrong_file", "touch", "two"), default=(*KINDS, "wrong_file")
    )
    chosen = options.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.hands)
    specs = [hand(seed, mismatched=chosen.mismatched) for seed in seeds]
    calms = [learned(3000 + seed, spec, chosen.learn) for seed, spec in zip(seeds, specs, strict=True)]
    for what in chosen.kinds:
        cases = [
            (specs[k % len(specs)], calms[k % len(specs)], 100 * chosen.first + k) for k in range(chosen.injections)
        ]
        if what == "touch":
            pushes = [push_fingertip(*case) for case in cases]
            false_names = [name for names, _ in pushes for name in names]
            felt = sum(bool(fingers) for _, fingers in pushes)
            print(f"touch         {len(cases)}: {felt} felt; false names {false_names}", flush=True)
            continue
        if what == "two":
            pairs = [two_faults(*case) for case in cases]
            right, late = sum(pair[0] for pair in pairs), sum(pair[1] for pair in pairs)
            more = [name for *_, others in pairs for name in others]
            print(f"two           {right} of {2 * len(cases)} named right within {SOON:g} s, {late} later; else {more}")
            continue
        told, right, late, within, others = Counter[str](), 0, 0, WITHIN.get(what, SOON), 0
        for k in range(chosen.injections):
            which = k % len(specs)
            said = called(specs[which], calms[which], 100 * chosen.first + k, what, BEGIN + max(8.0, within))
            same = said.name == what and (said.joint == said.true or what == "wrong_file")
            told[said.name if same or said.name != what else f"{what} of another joint"] += 1
            others += said.others
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
            f"called {dict(told)}; {others} names beside",
            flush=True,
        )
    minutes = [
        called(specs[k % len(specs)], calms[k % len(specs)], 7000 + k, None, 60.0) for k in range(round(chosen.minutes))
    ]
    false, touched = sum(each.name != "nothing" for each in minutes), sum(each.touched for each in minutes)
    print(f"{len(minutes)} minutes of free motion: {false} with something named, {touched} with a touch", flush=True)


if __name__ == "__main__":
    main()
