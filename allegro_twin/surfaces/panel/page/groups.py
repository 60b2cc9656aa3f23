"""What is driven, as a person looks for it: finger by finger, and what moves several fingers once, by itself."""

from __future__ import annotations

from typing import NamedTuple

from allegro_twin.spec import HandSpec


class Group(NamedTuple):
    """Motors that belong together."""

    name: str
    joints: tuple[int, ...]
    """In the spec's order of every array, from the palm outward."""


def groups(spec: HandSpec) -> tuple[Group, ...]:
    """Every motor in one of them: those of each finger, and before it those that it shares with others."""
    owners: dict[int, tuple[str, ...]] = {
        joint: tuple(finger.name for finger in spec.fingers if joint in finger.joints) for joint in range(spec.n_joints)
    }
    found: dict[tuple[str, ...], list[int]] = {}
    for finger in spec.fingers:
        for joint in sorted(finger.joints, key=lambda joint: -len(owners[joint])):
            if joint not in found.setdefault(owners[joint], []):
                found[owners[joint]].append(joint)
    if loose := [joint for joint, fingers in owners.items() if not fingers]:
        found[()] = loose
    return tuple(Group(_named(spec, fingers), _ordered(spec, joints)) for fingers, joints in found.items())


def units(spec: HandSpec) -> str:
    """Of positions: where motors move joints through tendons or linkages they are the motors' own."""
    return "of the motor" if spec.followers else "rad"


def _named(spec: HandSpec, fingers: tuple[str, ...]) -> str:
    if len(fingers) == len(spec.fingers) > 1:
        return "all fingers"
    return ", ".join(fingers) or "the rest"


def _ordered(spec: HandSpec, joints: list[int]) -> tuple[int, ...]:
    """As the finger has them, from the palm outward."""
    ways = [finger.joints for finger in spec.fingers if set(joints) <= {*finger.joints}]
    return tuple(joint for joint in ways[0] if joint in joints) if ways else tuple(joints)
