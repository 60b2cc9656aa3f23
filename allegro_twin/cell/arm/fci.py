"""A real Franka arm behind the guard of a simulated one, with the collision thresholds of a cell's config."""

from __future__ import annotations

from allegro_twin.cell.arm.contact_reflex import CollisionSettings
from allegro_twin.cell.arm.limits import arm_limits
from allegro_twin.drivers.franka import CollisionThresholds, FrankaSettings, open_franka
from allegro_twin.hands.description.arms import load_arm_spec
from allegro_twin.safety import Guard
from allegro_twin.spec.arm import Load


def open_fci_arm(
    settings: FrankaSettings, arm: str, load: Load | None = None, collision: CollisionSettings | None = None
) -> Guard:
    """Connect to an arm on its control interface, behind a guard; `load` is what hangs on its flange. Untried on an
    arm. Raises ConfigError, LinkError."""
    spec = load_arm_spec(arm, load)
    thresholds = None if collision is None else fci_thresholds(collision)
    return Guard(open_franka(settings, spec, thresholds), arm_limits(spec))


def fci_thresholds(settings: CollisionSettings) -> CollisionThresholds:
    """What pylibfranka's `set_collision_behavior` takes, which has one set for both phases: the lower of the two."""

    def lower(name: str) -> tuple[float, ...]:
        both = (getattr(settings, f"{name}_acceleration"), getattr(settings, f"{name}_nominal"))
        return tuple(min(pair) for pair in zip(*both, strict=True))

    return CollisionThresholds(
        lower("lower_torque_thresholds"), lower("upper_torque_thresholds"),
        lower("lower_force_thresholds"), lower("upper_force_thresholds"),
    )  # fmt: skip
