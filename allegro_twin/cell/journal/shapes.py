"""What a cell looks like, as plain shapes: arm, hand and what stands around, for a recording and for Rerun."""

from __future__ import annotations

from typing import Any

from allegro_twin.cell.assembly import Room
from allegro_twin.sim.model.appearance import hand_bodies, scene_appearance, shapes_on
from allegro_twin.viewing.skeleton import bodies_of


def cell_look(room: Room) -> dict[str, Any]:
    """Links of `arm` and `hand`, `adapter` on the flange, `objects` and `fixed`; `base`: where the arm stands, m."""
    cell, things = room.cell, tuple(thing.name for thing in room.settings.objects)
    scene = scene_appearance(cell.world.model, room.hand.spec, things)
    adapter = shapes_on(cell.world.model, f"{cell.spec.name}_adapter")
    return {
        "arm": [body.to_json() for body in hand_bodies(cell.spec)],
        "hand": [body.to_json() for body in bodies_of(room.hand.spec)],
        "adapter": [shape.to_json() for shape in adapter],
        "base": [float(x) for x in cell.base.position],
        "objects": scene["objects"],
        "fixed": scene["fixed"],
    }
