"""Shapes of a scene for Rerun and the panel: hand, arm, objects and surroundings, from a recording's metadata."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from allegro_twin.hands.description.appearance import TABLE, VisualBody, VisualShape, object_appearance
from allegro_twin.spec import HandSpec
from allegro_twin.viewing.skeleton import bodies_of

_ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ArmScenery:
    """The arm that carries the hand."""

    bodies: tuple[VisualBody, ...]
    """Its links."""
    adapter: Sequence[VisualShape]
    """Between its flange and the hand."""
    base: tuple[float, float, float]
    """Where it stands, m, world."""


@dataclass(frozen=True, slots=True)
class Scenery:
    """Everything around the samples of a run."""

    bodies: tuple[VisualBody, ...]
    """The links of the hand."""
    objects: Mapping[str, Sequence[VisualShape]] = field(default_factory=dict)
    """The first is the one that is grasped."""
    fixed: Sequence[VisualShape] = ()
    """In the world."""
    phases: Sequence[tuple[str, float, float]] = ()
    """Name, begin and end, s."""
    palm: tuple[float, ...] = _ORIGIN
    """Where it begins: position, m, and quaternion w, x, y, z, in the world."""
    ghost: str = "target"
    """Label of the second, translucent hand."""
    more: tuple[str, ...] = ()
    """Further quantities of every joint that are drawn, of `layout.MORE`, and with them what happens."""
    link: tuple[str, ...] = ()
    """Names of the counters of the link."""
    arm: ArmScenery | None = None
    """None: the hand is alone."""


def scenery(spec: HandSpec, meta: Mapping[str, Any]) -> Scenery:
    """The scenery that a recording's metadata describe; the first version has only sizes of objects. Raises
    ConfigError."""
    look = meta.get("look")
    phases = tuple((str(name), float(begin), float(end)) for name, begin, end in meta.get("phases", ()))
    if look is None:
        objects = {described["name"]: [_primitive(described)] for described in meta.get("objects", ())}
        fixed = [VisualShape("box", (0.45, 0.45, 0.02), (0.0, 0.0, -0.02), color=(*TABLE, 1.0))] if objects else []
        return Scenery(bodies_of(spec), objects, fixed, phases)
    return Scenery(
        _bodies(look["hand"]) if "hand" in look else bodies_of(spec),
        {name: _shapes(shapes) for name, shapes in look["objects"].items()},
        _shapes(look["fixed"]),
        phases,
        tuple(look["palm"]) if "palm" in look else _ORIGIN,
        arm=ArmScenery(_bodies(look["arm"]), _shapes(look["adapter"]), tuple(look["base"])) if "arm" in look else None,
    )


def _bodies(each: Iterable[Mapping[str, Any]]) -> tuple[VisualBody, ...]:
    return tuple(VisualBody.from_json(body) for body in each)


def _shapes(each: Iterable[Mapping[str, Any]]) -> list[VisualShape]:
    return [VisualShape.from_json(shape) for shape in each]


def _primitive(described: Mapping[str, Any]) -> VisualShape:
    name, color = str(described["name"]), (*object_appearance(str(described["name"])).color, 1.0)
    match described["shape"], described["size"]:
        case "sphere", [d]:
            return VisualShape("sphere", (d / 2,), color=color, paint=name)
        case "cylinder", [d, h]:
            return VisualShape("cylinder", (d / 2, h / 2), color=color, paint=name)
        case "ellipsoid", [short, long]:
            return VisualShape("ellipsoid", (long / 2, short / 2, short / 2), color=color, paint=name)
        case "box", [x, y, z]:
            return VisualShape("box", (x / 2, y / 2, z / 2), color=color, paint=name)
    return VisualShape("sphere", (0.02,), color=color)  # A file of the user's, which old recordings do not hold.
