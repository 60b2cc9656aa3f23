"""Ground truth of a simulated cell: which objects are in the tray, on the table, off it, or in the hand."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from allegro_twin.cell.assembly import Cell
from allegro_twin.sim.model.scene import TABLE_END, WALL

_TOUCHES = 0.001
"""m: geoms nearer than this touch."""
_TRAY, _TABLE = "tray_", "table"


class ObjectPlaces(NamedTuple):
    """Names of a cell's objects, by where they are."""

    in_tray: tuple[str, ...] = ()
    """Carried by the tray, or by what is in it, with the middle of mass between the walls."""
    on_table: tuple[str, ...] = ()
    """Anywhere else above the table: also beside the tray, leaning on it, or in the hand."""
    off_table: tuple[str, ...] = ()
    """Beyond the table's edge, or below its top."""


def object_places(cell: Cell) -> ObjectPlaces:
    """Where each object of a cell really is, by MuJoCo's state; pictures do not count."""
    model, data = cell.robot.world.model, cell.robot.world.data
    names = [each.name for each in cell.settings.objects]
    bodies = {name: model.body(name).id for name in names}
    touching = _touching(cell)
    carried, new = set[int | str](), set[int | str]({_TRAY})
    while new:
        carried |= new
        new = {other for one in new for other in touching.get(one, ()) if other in bodies.values()} - carried
    middles = {name: data.subtree_com[body] for name, body in bodies.items()}
    tray = cell.settings.tray

    def inside(name: str) -> bool:
        if tray is None or bodies[name] not in carried or _TABLE in touching.get(bodies[name], ()):
            return False
        return bool(np.all(np.abs(middles[name][:2] - tray.at) < np.array(tray.size) / 2.0 - WALL))

    def off(name: str) -> bool:
        return bool(middles[name][2] < 0.0 or np.abs(middles[name][:2]).max() > TABLE_END)

    within = tuple(name for name in names if inside(name))
    gone = tuple(name for name in names if name not in within and off(name))
    return ObjectPlaces(within, tuple(name for name in names if name not in (*within, *gone)), gone)


def objects_in_hand(cell: Cell) -> tuple[str, ...]:
    """Names of the objects that arm and hand, or what these carry, touch, and that neither table nor tray does."""
    model = cell.robot.world.model
    bodies = {model.body(each.name).id: each.name for each in cell.settings.objects}
    touching = _touching(cell)
    robot = int(model.body_rootid[model.jnt_bodyid[model.joint(cell.robot.spec.joints[0]).id]])
    carried, new = set[int | str](), set[int | str]({robot})
    while new:
        carried |= new
        near = {other for one in new for other in touching.get(one, ()) if other in bodies}
        new = {one for one in near - carried if not touching[one] & {_TABLE, _TRAY}}
    return tuple(name for body, name in bodies.items() if body in carried)


def _touching(cell: Cell) -> dict[int | str, set[int | str]]:
    """Who touches whom: bodies by number, the tray and the table by name."""
    contact = cell.robot.world.data.contact
    found = dict[int | str, set[int | str]]()
    for geoms in contact.geom[contact.dist < _TOUCHES].tolist():
        one, other = (_owner(cell, geom) for geom in geoms)
        found.setdefault(one, set()).add(other)
        found.setdefault(other, set()).add(one)
    return found


def _owner(cell: Cell, geom: int) -> int | str:
    model = cell.robot.world.model
    name = model.geom(geom).name
    if name.startswith(_TRAY):
        return _TRAY
    return _TABLE if name == _TABLE else int(model.body_rootid[model.geom_bodyid[geom]])
