"""Parasitic torque: what a joint feels that its motor was not told to give, and that no even friction takes.

    τ = c − d |v| + a cos(N q) + b sin(N q)

c: constant torque, as of a cable, and half of what dry friction differs by between both directions; d: half of what
damping does; a, b: cogging that comes again N times in a turn. It acts through an actuator of its own on the joint.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np

from allegro_twin.types import Array, Vector


class ParasiticTerms(Protocol):
    """The terms of all joints, (n,) each."""

    @property
    def bias_torque(self) -> Vector: ...
    @property
    def uneven_damping(self) -> Vector: ...
    @property
    def cogging_cosine(self) -> Vector: ...
    @property
    def cogging_sine(self) -> Vector: ...
    @property
    def cogging_periods(self) -> Vector: ...


def torque_actuator(joint: str) -> str:
    return f"{joint}_parasitic"


def add_torque(hand: mujoco.MjSpec, joint: str) -> None:
    """An actuator without limits on a joint; its control is the torque, N·m."""
    element = hand.add_actuator(name=torque_actuator(joint), target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    element.set_to_motor()
    element.ctrllimited = element.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE


def torque(terms: ParasiticTerms, position: Array, velocity: Array) -> Array:
    """At joint positions and speeds, (…, n), rad and rad/s."""
    found: Array = terms.bias_torque - terms.uneven_damping * np.abs(velocity)
    if terms.cogging_periods.any():
        angle = terms.cogging_periods * position
        found = found + terms.cogging_cosine * np.cos(angle) + terms.cogging_sine * np.sin(angle)
    return found
