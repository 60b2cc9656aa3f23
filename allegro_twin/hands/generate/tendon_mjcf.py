"""Hands whose motors pull tendons, as MJCF: from a table of facts, models/tendons/<model>.yaml.

A finger is a chain of rows, each a hinge and the link that it carries. A row names the `motor` that pulls it, and how:

- `radius` r, m: the tendon runs over a pulley, so that a motor that has turned by θ and drawn in s θ (its `spool` s)
  leaves Σ rᵢ qᵢ = s θ. Springs decide between the joints: E (q - q₀) = r u with the tension u and the rest q₀ < 0 of a
  spring that is wound up, so a joint begins to move when the tension has overcome its spring.
- `goes` S, rad: an adaptive synergy (Catalano et al., IJRR 33(5), 2014). The free hand is to be at Sᵢ z for a closure z
  from 0 to 1; with stiffnesses Eᵢ that needs R ∝ E S, with Σ Rᵢ Sᵢ = 1 so that z is the tendon's length.
- neither: the motor turns the joint itself; `mirrors` names a joint that turns by the `factor` of it.

What a row `hides` is seen and weighed, and meets nothing: the ends of its neighbours stand there. Fingers that are
`beside` each other meet palm, thumb and things, not one another. A motor that `rubs` has dry friction in its tendon as
LuGre's bristles (`sim/drivetrain/lugre_friction.py`): a force, which costs the engine nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement

from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.generate.mjcf import defaults, options
from allegro_twin.hands.generate.text import document, number, numbers
from allegro_twin.kinematics.orientation import quaternion_from_euler


class TendonRow(NamedTuple):
    """A hinge of a chain, as the table has it."""

    name: str
    facts: dict[str, Any]

    @property
    def motor(self) -> str:
        return str(self.facts.get("motor", ""))


def tables() -> list[Path]:
    """The tables of all tendon hands."""
    return sorted((data_root() / "models" / "tendons").glob("*.yaml"))


def tendon_mjcf(path: Path) -> str:
    """The text of a hand's file."""
    table = read_yaml(path)
    root = Element("mujoco", model=table["name"])
    SubElement(root, "compiler", angle="radian", autolimits="true")
    options(root)
    defaults(root)
    assets = SubElement(root, "asset")
    for name, rgba in table["colors"].items():
        SubElement(assets, "material", name=name, rgba=numbers(rgba), specular="0.3", shininess="0.5")
    palm = SubElement(SubElement(root, "worldbody"), "body", {"name": "palm", "childclass": "hand"})
    boxes = table["palm"]["boxes"]
    for number_, box in enumerate(boxes):
        shape = {"type": "box", "pos": numbers(box["at"]), "size": numbers(box["half"])}
        _seen_and_felt(palm, f"palm_{number_}", shape, box.get("color", "shell"), table["palm"]["mass"] / len(boxes))
    rows = [row for finger in table["fingers"] for row in _finger(palm, table, finger)]
    _excludes(root, table)
    _tendons(root, table, rows)
    _actuators(root, table, rows)
    return document(root, f"tendons/{table['name']}")


def _rows(table: dict[str, Any], finger: str) -> Iterator[TendonRow]:
    """A finger's own values override those of its chain, row by row."""
    facts = table["fingers"][finger]
    own = facts.get("rows", {})
    for place, row in enumerate(table["chains"][facts["chain"]]):
        merged = (
            row | ({"motor": facts["motor"]} if "motor" in facts and "motor" not in row else {}) | own.get(place, {})
        )
        alone = merged.get("motor") and not {"radius", "goes"} & set(merged)
        yield TendonRow(merged["motor"] if alone else f"{finger}_{place}", merged)


def _finger(palm: Element, table: dict[str, Any], finger: str) -> list[TendonRow]:
    parent, facts, rows = palm, table["fingers"][finger], list(_rows(table, finger))
    passes = {"conaffinity": "0"} if facts.get("beside") else {}
    for place, row in enumerate(rows):
        at = facts["at"] if place == 0 else row.facts["at"]
        turned = {"quat": numbers(quaternion_from_euler(facts["rpy"]))} if place == 0 and "rpy" in facts else {}
        name = finger if place == 0 else row.name
        parent = SubElement(parent, "body", {"name": name, "pos": numbers(at), **turned})
        hinge = {"name": row.name, "axis": numbers(row.facts["axis"]), "range": numbers(row.facts["limit"])}
        springs = {key: number(row.facts[key]) for key in ("stiffness", "springref") if key in row.facts}
        rubs = {
            key: number(row.facts.get(key, table["joints"][key])) for key in ("damping", "armature", "frictionloss")
        }
        SubElement(parent, "joint", hinge | springs | rubs)
        radius, length = row.facts["thick"], row.facts["long"]
        start = numbers((0, 0, 0, 0, 0, length))
        capsule = {"type": "capsule", "fromto": start, "size": number(radius)}
        color, mass = row.facts.get("color", "dark"), row.facts["mass"]
        if row.facts.get("hides"):
            SubElement(parent, "geom", {"class": "visual", "material": color, "mass": number(mass), **capsule})
        else:
            _seen_and_felt(parent, row.name, passes | capsule, color, mass)
        if place == len(rows) - 1:
            ball = {"type": "sphere", "pos": numbers((0, 0, length)), "size": number(radius)}
            _seen_and_felt(parent, f"{finger}_end", passes | ball, "tip", 1e-6)
    return rows


