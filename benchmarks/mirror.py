"""What the mirror costs a period, and `python -m benchmarks.mirror`: touches noticed, forces told, false alarms.

The hand is simulated at half the mirror's time step, with encoder noise and counts; the mirror has its true drive
(matched). A force acts on a fingertip from its pad side, ± 40° about it, while the finger moves or rests; thresholds
are learned on other motions than those that are judged.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Hold, Moves, Reference, Waypoint
from allegro_twin.description.hands import load_spec
from allegro_twin.drive import Drive
from allegro_twin.identify.gap import drive_of
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.library.gains import load_gains
from allegro_twin.loop import run, until
from allegro_twin.mirror.events import PERIODS, thresholds
from allegro_twin.mirror.mirror import Mirror
from allegro_twin.sim.backend import SimBackend
from allegro_twin.sim.observer import Observer
from allegro_twin.sim.physics import Physics
from allegro_twin.sim.scene import Stage, compile_scene
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

PERIOD, N = 0.003, 16
COUNT = float(np.radians(333.3 / 65536))
BEGIN, SECONDS = 2.0, 2.4  # s: when a force begins, and when a trial ends.
POSES = (((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0)))


class Touch(NamedTuple):
    """One trial."""

    after: float
    """s until it was noticed; infinite where it was not."""
    error: float
    """Of the torques of the touched finger after 0.2 s, as a share of them."""


def hand(seed: int) -> HandSpec:
    """One of many, with a drive of its own."""
    rng, spec = np.random.default_rng((seed, 3)), load_spec()
    own = replace(
        spec.actuation,
        armature=rng.uniform(0.0015, 0.0045, N),
        damping=rng.uniform(0.0368, 0.1102, N),
        frictionloss=rng.uniform(0.0, 0.06, N),
    )
    noise = {"encoder_noise": 5e-5, "quantisation": COUNT, "delay": float(rng.uniform(0.0, 0.006)), "seed": seed}
    return replace(spec, actuation=own, drive=Drive.made(noise, N))


def simulated(spec: HandSpec, seed: int) -> SimBackend:
    facing, fingers = POSES[seed % len(POSES)]
    stage = Stage(np.zeros(3), quaternion_facing(facing, fingers), physics=Physics(timestep=0.0005))
    model = compile_scene(spec, stage)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)  # Its fingers are not to touch each other.
    return SimBackend(spec, model, posture=(spec.lower + spec.upper) / 2.0)


def moves(spec: HandSpec, seed: int, seconds: float) -> Reference:
    """Random ways about the middle, with rests."""
    rng, middle = np.random.default_rng((seed, 4)), (spec.lower + spec.upper) / 2.0
    points = []
    for _ in range(int(seconds / 0.8) + 2):
        goal = middle + rng.uniform(-0.3, 0.3, N) * np.tile([0.3, 1.0, 1.0, 1.0], 4)
        points.append(Waypoint(goal, seconds=float(rng.uniform(0.4, 1.2))))
    return Moves(points)


def mirror_of(spec: HandSpec) -> Mirror:
    return Mirror(spec, Observer(spec, drive_of(spec, np.ones(N), np.zeros(N)), PERIOD), np.ones(N))


def disturbances(spec: HandSpec, reference: Reference, seed: int, seconds: float) -> Array:
    """Of a free motion, (k, n), N·m."""
    each, backend = mirror_of(spec), simulated(spec, seed)
    controller = PD(reference, load_gains("v4", spec))
    return np.array([each.latest()["disturbance"] for _ in each.watched(until(seconds, run(backend, controller)))][1:])


def touch(spec: HandSpec, above: Vector, seed: int, force: float, *, moving: bool) -> Touch:
    """Press a fingertip from BEGIN on."""
    rng, backend, each = np.random.default_rng((seed, 5)), simulated(spec, seed), mirror_of(spec)
    middle = (spec.lower + spec.upper) / 2.0
    reference = moves(spec, seed, SECONDS) if moving else Hold(middle)
    finger = spec.fingers[seed % 4]
    joints, body = list(finger.joints), backend.model.body(f"link_{finger.joints[-1]}.0").id
    site, turn = backend.model.site(finger.tip).id, float(np.radians(rng.uniform(-40.0, 40.0)))
    data, since, after, known, found = backend.data, 0, np.inf, np.zeros(4), np.zeros(4)
    for sample in each.watched(until(SECONDS, run(backend, PD(reference, load_gains("v4", spec))))):
        t = sample.state.t
        if t < BEGIN:
            continue
        axes = data.site_xmat[site].reshape(3, 3)
        push = -force * (np.cos(turn) * axes[:, 0] + np.sin(turn) * axes[:, 1])
        torque = np.zeros(backend.model.nv)
        mujoco.mj_applyFT(backend.model, data, push, np.zeros(3), data.site_xpos[site], body, torque)
        backend.push(torque[:N])
        estimate = each.latest()["disturbance"]
        since = since + 1 if (np.abs(estimate[joints]) > above[joints]).any() else 0
        if since >= PERIODS and not np.isfinite(after):
            after = t - BEGIN
        if t > BEGIN + 0.2:
            known, found = known + torque[joints], found + estimate[joints]
    return Touch(after, float(np.linalg.norm(found - known) / np.linalg.norm(known)))


def figures() -> Iterator[tuple[str, float, float, str]]:
    """What a period of the mirror takes of real time."""
    spec = load_spec()
    observer = Observer(spec, drive_of(spec, np.ones(N), np.zeros(N)), PERIOD)
    middle = (spec.lower + spec.upper) / 2.0
    observer.reset(middle)
    duty, down, took = np.full(N, 0.02), np.array([0.0, 0.0, -9.81]), []
    for _ in range(600):
        began = time.perf_counter()
        observer.step(duty, down, middle)
        took.append(time.perf_counter() - began)
    yield "mirror: prediction and correction, of a period", 100 * statistics.median(took) / PERIOD, 3.0, "%"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=200)
    options.add_argument("--hands", type=int, default=5)
    options.add_argument("--minutes", type=float, default=60.0, help="of free motion for false alarms, in all")
    options.add_argument("--learn", type=float, default=60.0, help="s of free motion for thresholds, each hand")
    chosen = options.parse_args()
    for what, measured, bar, unit in figures():
        print(f"{what}: {measured:.2f} {unit}, bar {bar:g}", flush=True)
    specs = [hand(seed) for seed in range(chosen.hands)]
    above = []
    for seed, spec in enumerate(specs):
        free = disturbances(spec, moves(spec, 1000 + seed, chosen.learn), 1000 + seed, chosen.learn)
        above.append(thresholds(free, PERIOD))
        print(f"hand {seed}: floor {1e3 * free[400:].std():.1f} mN·m, thresholds {1e3 * above[-1].min():.1f} to "
              f"{1e3 * above[-1].max():.1f}", flush=True)  # fmt: skip
    for moving in (True, False):
        for force in (0.2, 0.5, 1.0):
            runs = [
                touch(specs[k % len(specs)], above[k % len(specs)], k, force, moving=moving)
                for k in range(chosen.trials)
            ]
            after = np.array([each.after for each in runs])
            error = np.median([each.error for each in runs])
            print(f"{force} N, {'moving' if moving else 'at rest'}: {np.mean(after <= 0.04):.1%} in 40 ms, "
                  f"{np.mean(after <= 0.06):.1%} in 60 ms, median {1e3 * np.median(after):.0f} ms; torque off by "
                  f"{error:.0%}", flush=True)  # fmt: skip
    alarms(specs, above, chosen.minutes)


def alarms(specs: list[HandSpec], above: list[Vector], minutes: float) -> None:
    """Free motions on end, in runs of a minute."""
    count = 0
    for k in range(round(minutes)):
        which = k % len(specs)
        free = disturbances(specs[which], moves(specs[which], 2000 + k, 60.0), 2000 + k, 60.0)[400:]
        over = np.abs(free) > above[which]
        count += int((over[1:] & over[:-1]).any(axis=1).any())
    print(f"{count} of {round(minutes)} minutes of free motion with a false alarm", flush=True)


if __name__ == "__main__":
    main()
