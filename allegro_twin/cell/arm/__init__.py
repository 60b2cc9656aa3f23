"""Arms: Cartesian control over the backend that a hand has, what the flange feels, and a hand on the flange.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.cell.arm.arm_with_hand import ArmWithHand, make_arm_with_hand
    from allegro_twin.cell.arm.contact_reflex import CollisionSettings
    from allegro_twin.cell.arm.fci import open_fci_arm
    from allegro_twin.cell.arm.impedance import Impedance, SetpointMotion, Stiffness
    from allegro_twin.cell.arm.target import CartesianTarget, Smoothing

__all__ = [
    "ArmWithHand",
    "CartesianTarget",
    "CollisionSettings",
    "Impedance",
    "SetpointMotion",
    "Smoothing",
    "Stiffness",
    "make_arm_with_hand",
    "open_fci_arm",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "arm_with_hand": (
            "ArmWithHand",
            "make_arm_with_hand",
        ),
        "contact_reflex": ("CollisionSettings",),
        "fci": ("open_fci_arm",),
        "impedance": (
            "Impedance",
            "SetpointMotion",
            "Stiffness",
        ),
        "target": (
            "CartesianTarget",
            "Smoothing",
        ),
    },
)
