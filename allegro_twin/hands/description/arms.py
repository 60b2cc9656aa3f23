"""The table of facts of an arm, models/arms/<model>.yaml, as a chain of links and as an ArmSpec."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.description import inertia
from allegro_twin.hands.description.facts import Triple, triple
from allegro_twin.spec import Actuation, Finger
from allegro_twin.spec.arm import ArmSpec, Load, Slowing
from allegro_twin.types import frozen


@dataclass(frozen=True, slots=True)
class Rod:
    """A capsule or a cylinder from one point to another, in the link's frame, m."""

    kind: str
    start: Triple
    end: Triple
    radius: float
    color: str = ""
    """Empty for a shape that is touched and not drawn."""


@dataclass(frozen=True, slots=True)
class ArmLinkFacts:
    """A rigid body and the joint that carries it, about its z."""

    name: str
    joint: str
    """Empty for the base."""
    xyz: Triple
    """Position in the frame of the link before, m."""
    roll: float
    """About the x axis of the link before, rad."""
    lower: float
    upper: float
    body: inertia.MassProperties
    rods: tuple[Rod, ...]


@dataclass(frozen=True, slots=True)
class ArmFacts:
    """A whole arm: its links from the base on, each on the one before."""

    name: str
    links: tuple[ArmLinkFacts, ...]
    flange: float
    """Distance of the flange from the last joint along its axis, m."""
    never_collide: tuple[tuple[int, int], ...]
    """Links by their places in the chain."""
    colors: dict[str, tuple[float, ...]]

    @property
    def driven(self) -> tuple[ArmLinkFacts, ...]:
        """All links but the base."""
        return self.links[1:]


def arm_names() -> list[str]:
    """Names of all arms with a table of facts."""
    return sorted(path.stem for path in (data_root() / "models" / "arms").glob("*.yaml"))


def load_arm_facts(model: str) -> ArmFacts:
    """The chain of an arm. Raises ConfigError with the nearest names."""
    table = _table(model)
    rows: list[dict[str, Any]] = [{}, *table["joints"]]
    return ArmFacts(
        name=table["name"],
        links=tuple(
            _link(table, k, joint, link) for k, (joint, link) in enumerate(zip(rows, table["links"], strict=True))
        ),
        flange=float(table["flange"]),
        never_collide=tuple((a, b) for a, b in table["never_collide"]),
        colors={name: tuple(rgba) for name, rgba in table["colors"].items()},
    )


def load_arm_spec(model: str, load: Load | None = None) -> ArmSpec:
    """The spec of an arm with its load. Raises ConfigError with the nearest names."""
    table = _table(model)
    joints, n = table["joints"], len(table["joints"])
    motor = table["actuation"]
    return ArmSpec(
        model=table["name"],
        side="right",  # An arm has none.
        joints=tuple(f"{table['name']}_joint{k}" for k in range(1, n + 1)),
        fingers=(Finger("arm", tuple(range(n)), f"{table['name']}_flange"),),
        lower=frozen([joint["limit"][0] for joint in joints]),
        upper=frozen([joint["limit"][1] for joint in joints]),
        actuation=Actuation(
            torque_limit=frozen([joint["torque"] for joint in joints]),
            damping=frozen(np.full(n, motor["damping"])),
            armature=frozen(np.broadcast_to(motor["armature"], n)),
            frictionloss=frozen(np.full(n, motor["frictionloss"])),
            velocity_limit=frozen([joint["velocity"] for joint in joints]),
            torque_rate=frozen(np.full(n, motor["torque_rate"])),
        ),
        mirror_flips=(),
        load=load,
        ready=frozen(np.radians(table["ready"])),
        slowing=_slowing(joints),
        silence=float(table["silence"]),
    )


def _slowing(joints: list[dict[str, Any]]) -> Slowing | None:
    if "slowing" not in joints[0]:
        return None
    a, b, lower, upper = zip(*(joint["slowing"] for joint in joints), strict=True)
    return Slowing(frozen(a), frozen(b), frozen(lower), frozen(upper))


def _table(model: str) -> dict[str, Any]:
    if model not in arm_names():
        raise ConfigError(unknown("arm", model, arm_names()))
    return read_yaml(data_root() / "models" / "arms" / f"{model}.yaml")


def _link(table: dict[str, Any], place: int, joint: dict[str, Any], link: dict[str, Any]) -> ArmLinkFacts:
    """Craig's parameters: Rx(α) Tx(a) Tz(d) from the link before, and then the turn about z."""
    name = table["name"]
    roll = math.radians(joint.get("twist", 0.0))
    reach, along = float(joint.get("a", 0.0)), float(joint.get("d", 0.0))
    # Quarter turns are exact, so that equal frames are equal numbers.
    sine, cosine = round(math.sin(roll), 15), round(math.cos(roll), 15)
    lower, upper = map(float, joint.get("limit", (0.0, 0.0)))
    xx, yy, zz, xy, xz, yz = link["inertia"]
    tensor = inertia.nearest_physical(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    touched = [Rod("capsule", triple(r["from"]), triple(r["to"]), r["radius"]) for r in link["touch"]]
    return ArmLinkFacts(
        name=f"{name}_link{place}",
        joint=f"{name}_joint{place}" if place else "",
        xyz=(reach, -sine * along + 0.0, cosine * along + 0.0),
        roll=roll,
        lower=lower,
        upper=upper,
        body=inertia.MassProperties(float(link["mass"]), np.array(link["centre"]), tensor),
        rods=(*touched, *(_seen(row) for row in link["look"])),
    )


def _seen(row: dict[str, Any]) -> Rod:
    kind = "capsule" if "capsule" in row else "cylinder"
    return Rod(kind, triple(row[kind]), triple(row["to"]), row["radius"], row["color"])
