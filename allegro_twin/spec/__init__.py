"""Specs: which hand or arm it is, with names, fingers, limits and actuation.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.spec.arm import ArmSpec
    from allegro_twin.spec.coupled_joints import CoupledJoint
    from allegro_twin.spec.drivetrain import Drive
    from allegro_twin.spec.hand import SIDES, Actuation, CommandKind, Finger, ForeignModel, HandSpec, Side

__all__ = [
    "SIDES",
    "Actuation",
    "ArmSpec",
    "CommandKind",
    "CoupledJoint",
    "Drive",
    "Finger",
    "ForeignModel",
    "HandSpec",
    "Side",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "arm": ("ArmSpec",),
        "coupled_joints": ("CoupledJoint",),
        "drivetrain": ("Drive",),
        "hand": ("SIDES", "Actuation", "CommandKind", "Finger", "ForeignModel", "HandSpec", "Side"),
    },
)
