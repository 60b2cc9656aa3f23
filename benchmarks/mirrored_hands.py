"""Hands with a mirror beside them, for `benchmarks.mirror`: how they move, and what pushes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.backend import torque_of
from allegro_twin.control.controllers import PD
from allegro_twin.control.trajectory import Hold, Moves, Reference, Waypoint
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.kinematics.orientation import quaternion_facing
from allegro_twin.loop import run, until
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.physics import Physics
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.observer.observer import StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.twin.identify.results.gap import drive_parameters, has_breakaway_friction
from allegro_twin.twin.mirror.contact_detection import PERIODS, joint_thresholds, push_ratio
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array, Sample, frozen

PERIOD, N = 0.003, 16
FULL = 1200  # Counts of full PWM on a v4 hand, 1 N·m here.
COUNT = float(np.radians(333.3 / 65536))
BEGIN, LATEST, AFTER = 2.0, 5.0, 0.4  # s: when a push begins, at the latest, and how long it lasts.
MOVING = 0.1  # rad/s of at least two joints of the finger.
POSES = (((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)), ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0)))
WALL, SOFT = 3000.0, 10.0  # N/m, N·s/m.


class Touch(NamedTuple):
    """One trial."""

    after: float
    """s until it was noticed; infinite where it was not."""
    error: float
    """Of the torques of the touched finger after 0.2 s, as a share of them."""
    moved: bool
    """Whether a joint of the finger moved by a count in the first 60 ms: where none does dry friction holds it, and
    nobody can see anything."""


def hand(seed: int, *, mismatched: bool = False) -> HandSpec:
    """One of many, with a drive of its own; `mismatched`: friction that breaks away and grows with the torque."""
    rng, spec = np.random.default_rng((seed, 3)), load_spec()
    own = replace(
        spec.actuation,
        armature=rng.uniform(0.0015, 0.0045, N),
        damping=rng.uniform(0.0368, 0.1102, N),
        frictionloss=rng.uniform(0.0, 0.06, N),
    )
    drive = {"encoder_noise": 5e-5, "quantisation": COUNT, "delay": float(rng.uniform(0.0, 0.006)), "seed": seed}
    if mismatched:
        ranges = {"stiction": (1.2, 1.8), "stribeck_speed": (0.08, 0.2), "bristle": (5e-4, 2e-3)}
        drive |= {name: rng.uniform(*ends, N).tolist() for name, ends in ranges.items()} | {"load_friction": 0.05}
    return replace(spec, actuation=own, drive=Drive.from_values(drive, N))


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


def mirror_of(spec: HandSpec, *, coulomb: bool = False) -> Mirror:
    """With the hand's true drive; `coulomb`: but that its friction is Coulomb's whatever the hand's is."""
    bristly = has_breakaway_friction(spec.drive) and not coulomb
    return Mirror(
        spec, StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), PERIOD, bristly=bristly), np.ones(N)
    )


def heard(samples: Iterator[Sample], spec: HandSpec) -> Iterator[Sample]:
    """A stage: as torque the counts that the host sent for the period, as on a bus, whatever motors make of it."""
    sent, limit = np.zeros(N), spec.actuation.torque_limit
    for state, command in samples:
        yield Sample(replace(state, torque=frozen(sent)), command)
        sent = np.trunc(np.clip(torque_of(command, spec), -limit, limit) * FULL) / FULL


def disturbances(
    spec: HandSpec, seed: int, seconds: float, *, coulomb: bool = False
) -> tuple[Array, NDArray[np.bool_]]:
    """Of a free motion, N·m, and which joints moved for a while, (k, n) each."""
    each, backend = mirror_of(spec, coulomb=coulomb), simulated(spec, seed)
    controller = PD(moves(spec, seed, seconds), load_gains("v4", spec))
    samples = heard(until(seconds, run(backend, controller)), spec)
    rows = [(each.columns()["disturbance"], each.moving) for _ in each.watch(samples)][1:]
    return np.array([row for row, _ in rows]), np.array([moving for _, moving in rows])


Push = Callable[[Array, Array], Array]
"""From where a fingertip is, m, and how fast it is, m/s, the force on it, N, (3,) each, world."""


def constant(force: float, turn: float) -> Callable[[Array, Array, Array], Push]:
    """From the pad side, `turn` (rad) about it. Made from the tip's axes (3, 3), place and speed when it begins."""

    def begun(axes: Array, place: Array, speed: Array) -> Push:
        direction = -(np.cos(turn) * axes[:, 0] + np.sin(turn) * axes[:, 1])
        return lambda now, fast: force * direction

    return begun


def wall(axes: Array, place: Array, speed: Array) -> Push:
    """A stiff one, at the fingertip, against the way that it moves."""
    normal = -speed / max(float(np.linalg.norm(speed)), 1e-9)

    def push(now: Array, fast: Array) -> Array:
        deep = float((place - now) @ normal)
        return np.asarray(max(WALL * deep - SOFT * float(fast @ normal), 0.0) * normal * (deep > 0.0))

    return push


def touch(
    spec: HandSpec,
    above: Array,
    seed: int,
    pushing: Callable[[Array, Array, Array], Push],
    least: float,
    *,
    moving: bool,
    coulomb: bool = False,
) -> Touch:
    """Press a fingertip while its finger moves, or rests. It counts from when the force is `least`, N."""
    backend, each, finger = simulated(spec, seed), mirror_of(spec, coulomb=coulomb), spec.fingers[seed % 4]
    middle = (spec.lower + spec.upper) / 2.0
    reference = moves(spec, seed, LATEST + AFTER) if moving else Hold(middle)
    joints, model, data = list(finger.joints), backend.model, backend.data
    body, site = model.body(f"link_{joints[-1]}.0").id, model.site(finger.tip).id
    push: Push | None = None
    begun, felt, since, after, known, found = np.inf, np.inf, 0, np.inf, np.zeros(4), np.zeros(4)
    jacobian, first, moved = np.zeros((3, model.nv)), np.zeros(4), False
    samples = heard(until(LATEST + AFTER, run(backend, PD(reference, load_gains("v4", spec)))), spec)
    for sample in each.watch(samples):
        t, ready = sample.state.t, not moving or (np.abs(sample.state.velocity[joints]) > MOVING).sum() >= 2
        if t < BEGIN or (push is None and not ready and t < LATEST):
            continue
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        place, speed = data.site_xpos[site].copy(), jacobian @ data.qvel
        if push is None:
            push, begun = pushing(data.site_xmat[site].reshape(3, 3).copy(), place, speed), t
            first = data.qpos[joints].copy()
        if t > begun + AFTER:
            break
        force, torque = push(place, speed), np.zeros(model.nv)
        mujoco.mj_applyFT(model, data, force, np.zeros(3), place, body, torque)
        backend.push(torque[:N])
        felt = min(felt, t) if np.linalg.norm(force) >= least - 1e-9 else felt
        moved |= t <= felt + 0.06 and bool((np.abs(data.qpos[joints] - first) > COUNT).any())
        estimate = each.columns()["disturbance"]
        held = np.where(each.moving, 0.0, above[2])
        outside = push_ratio(estimate, joint_thresholds(above, each.moving), spec, joints, held) > 1.0
        since = since + 1 if t > felt and outside else 0
        after = min(after, t - felt) if since >= PERIODS else after
        if t > begun + 0.2:
            known, found = known + torque[joints], found + estimate[joints]
    return Touch(after, float(np.linalg.norm(found - known)) / max(float(np.linalg.norm(known)), 1e-9), moved)
