"""Obstacle clearance of arm and hand on a path: to the table, the observed objects, and each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.sim.model.arm_with_hand import MountedHand
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, standing_orientation
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import Array, Vector

NEAR = 0.005
"""m: what comes nearer is in the way. OWN: what follows a far way lags behind it by millimetres."""
_GIVES = 0.001  # m. What is near at the beginning of a way, or where it leads, may be so on it.
_OBJECT, _TABLE = "seen", "table"
OTHERS = 8
"""So many other solids may be kept clear of."""
_PARTS = 3
"""Solids that the one that is taken may consist of."""
CLEAR = 0.015
"""m, around another object, whose far side nobody has seen."""
_OTHER = "another object"
_SHAPES = {
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, (0,)),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, (0, 2)),
    "lying ellipsoid": (mujoco.mjtGeom.mjGEOM_ELLIPSOID, (0, 1, 2)),
}
"""The geom of a kind of body, and which of its half extents are its sizes; of any other kind it is the box around."""


@dataclass(frozen=True, slots=True, eq=False)
class TableObject:
    """A solid on the table, whichever way it came to be known."""

    kind: str
    """Its shape; with `lying` before it where an axis of revolution is level. `compound`: it has parts."""
    extents: tuple[float, float, float]
    """The longer level one, the shorter level one, the height, m."""
    yaw: float
    """Yaw of the longer level edge in the world, rad."""
    position: Array
    """Middle in the world, (3,), m."""
    parts: tuple[TableObject, ...] = ()
    """Solids of a compound in the world; the compound's extents are those of the box around them."""

    @property
    def solids(self) -> tuple[TableObject, ...]:
        """Itself, or its parts."""
        return self.parts or (self,)


class ClearanceViolation(NamedTuple):
    """Pair of bodies that come too near."""

    part: str
    """A body of the arm or the hand."""
    other: str
    """`the table`, `the thing`, `another object`, or another body of theirs."""
    distance: float
    """m; negative where they would be in each other."""

    def __str__(self) -> str:
        near = f"{1e3 * self.distance:.0f} mm from" if self.distance > 0.0 else f"{-1e3 * self.distance:.0f} mm deep in"
        return f"{self.part} would be {near} {self.other}"


