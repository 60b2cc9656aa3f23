"""Arms alone, behind their guards; and a wall on a spring that one presses on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from allegro_twin.cell.arm.limits import arm_limits
from allegro_twin.cell.arm.target import CartesianTarget
from allegro_twin.controller import Controller
from allegro_twin.hands.description.arms import load_arm_spec
from allegro_twin.kinematics.arm import ArmModel
from allegro_twin.kinematics.pose import Pose
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard
from allegro_twin.sim.engine.backend import Push, SimBackend
from allegro_twin.sim.model.scene import Stage, compile_scene, hand_spec
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import Array, HandState, frozen

WALL = 2000.0  # N/m
GAP = 0.015  # m, from the stick's end to the wall.


class Rig(NamedTuple):
    sim: SimBackend
    guard: Guard
    model: ArmModel
    home: Pose
    target: CartesianTarget

    def after(self, seconds: float, controller: Controller[Any]) -> HandState:
        """The state after so long under a controller."""
        *_, last = until(seconds, run(self.guard, controller))
        return last.state

    def moved(self, state: HandState) -> Array:
        """Of the tool since the start, (3,), m."""
        return np.asarray(self.model.pose(state.position).position - self.home.position)


def rig(name: str = "fer", force: Array | None = None, spec: ArmSpec | None = None) -> Rig:
    """An arm in an empty world; `force` on its flange for every period, (k, 3), N."""
    spec = spec or load_arm_spec(name)
    push = None if force is None else Push(spec.flange, force)
    return _rig(spec, compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))), push)


def at_a_wall(name: str = "fer", frictionloss: float | None = None) -> Rig:
    """An arm with a stick of 0.1 m on its flange, above a plate on a spring that has no friction."""
    spec = load_arm_spec(name)
    if frictionloss is not None:
        spec = replace(spec, actuation=replace(spec.actuation, frictionloss=frozen(np.full(7, frictionloss))))
    scene = hand_spec(spec)
    top = ArmModel(spec).pose(spec.ready).position[2] - 0.11 - GAP
    plate = scene.worldbody.add_body(name="wall", pos=[0.307, 0.0, top - 0.01], gravcomp=1.0)
    joint = plate.add_joint(name="wall", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
    joint.stiffness, joint.damping = [WALL, 0, 0], [60.0, 0, 0]
    plate.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05, 0.05, 0.01], mass=0.2, condim=1, priority=1)
    stick = scene.body(spec.flange).add_body(name="stick")
    stick.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0.02, 0, 0, 0.1], size=[0.01, 0, 0], mass=1e-3)
    return _rig(spec, scene.compile())


def _rig(spec: ArmSpec, scene: mujoco.MjModel, push: Push | None = None) -> Rig:
    sim = SimBackend(spec, scene, period=0.001, pushing=push)
    model = ArmModel(spec)
    home = model.pose(spec.ready)
    return Rig(sim, Guard(sim, arm_limits(spec)), model, home, CartesianTarget(home))