def _seen_and_felt(body: Element, name: str, shape: dict[str, str], color: str, mass: float) -> None:
    """One shape for both: a second one to be looked at alone would cost every step, for it has to be sorted out."""
    look = {
        "material": color,
        "group": "2",
        "rgba": "0.5 0.5 0.5 1",
    }  # MuJoCo's own grey, which gives way to the material.
    SubElement(body, "geom", {"class": "collision", "name": name, **look, "mass": number(mass), **shape})


def _excludes(root: Element, table: dict[str, Any]) -> None:
    """The palm and the first links on it, which overlap by construction."""
    contact = SubElement(root, "contact")
    for finger, facts in table["fingers"].items():
        links = [finger, *(row.name for row in list(_rows(table, finger))[1:])]
        for link in links[: table["palm"].get("never_meets", 2)]:
            SubElement(contact, "exclude", body1="palm", body2=link)
        # Links of no length: a rolling joint is two hinges, and what is on either side of them are neighbours.
        for first, second in zip(links, links[2:], strict=False):
            SubElement(contact, "exclude", body1=first, body2=second)
        for other in facts.get("never_meets", ()):
            SubElement(contact, "exclude", body1=finger, body2=other)


def _tendons(root: Element, table: dict[str, Any], rows: list[TendonRow]) -> None:
    tendons = SubElement(root, "tendon")
    for motor, facts in table["motors"].items():
        pulled = [row for row in rows if row.motor == motor and ("radius" in row.facts or "goes" in row.facts)]
        if not pulled:
            continue
        work = sum(row.facts["stiffness"] * row.facts["goes"] ** 2 for row in pulled if "goes" in row.facts)
        own = {key: number(facts[key]) for key in ("armature", "frictionloss") if key in facts}
        own |= {"damping": number(facts["drag"])} if "drag" in facts else {}  # Beyond what the firmware's loop gives.
        fixed = SubElement(tendons, "fixed", {"name": motor, **own})
        for row in pulled:
            if "goes" in row.facts:
                coefficient = row.facts["stiffness"] * row.facts["goes"] / work
            else:
                coefficient = row.facts["radius"] / facts["spool"]
            SubElement(fixed, "joint", joint=row.name, coef=number(round(coefficient, 6)))


def _actuators(root: Element, table: dict[str, Any], rows: list[TendonRow]) -> None:
    actuators, equality = SubElement(root, "actuator"), SubElement(root, "equality")
    for motor, facts in table["motors"].items():
        mine = [row for row in rows if row.motor == motor]
        pulls = any("radius" in row.facts or "goes" in row.facts for row in mine)
        where = {"tendon": motor} if pulls else {"joint": mine[0].name}
        least = 0.0 if pulls else -facts["effort"]  # A tendon is never pushed.
        SubElement(
            actuators, "position", name=motor, kp=number(facts["stiffness"]), kv=number(facts["damping"]),
            ctrlrange=numbers(facts["range"]), forcerange=numbers((least, facts["effort"])), **where,
        )  # fmt: skip
    for motor, facts in table["motors"].items():
        if rub := facts.get("rubs"):
            bristles = (rub["stiffness"], rub["damping"], rub["force"], rub["force"], rub["speed"])
            SubElement(
                actuators, "dcmotor", name=f"{motor}_friction", tendon=motor, motorconst="1e-6 1e-6", resistance="1",
                lugre=numbers(bristles),
            )  # fmt: skip
    for row in rows:
        if "mirrors" in row.facts:
            SubElement(
                equality, "joint", joint1=row.name, joint2=row.facts["mirrors"],
                polycoef=numbers((0, row.facts["factor"], 0, 0, 0)),
            )  # fmt: skip
