"""A person who presents an object: a soft hold on it that is moved, and lets go."""

from __future__ import annotations

import mujoco

from allegro_twin.sim.objects.catalogue import Placement

NAME = "presenter"
# Chosen so that a 50 g object yields by some 3 mm a newton and sags by 1.5 mm, like one in two fingertips: the hold
# pulls with k = 1600 /s² and is critically damped; the impedance 0.8 is how much of that it may enforce.
_STIFFNESS, _IMPEDANCE = 1600.0, 0.8


def add(spec: mujoco.MjSpec, placement: Placement) -> None:
    """Hold a thing of the scene where it is, from a body without mass that somebody moves."""
    spec.worldbody.add_body(name=NAME, mocap=True, pos=placement.position, quat=placement.quaternion)
    spec.add_equality(
        name=NAME,
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=NAME,
        name2=placement.thing.name,
        # Anchor at the object's middle, pose as placed (zeros: from the model), and the weight of the rotation, m.
        data=[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.05, 0],
        solref=[-_STIFFNESS, -2 * _STIFFNESS**0.5],
        solimp=[_IMPEDANCE, _IMPEDANCE, 0.001, 0.5, 2],
    )
