"""Pushing of flat objects over the table's edge before a grasp: start and end of the push."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.control.controllers import PD, GravityFeedforward, PositionControl
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.plan.candidate import round_posture
from allegro_twin.grasping.plan.proposals.opposition import THUMB
from allegro_twin.grasping.scenario import EdgePush, Scenario, as_written, load_protocol
from allegro_twin.grasping.timeline import make_stage, pushed_until
from allegro_twin.grasping.trial import Trial
from allegro_twin.hands.library.gains import load_gains, protocol_gains
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.kinematics.orientation import matrix_facing, matrix_from_quaternion
from allegro_twin.loop import run, until
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.sim.model.scene import Stage
from allegro_twin.sim.objects.catalogue import PlacedObject
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Vector

FACING, FINGERS = (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)
"""The palm looks to the edge, its fingers stand behind the object like a broom."""
BEHIND, RAISED = 0.025, 0.12
"""m: between fingers and object when they come down, for the object may be off; and from how far above they come."""
NEAR, LOWERED, ABOVE = 0.004, 0.05, 0.0005
"""m, of fingertips above the table: by their bounding boxes where the search for it begins, how far it goes, half of
what is left, for a round fingertip climbs on what is thin if it is higher."""
KEPT, STANDING_OUT = 0.025, 0.03
"""m: the centre of mass stays so far from the edge; and so much of the object has to stand out at least."""
STEP, FURTHEST = 0.004, 0.35
"""m, with which the fingers look for the object, and from how far."""
ASTRAY, TILTED = 0.02, np.radians(5.0)
"""m and rad: an object that ends so far from where it was to come, or tilted so far, was not pushed."""
HALVED, EVEN = 20, 0.001
"""Halvings of a finger's way between two postures; m, by which tips of one height differ at most."""


def with_push(scenario: Scenario, spec: HandSpec, folder: Path = Path()) -> Scenario:
    """The scenario with a push that leaves as much of the object as can be beyond the table's edge. Raises ConfigError
    for one without an edge, for an object that fingers do not reach, and for one of which too little would stand out.
    """
    if scenario.edge is None:
        raise ConfigError("a push needs the table's edge: say how far from the object it is, m")
    name = scenario.objects[0].name
    bench = GraspScene(spec, make_stage(scenario, load_protocol(scenario.protocol), spec.side, folder))
    rotation = matrix_facing(FACING, FINGERS)
    posture, tips = _level_fingers(spec)
    middle = np.array(bench.placed.position)
    palm = np.array([middle[0] - FURTHEST, 0.0, 1.0])
    bench.place(palm, rotation, posture)
    centre = bench.centre
    palm[1] = centre[1] - (rotation @ tips.mean(axis=0))[1]
    palm[2] = 1.0 - bench.lowest(palm, rotation, posture) + NEAR
    palm = _first_touch(bench, palm, rotation, posture, (0.0, 0.0, -ABOVE), LOWERED, name)
    palm[2] += 2.0 * ABOVE
    palm = _first_touch(bench, palm, rotation, posture, (STEP, 0.0, 0.0), 2.0 * FURTHEST, name)
    far = middle[0] + scenario.edge - KEPT - centre[0]
    out = bench.foremost + far - middle[0] - scenario.edge
    if not (far > 0.0 and out >= STANDING_OUT):
        raise ConfigError(
            f"object {name}: pushed until its centre of mass is {1000 * KEPT:.0f} mm from the edge, "
            f"{1000 * max(out, 0.0):.0f} mm of it would stand out; a grasp needs {1000 * STANDING_OUT:.0f} mm"
        )
    begin = as_written(spec.side) * (palm - middle - (BEHIND, 0.0, 0.0))
    wrist = {"position": np.round(begin, 4).tolist(), "facing": FACING, "fingers": FINGERS, "retreat": (0, 0, RAISED)}
    push = {
        "distance": round(far + BEHIND, 4),
        "wrist": wrist,
        "posture": (posture if spec.side == "right" else spec.mirror_posture(posture)).tolist(),
    }
    return Scenario.model_validate(scenario.model_dump() | {"push": push})


