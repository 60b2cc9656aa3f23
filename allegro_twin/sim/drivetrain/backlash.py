"""Backlash between a motor and its link: a second joint on the first one's axis, with play between two stops.

    A q̈ = k u − B q̇ − friction − τ,    τ = the links' inverse dynamics at q + p,    |p| ≤ backlash / 2 + c |τ|

c, the compliance of the teeth, is 0 where they do not bend. What turns with the motor (armature A, damping B, friction)
stays at the first joint, q; p is the play, in which nothing but grease holds the link, and τ is what the stops pass on.
The encoder sees the link: q + p.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.types import Vector, frozen

SMALLEST = 1e-4
"""rad: what a joint without any has in a model that has backlash. Less than the noise of most encoders."""
_SPRING, _RATIO = 0.001, 0.1  # Impedance of a limit that is a spring; its damping, of critical.
_SWIFTEST = 1.5
"""Largest (angular frequency · time step)² of a link on its teeth, 4 being unstable: a lighter link has softer
teeth."""
_GREASE, _TEETH = 1e-4, 0.001  # N·m·s/rad between the teeth; s, how soft they are: twice a step of 0.5 ms.


def add_backlash(hand: mujoco.MjSpec, joint: str, backlash: float) -> None:
    """A play of so many rad, both ways together."""
    first = hand.joint(joint)
    play = first.parent.add_joint(name=play_joint(joint), pos=first.pos, axis=first.axis)
    play.limited, play.range = mujoco.mjtLimited.mjLIMITED_TRUE, [-backlash / 2.0, backlash / 2.0]
    play.damping, play.solref_limit = [_GREASE, 0, 0], [_TEETH, 1.0]


def play_joint(joint: str) -> str:
    return f"{joint}_play"


def set_backlash(
    model: mujoco.MjModel, plays: NDArray[np.int_], backlash: Vector, compliance: Vector | None = None
) -> None:
    """Set it, rad, at some plays of a compiled model; `compliance`: of their teeth, rad/(N·m), 0: they do not bend.

    A limit of impedance d is a spring of K N·m/rad with `solref` = −K (1 − d) / M, M the inertia that the engine has
    for it. d is so near to 0 that what pushes the limit from outside changes it by a thousandth.
    """
    half = np.maximum(backlash, SMALLEST) / 2.0
    model.jnt_range[plays] = np.stack([-half, half], axis=1)
    for play, bends in zip(plays, np.zeros(len(plays)) if compliance is None else compliance, strict=True):
        if bends > 0.0:
            per_inertia = model.dof_invweight0[model.jnt_dofadr[play]]
            stiffness = min(1.0 / bends, _SWIFTEST / model.opt.timestep**2 / per_inertia)
            damping = 2.0 * _RATIO * np.sqrt(stiffness / per_inertia)
            scale = per_inertia * (1.0 - _SPRING)
            model.jnt_solref[play] = [-stiffness * scale, -damping * scale]
            model.jnt_solimp[play, :2] = _SPRING


def allow_backlash(spec: HandSpec, joints: Sequence[int]) -> HandSpec:
    """Spec of the same hand in which some joints can come loose while it moves: they have a play of SMALLEST until
    then."""
    drive = spec.drive or Drive.from_values({}, spec.n_joints)
    play = drive.backlash.copy()
    play[list(joints)] = np.maximum(play[list(joints)], SMALLEST)
    return replace(spec, drive=replace(drive, backlash=frozen(play)))


def loosen_joint(model: mujoco.MjModel, joint: str, backlash: float) -> None:
    """Give a joint so many rad of play. Raises ConfigError where the model has none to grow."""
    play = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, play_joint(joint))
    if play < 0:
        raise ConfigError(
            f"{joint} cannot come loose in this model: its drive.backlash must be at least {SMALLEST:g} rad"
        )
    set_backlash(model, np.array([play]), np.array([backlash]))
