"""The table of facts of a hand, models/<model>.yaml, as a tree of links; and the mirror rule for the other side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.spec import Side

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class BoxFacts:
    half: Triple
    """Half-sizes, m."""
    at: Triple
    """Centre in the link's frame, m."""


@dataclass(frozen=True, slots=True)
class TipFacts:
    """A fingertip: a capsule along z, whose far sphere's centre is the tip frame."""

    name: str
    mass: float
    radius: float
    start: float
    """Centre of the near sphere, m along z."""
    end: float
    """Centre of the far sphere, m along z."""


@dataclass(frozen=True, slots=True)
class VisualFacts:
    """A shape that is drawn, never touched: a rounded box (half-sizes) or a cylinder along y (radius, half-length)."""

    kind: str
    size: tuple[float, ...]
    radius: float
    at: Triple
    color: str


@dataclass(frozen=True, slots=True)
class JointFacts:
    number: int
    """Its place in every array."""
    name: str
    axis: Triple
    lower: float
    upper: float


@dataclass(frozen=True, slots=True)
class LinkFacts:
    """A rigid body, its place on its parent, and the joint that carries it (None for the palm)."""

    name: str
    kind: str
    parent: str | None
    joint: JointFacts | None
    xyz: Triple
    rpy: Triple
    mass: float
    box: BoxFacts
    tip: TipFacts | None
    visuals: tuple[VisualFacts, ...]


@dataclass(frozen=True, slots=True)
class HandFacts:
    """A whole hand. Links stand parents first."""

    name: str
    side: Side
    links: tuple[LinkFacts, ...]
    fingers: dict[str, tuple[int, ...]]
    mirror_flips: tuple[int, ...]
    never_collide: tuple[tuple[str, str], ...]
    colors: dict[str, tuple[float, ...]]

    @property
    def joints(self) -> tuple[JointFacts, ...]:
        """All joints, in the order of their numbers."""
        found = [link.joint for link in self.links if link.joint is not None]
        return tuple(sorted(found, key=lambda joint: joint.number))

    def last_link(self, finger: str) -> LinkFacts:
        """The one that carries a finger's tip."""
        number = self.fingers[finger][-1]
        return next(link for link in self.links if link.joint is not None and link.joint.number == number)


def has_facts(model: str) -> bool:
    """Whether the facts of a hand are here, from which its files are made."""
    return model.isidentifier() and _table(model).is_file()


def _table(model: str) -> Path:
    return data_root() / "models" / f"{model}.yaml"


def load_facts(model: str, side: Side) -> HandFacts:
    """The description of one hand, from models/<model>.yaml."""
    table = read_yaml(_table(model))
    right = HandFacts(
        name=table["name"],
        side="right",
        links=tuple(_links(table)),
        fingers={name: tuple(finger["joints"]) for name, finger in table["fingers"].items()},
        mirror_flips=tuple(table["mirror_flips"]),
        never_collide=tuple((a, b) for a, b in table["never_collide"]),
        colors={name: tuple(rgba) for name, rgba in table["colors"].items()},
    )
    return right if side == "right" else mirror_facts(right)


def mirror_facts(hand: HandFacts) -> HandFacts:
    """The other hand: every point, rotation and axis reflected in the palm's x-z plane.

    A point goes from (x, y, z) to (x, -y, z), a rotation (roll, pitch, yaw) to (-roll, pitch, -yaw). An axis, being a
    pseudovector, goes from a to -(ax, -ay, az), so that every joint keeps its value; the joints in `mirror_flips` keep
    their axis and change sign instead, as in the manufacturer's left URDF.
    """
    flips = {hand.joints[j].name for j in hand.mirror_flips}

    def reflect(point: Triple) -> Triple:
        return (point[0], _negated(point[1]), point[2])

    def joint(of: JointFacts | None) -> JointFacts | None:
        if of is None:
            return None
        if of.name in flips:
            return replace(of, lower=-of.upper, upper=-of.lower)
        return replace(of, axis=(_negated(of.axis[0]), of.axis[1], _negated(of.axis[2])))

    links = tuple(
        replace(
            link,
            joint=joint(link.joint),
            xyz=reflect(link.xyz),
            rpy=(_negated(link.rpy[0]), link.rpy[1], _negated(link.rpy[2])),
            box=replace(link.box, at=reflect(link.box.at)),
            visuals=tuple(replace(v, at=reflect(v.at)) for v in link.visuals),
        )
        for link in hand.links
    )
    return replace(hand, side="left" if hand.side == "right" else "right", links=links)


def _negated(value: float) -> float:
    return -value if value else 0.0  # No minus zero in the files.


def _links(table: dict[str, Any]) -> list[LinkFacts]:
    zero = (0.0, 0.0, 0.0)
    links = [_link(table, table["root"], "palm", None, None, zero, zero, None)]
    for finger in table["fingers"].values():
        parent = table["root"]
        rows = table["chains"][finger["chain"]]
        called = finger.get("names", [None] * len(rows))
        for number, row, own in zip(finger["joints"], rows, called, strict=True):
            first, last = row is rows[0], row is rows[-1]
            joint = JointFacts(number, own or f"joint_{number}.0", triple(row["axis"]), *map(float, row["limit"]))
            place = finger if first else row
            tip = finger["tip"] if last else None
            name = f"{own}_link" if own else f"link_{number}.0"
            rpy = triple(place.get("rpy", zero))
            links.append(_link(table, name, row["link"], parent, joint, triple(place["xyz"]), rpy, tip))
            parent = name
    return links


def _link(
    table: dict[str, Any],
    name: str,
    kind: str,
    parent: str | None,
    joint: JointFacts | None,
    xyz: Triple,
    rpy: Triple,
    tip_end: float | None,
) -> LinkFacts:
    row = table["links"][kind]
    tip = None
    if tip_end is not None:
        tip = TipFacts(f"{name}_tip", row["tip"]["mass"], row["tip"]["radius"], row["tip"]["from"], tip_end)
    visuals = []
    for part in row["visual"]:
        shape = "rounded" if "rounded" in part else "cylinder"
        visuals.append(
            VisualFacts(shape, tuple(part[shape]), part.get("radius", 0.0), triple(part["at"]), part["color"])
        )
    box = BoxFacts(triple(row["box"]["half"]), triple(row["box"]["at"]))
    return LinkFacts(name, kind, parent, joint, xyz, rpy, row["mass"], box, tip, tuple(visuals))


def triple(values: Any) -> Triple:
    """Three numbers, and no more."""
    x, y, z = (float(value) for value in values)
    return (x, y, z)