def _first_touch(
    bench: GraspScene, palm: Array, rotation: Array, posture: Vector, step: tuple[float, float, float], far: float,
    name: str,
) -> Array:  # fmt: skip
    """Where the palm, (3,), m, led on by steps, first has the hand meet something. Raises ConfigError where it does at
    once, or not within `far`, m."""
    for taken in range(round(far / float(np.linalg.norm(step)))):
        place: Array = palm + taken * np.array(step)
        bench.place(place, rotation, posture)
        if bench.meets_anything():
            if taken:
                return place
            break
    raise ConfigError(f"object {name}: the fingers of {bench.spec.name} cannot stand on the table behind it to push it")


def _level_fingers(spec: HandSpec) -> tuple[Vector, Array]:
    """The posture in which most fingers end at one height, a little bent, so that they give way to the table, (n,),
    rad; and where their tips are, (k, 3), m in the palm's frame. Each is between `flat` and `home`."""
    model, bent, flat = hand_kinematics(spec), load_posture("home", spec), load_posture("flat", spec)
    fingers = [finger for finger in spec.fingers if THUMB not in finger.name]
    names = [finger.name for finger in fingers]
    low, high = (model.fingertip_jacobians(each, names)[0][:, 2] for each in (bent, flat))
    heights = sorted(low.tolist(), key=lambda z: (-int(((low <= z) & (z <= high)).sum()), -z))
    posture, level = bent.copy(), heights[0]
    for finger, *span in zip(fingers, low, high, strict=True):
        if not span[0] < level <= span[1]:
            continue
        joints, less, more = list(finger.joints), 0.0, 1.0
        for _ in range(HALVED):
            part = (less + more) / 2.0
            posture[joints] = (bent + part * (flat - bent))[joints]
            tip = model.fingertip_jacobians(posture, [finger.name])[0][0, 2]
            less, more = (part, more) if tip < level else (less, part)
    posture = round_posture(posture, spec)
    tips = model.fingertip_jacobians(posture, names)[0]
    return posture, tips[np.abs(tips[:, 2] - level) < EVEN]


def pushed_stage(scenario: Scenario, stage: Stage, spec: HandSpec, grasp: Grasp, folder: Path = Path()) -> Stage:
    """The stage as it is after the push, which is simulated. Raises ConfigError for an object that does not come to
    lie where it was to."""
    assert scenario.push is not None
    protocol, before = load_protocol(scenario.protocol), stage.objects[0]
    trial = Trial(scenario, spec, grasp, folder=folder)
    gains = load_gains(protocol_gains(protocol.gains, spec), spec)
    controller: Controller[Any] = PositionControl(trial.reference)
    if "torque" in spec.commands:
        controller = PD(trial.reference, gains, GravityFeedforward(hand_kinematics(spec).gravity_torque))
    for _ in trial.watched(until(pushed_until(trial.windows), run(trial.backend, controller))):
        pass
    pose = trial.latest()["object"]
    wanted = pushed_to(scenario.push, np.array(before.position))
    astray, tilt = float(np.linalg.norm(pose[:3] - wanted)), tilt_along_push(np.array(before.quaternion), pose[3:])
    if astray > ASTRAY or tilt > TILTED:
        raise ConfigError(
            f"object {before.grasp_object.name}: the push leaves it {1000 * astray:.0f} mm from where it was to come, "
            f"tilted by {np.degrees(tilt):.0f}°: lay it so that a flat side is towards the fingers"
        )
    placed = PlacedObject(before.grasp_object, tuple(pose[:3].tolist()), tuple(pose[3:].tolist()))
    return replace(stage, objects=[placed, *stage.objects[1:]])


def pushed_to(push: EdgePush, begun: Array) -> Array:
    """Where the middle of an object is to come, (3,), m, that is at `begun`, (3,), m, before the push."""
    place: Array = begun + np.array([push.distance - BEHIND, 0.0, 0.0])
    return place


def tilt_along_push(before: Array, after: Array) -> float:
    """By how much what looked along x, the way of the push, has left the level, rad; from quaternions (4,). A roll
    about x, as of a screwdriver, and a turn on the table are no tilt: neither lets an object fall over the edge."""
    was, turned = matrix_from_quaternion(np.array([before, after]))
    return float(np.arcsin(min(1.0, abs((turned @ was.T)[2, 0]))))
