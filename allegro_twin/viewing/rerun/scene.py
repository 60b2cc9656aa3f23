"""What there is to be seen beside the hand, and what is known of a trial: from a recording's metadata."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from allegro_twin.hands.description.appearance import TABLE, of_object
from allegro_twin.hands.description.shapes import Body, Shape
from allegro_twin.spec import HandSpec
from allegro_twin.viewing.skeleton import bodies_of


@dataclass(frozen=True, slots=True)
class Scenery:
    """Everything around the samples of a run."""

    bodies: tuple[Body, ...]
    """The links of the hand."""
    objects: Mapping[str, Sequence[Shape]] = field(default_factory=dict)
    """The first is the one that is grasped."""
    fixed: Sequence[Shape] = ()
    """In the world."""
    phases: Sequence[tuple[str, float, float]] = ()
    """Name, begin and end, s."""
    palm: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    """Where it begins: position, m, and quaternion w, x, y, z, in the world."""
    ghost: str = "target"
    """What the second, translucent hand is."""
    more: tuple[str, ...] = ()
    """Further quantities of every joint that are drawn, of `layout.MORE`, and with them what happens."""
    link: tuple[str, ...] = ()
    """What is counted on the link."""


def scenery(spec: HandSpec, meta: Mapping[str, Any]) -> Scenery:
    """Of a recording's metadata; those of the first version give the objects' sizes alone. Raises ConfigError."""
    look = meta.get("look")
    phases = tuple((str(name), float(begin), float(end)) for name, begin, end in meta.get("phases", ()))
    if look is None:
        objects = {thing["name"]: [_primitive(thing)] for thing in meta.get("objects", ())}
        fixed = [Shape("box", (0.45, 0.45, 0.02), (0.0, 0.0, -0.02), color=(*TABLE, 1.0))] if objects else []
        return Scenery(bodies_of(spec), objects, fixed, phases)
    bodies = tuple(Body.from_json(body) for body in look["hand"]) if "hand" in look else bodies_of(spec)
    objects = {name: [Shape.from_json(shape) for shape in shapes] for name, shapes in look["objects"].items()}
    return Scenery(bodies, objects, [Shape.from_json(shape) for shape in look["fixed"]], phases, tuple(look["palm"]))


def _primitive(thing: Mapping[str, Any]) -> Shape:
    name, color = str(thing["name"]), (*of_object(str(thing["name"])).color, 1.0)
    match thing["shape"], thing["size"]:
        case "sphere", [d]:
            return Shape("sphere", (d / 2,), color=color, paint=name)
        case "cylinder", [d, h]:
            return Shape("cylinder", (d / 2, h / 2), color=color, paint=name)
        case "ellipsoid", [short, long]:
            return Shape("ellipsoid", (long / 2, short / 2, short / 2), color=color, paint=name)
        case "box", [x, y, z]:
            return Shape("box", (x / 2, y / 2, z / 2), color=color, paint=name)
    return Shape("sphere", (0.02,), color=color)  # A file of the user's, which old recordings do not hold.
