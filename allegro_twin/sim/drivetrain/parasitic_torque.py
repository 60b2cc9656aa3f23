"""Parasitic torque: what a joint feels that its motor was not told to give, and that no even friction takes.

    τ = c − s q − d |v| + a cos(N q) + b sin(N q) + τ_m (A cos(M q) + B sin(M q))

c: constant torque, as of a cable, and half of what dry friction differs by between both directions; s: stiffness of a
spring; d: half of what damping differs by; a, b: cogging that comes again N times in a turn; A, B: ripple of the
motor's torque τ_m, which comes again M times in a turn. It acts through an actuator of its own on the joint.
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
    def stiffness(self) -> Vector: ...
    @property
    def uneven_damping(self) -> Vector: ...
    @property
    def cogging_cosine(self) -> Vector: ...
    @property
    def cogging_sine(self) -> Vector: ...
    @property
    def cogging_periods(self) -> Vector: ...
    @property
    def ripple_cosine(self) -> Vector: ...
    @property
    def ripple_sine(self) -> Vector: ...
    @property
    def ripple_periods(self) -> Vector: ...


def torque_actuator(joint: str) -> str:
    return f"{joint}_parasitic"


def add_torque(hand: mujoco.MjSpec, joint: str) -> None:
    """An actuator without limits on a joint; its control is the torque, N·m."""
    element = hand.add_actuator(name=torque_actuator(joint), target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    element.set_to_motor()
    element.ctrllimited = element.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE


def torque(terms: ParasiticTerms, position: Array, velocity: Array, motor: Array | float = 0.0) -> Array:
    """At joint positions and speeds, (…, n), rad and rad/s, of motors that give so much, (…, n), N·m."""
    found: Array = terms.bias_torque - terms.uneven_damping * np.abs(velocity)
    if terms.stiffness.any():
        found = found - terms.stiffness * position
    if terms.cogging_periods.any():
        angle = terms.cogging_periods * position
        found = found + terms.cogging_cosine * np.cos(angle) + terms.cogging_sine * np.sin(angle)
    if terms.ripple_periods.any():
        angle = terms.ripple_periods * position
        found = found + motor * (terms.ripple_cosine * np.cos(angle) + terms.ripple_sine * np.sin(angle))
    return found