class ObstacleClearance:
    """Arm, hand, table, one thing and other objects, posed and never stepped; for one thread."""

    def __init__(self, arm: ArmSpec, mounted: MountedHand, base: Array) -> None:
        names = [*(f"{_OBJECT} {k}" for k in range(_PARTS)), *(f"{_OTHER} {k}" for k in range(OTHERS))]
        placed = [PlacedObject(GraspObject(name, "box", (0.01, 0.01, 0.01), 0.01), _out(k), (1.0, 0.0, 0.0, 0.0))
                  for k, name in enumerate(names)]  # fmt: skip
        stage = Stage(base, np.array([1.0, 0.0, 0.0, 0.0]), objects=placed, table=True)
        model = compile_scene(arm, stage, mounted)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE  # Its boxes are of the sizes at compile time.
        self._model, self._data = model, mujoco.MjData(model)
        self._arm, self._hand = PostureMap(arm, model), PostureMap(mounted.hand, model)
        geoms = [model.geom(name).id for name in names]
        self._objects, self._others, self._table = geoms[:_PARTS], geoms[_PARTS:], model.geom(_TABLE).id
        self._places = {number: int(model.joint(name).qposadr[0]) for number, name in zip(geoms, names, strict=True)}
        seen = [*geoms, self._table]
        model.geom_margin[seen] = NEAR
        model.body_margin[model.geom_bodyid[seen]] = NEAR
        self.crowded = False
        """Whether other objects stand on the table."""
        self._of_hand = _below(model, model.body("palm_link").id)
        self._moves = _below(model, model.body(f"{arm.name}_link1").id)

    def clear_table(self) -> None:
        """From now on the table is empty."""
        self._stand(self._objects, ())
        self.set_obstacles(())

    def set_obstacles(self, obstacles: Sequence[TableObject], clear: float = CLEAR) -> None:
        """From now on these other objects stand on the table, of at most `OTHERS` solids. `clear`: each is so much
        wider to every side, m."""
        self.crowded = len(obstacles) > 0
        self._stand(self._others, [_wider(solid, clear) for one in obstacles for solid in one.solids])

    def see(self, body: TableObject) -> None:
        """From now on this stands on the table, of at most three solids."""
        self._stand(self._objects, body.solids)

    def _stand(self, geoms: Sequence[int], solids: Sequence[TableObject]) -> None:
        """The first of some geoms are these solids from now on, and the others are far away."""
        for number, solid in zip(geoms, solids, strict=False):
            self._shape(number, solid)
        for number in geoms[len(solids) :]:
            place = self._places[number]
            self._data.qpos[place : place + 3] = _out(number)

    def _shape(self, number: int, one: TableObject) -> None:
        """Geom `number` is this from now on."""
        shape, which = _SHAPES.get(one.kind, (mujoco.mjtGeom.mjGEOM_BOX, (0, 1, 2)))
        place, model = self._places[number], self._model
        half, pose = np.array(one.extents) / 2.0, self._data.qpos[place : place + 7]
        model.geom_type[number] = shape
        model.geom_size[number] = [*half[list(which)], 0.0, 0.0][:3]
        model.geom_aabb[number] = [0.0, 0.0, 0.0, *half]
        model.geom_rbound[number] = float(np.linalg.norm(half))
        pose[:3], pose[3:] = one.position, standing_orientation("z", one.yaw)

    def check_path(self, arm: Array, hand: Array) -> ClearanceViolation | None:
        """The first that comes too near on postures of both, (k, n) each, rad: nearer than in the first, and than in
        the last, where nothing may touch."""
        first, last = self._near(arm[0], hand[0]), self._near(arm[-1], hand[-1])
        for one, other in zip(arm[1:], hand[1:], strict=True):
            for pair, distance in self._near(one, other).items():
                if pair[1] == _OTHER:
                    return ClearanceViolation(*pair, distance)
                end = max(last.get(pair, np.inf) - _GIVES, 0.0)
                if distance < min(_least(pair), first.get(pair, np.inf) - _GIVES, end):
                    return ClearanceViolation(*pair, distance)
        return None

    def of_others(self, arm: Array, hand: Array) -> ClearanceViolation | None:
        """The first of arm and hand that comes too near to another object in postures of both, (k, n) each, rad."""
        for one, other in zip(arm, hand, strict=True):
            for pair, distance in self._near(one, other).items():
                if pair[1] == _OTHER:
                    return ClearanceViolation(*pair, distance)
        return None

    def of_arm(self, arm: Vector, hand: Vector) -> ClearanceViolation | None:
        """What of the arm itself is too near to table or thing in a posture, where the hand may touch both."""
        for (part, other), distance in self._near(arm, hand).items():
            body = self._model.body(part).id
            if other.startswith("the ") and not self._of_hand[body] and distance < NEAR:
                return ClearanceViolation(part, other, distance)
        return None

    def _near(self, arm: Vector, hand: Vector) -> dict[tuple[str, str], float]:
        """Who is nearer than `NEAR`, or in each other, by names; m."""
        model, data = self._model, self._data
        self._arm(arm, data.qpos)
        self._hand(hand, data.qpos)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        found: dict[tuple[str, str], float] = {}
        for geoms, distance in zip(data.contact.geom.tolist(), data.contact.dist.tolist(), strict=True):
            pair = self._pair(*geoms)
            if pair is not None:
                found[pair] = min(found.get(pair, np.inf), distance)
        return found

    def _pair(self, one: int, other: int) -> tuple[str, str] | None:
        outside = dict.fromkeys(self._objects, "the thing") | dict.fromkeys(self._others, _OTHER)
        outside[self._table] = "the table"
        one, other = (other, one) if one in outside else (one, other)
        part, second = (int(self._model.geom_bodyid[geom]) for geom in (one, other))
        if one in outside or not self._moves[part] or (self._of_hand[part] and self._of_hand[second]):
            return None
        return self._model.body(part).name, outside.get(other) or self._model.body(second).name


def _wider(one: TableObject, clear: float) -> TableObject:
    """A solid with so much more to every side, m, but no more height where it is flat on top."""
    up = 0.0 if one.kind in ("box", "cylinder") else clear
    x, y, z = (np.array(one.extents) + 2.0 * np.array([clear, clear, up])).tolist()
    return replace(one, extents=(x, y, z))


def _out(k: int) -> tuple[float, float, float]:
    """A place far from everything, m: nothing was seen."""
    return 5.0 + k, 5.0, 5.0


def _least(pair: tuple[str, str]) -> float:
    """How near two may be, m: links of the same device may touch."""
    return NEAR if pair[1].startswith("the ") else 0.0


def _below(model: mujoco.MjModel, root: int) -> Array:
    """Which bodies hang on one, itself among them, (bodies,)."""
    found = np.zeros(model.nbody, np.bool_)
    found[root] = True
    for body in range(root + 1, model.nbody):  # Parents come first.
        found[body] |= found[model.body_parentid[body]]
    return found
