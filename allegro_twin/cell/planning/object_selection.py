"""Selection of the next object on the table: the first with a grasp and a free path of the arm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.checks.grasp_check import pressing_torque, torque_between_fingers
from allegro_twin.cell.motion.empty_grasp import empty_grasp, touching_joints
from allegro_twin.cell.motion.other_objects import box_around, other_objects, protruding_parts, stray_objects
from allegro_twin.cell.perception.errors import PerceptionRefusal, position_text
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.planning.adaptation import GraspAdapter
from allegro_twin.cell.planning.reachability import GraspPlan, plan_grasp
from allegro_twin.cell.planning.release import reaches_tray
from allegro_twin.cell.planning.stored_grasps import GraspCandidate, StoredGrasp, table_object
from allegro_twin.cell.states import CellOutcome
from allegro_twin.errors import ConfigError
from allegro_twin.sim.contact.obstacle_clearance import CLEAR, TableObject
from allegro_twin.types import Array

_TIGHT = 0.005
"""m: less room to other objects than `CLEAR`, where nothing can be taken otherwise."""
_SPARE = 1.5
"""Times the torque from which fingers say that something is there."""
_ALIKE = 0.01
"""m, of every edge of what is alike."""
_SAME = 0.03
"""m: what is seen so near to where something was left is the same."""


@dataclass(frozen=True, slots=True, eq=False)
class SelectedObject:
    """Object that is taken next, with its grasp."""

    found: Detection
    plan: GraspPlan
    others: tuple[Array, ...]
    """Points of each other object on the table, (k, 3), world, m."""


class _Reading(NamedTuple):
    """One interpretation of a cluster, with the objects beside it then."""

    detection: Detection
    beside: tuple[Detection, ...]


class ObjectSelector:
    """Chooses, and remembers what was put away, missed and left. `on_progress` hears how far a search is."""

    def __init__(self, cell: Cell, on_progress: Callable[[str], None] = lambda said: None) -> None:
        self._cell, settings = cell, cell.settings
        self._adapter = (
            None
            if settings.planning is None
            else GraspAdapter(
                cell.hand.spec, settings.planning, settings.hand.gains, settings.seed, on_progress=on_progress
            )
        )
        self._left = list[Solid]()
        self._failed = list[tuple[str, Solid]]()  # Names of grasps that did not hold, and what.
        self.released = 0
        """Objects that were put away."""
        self._most = 0  # Things that were on the table and in the tray at a time.
        self.warning = ""
        """What has become of things that were seen and are neither put away nor on the table; empty where all are."""

    def put_away(self) -> None:
        """One more is in the tray: what was left may be in reach now."""
        self.released += 1
        self._left.clear()
        if self._adapter is not None:
            self._adapter.forget_failures()

    def missed(self, card: StoredGrasp, solid: Solid, *, leave: bool) -> None:
        """A grasp did not hold a solid: it is tried otherwise, or is left for later."""
        self._failed.append((card.name, solid))
        if leave:
            self._left.append(solid)

    def first(
        self, detections: Sequence[Detection | PerceptionRefusal], frame: CameraFrame, alone: Cloud
    ) -> SelectedObject | CellOutcome:
        """Select the first observed object that can be taken, with room to all others or, where none can, with less;
        otherwise the reason. `alone`: the picture's cloud without arm and hand."""
        readings, refused = self._readings(detections), dict[int, CellOutcome]()
        on_table = _least_count(detections)
        self._most = max(self._most, self.released + on_table)
        for clear in (CLEAR, _TIGHT):
            for number, each in enumerate(readings):
                if isinstance(each, PerceptionRefusal):
                    refused[number] = refusal_outcome(each)
                    continue
                solid = each.detection.solid
                if any(_is_there(solid, left) for left in self._left):
                    said = f"the {solid.shape} at {position_text(solid.position)} was not held"
                    refused[number] = CellOutcome("refused", "no_grasp", said)
                    continue
                if clear == CLEAR or each.beside or len(detections) > 1:
                    chosen = self.one(each.detection, frame, alone, clear, each.beside)
                    if isinstance(chosen, SelectedObject):
                        return chosen
                    refused[number] = chosen
            if len(readings) == 1:
                break
        gone = self._most - self.released
        nothing = all(isinstance(each, PerceptionRefusal) and each.reason == "no_object" for each in detections)
        said = f"{self._most} object{'s were' if self._most > 1 else ' was'} seen: see what has become of {gone}"
        self.warning = said if nothing and gone > 0 else ""
        strays = self._strays(frame, alone)
        causes: list[CellOutcome] = [*(refused.values() if on_table or not strays else ()), *strays]
        if len(causes) == 1:
            return causes[0]
        reasons = {each.reason for each in causes}
        said = "; ".join(dict.fromkeys(each.sentence for each in causes))
        return CellOutcome("refused", reasons.pop() if len(reasons) == 1 else "no_grasp", said)

    @staticmethod
    def _readings(detections: Sequence[Detection | PerceptionRefusal]) -> list[_Reading | PerceptionRefusal]:
        """What was seen, in order, and then what it may be instead."""
        found = [one for one in detections if isinstance(one, Detection)]
        first, last = list[_Reading | PerceptionRefusal](), list[_Reading]()
        for one in detections:
            if isinstance(one, PerceptionRefusal):
                first.append(one)
                continue
            rest = tuple(other for other in found if other is not one)
            first.append(_Reading(one, rest))
            for other in one.instead:
                if not any(other is known.detection for known in last):  # Two parts are of one compound.
                    parts = tuple(part for part in one.instead if part is not other)
                    apart = tuple(each for each in rest if all(other is not whole for whole in each.instead))
                    last.append(_Reading(other, (*parts, *apart)))
        return [*first, *last]

    def one(
        self,
        detection: Detection,
        frame: CameraFrame,
        alone: Cloud,
        clear: float = CLEAR,
        known: Sequence[Detection] = (),
    ) -> SelectedObject | CellOutcome:
        """How one is taken, or why it cannot be. `clear`: room to the others, m; `known`: those that were detected."""
        cell = self._cell
        try:
            rest = other_objects(frame, alone, detection, cell.settings.perception, cell.settings.tray, known)
            obstacles = [table_object(each.solid) for each in known] + [box_around(points) for points in rest]
            own = [box_around(points) for points in protruding_parts(detection, cell.settings.perception)]
            plan = self._beside_own(detection.solid, obstacles, own, clear) or self._plan(
                detection.solid, obstacles, clear
            )
        except ConfigError as error:
            return CellOutcome("refused", "no_grasp", str(error))
        return SelectedObject(detection, plan, (*(each.points for each in known), *rest))

    def _beside_own(
        self, solid: Solid, obstacles: Sequence[TableObject], own: Sequence[TableObject], clear: float
    ) -> GraspPlan | None:
        """With room to the object's own handle; None where it has none, or nothing has the room: then fingers may touch
        it."""
        for room in dict.fromkeys((clear, _TIGHT)) if own else ():
            try:
                return self._plan(solid, [*obstacles, *own], room)
            except ConfigError:
                continue
        return None

    def _plan(self, solid: Solid, obstacles: Sequence[TableObject], clear: float) -> GraspPlan:
        """First with a grasp that has not failed with something alike, and that the fingers will tell. Raises
        ConfigError."""
        failed = {name for name, other in self._failed if _alike(other, solid)}

        def prefer(plan: GraspPlan) -> bool:
            return plan.candidate.card.name not in failed and shows_at_fingers(plan.candidate, self._cell)

        return plan_grasp(solid, self._cell, obstacles, self._adapter, clear, self._deliverable(solid), prefer)

    def _deliverable(self, solid: Solid) -> Callable[[GraspPlan], bool]:
        """Whether the arm gets to the tray with what a plan takes; without a tray every plan will do."""
        tray, cell = self._cell.settings.tray, self._cell
        if tray is None:
            return lambda plan: True
        return lambda plan: reaches_tray(tray, plan.candidate.palm, solid, plan.there[1], cell)

    def _strays(self, frame: CameraFrame, alone: Cloud) -> list[CellOutcome]:
        cell, tray = self._cell, self._cell.settings.tray
        table = cell.pipeline.find_table(alone, frame.pose.position, frame.pose.rotation)
        if tray is None or isinstance(table, PerceptionRefusal):  # Why there is no table is said already.
            return []
        said = "something at {} stands outside perception's `region`; put it nearer to the middle"
        places = stray_objects(frame, alone, cell.settings.perception, tray, table)
        return [CellOutcome("refused", "outside", said.format(position_text(place))) for place in places]


def refusal_outcome(refused: PerceptionRefusal) -> CellOutcome:
    """How a run ends by a refusal of perception: a table that is not where the cell has it is a fault of the cell."""
    return CellOutcome("fault" if refused.reason == "table" else "refused", refused.reason, refused.sentence)


def _least_count(detections: Sequence[Detection | PerceptionRefusal]) -> int:
    """So many things are on the table at least: the parts of what may be one body are one, and what is too small to be
    known may be a part of something."""
    bodies = set[int]()
    for each in detections:
        if isinstance(each, Detection):
            whole = next((other for other in each.instead if other.solid.parts), each)
            bodies.add(id(whole))
        elif each.reason not in ("no_object", "small"):
            bodies.add(id(each))
    return len(bodies)


def _is_there(one: Solid, left: Solid) -> bool:
    """Whether it is what was left, and both are compounds or none is."""
    return bool(np.linalg.norm(one.position - left.position) < _SAME) and bool(one.parts) == bool(left.parts)


def _alike(one: Solid, other: Solid) -> bool:
    return one.shape == other.shape and bool(np.abs(np.subtract(one.size, other.size)).max() < _ALIKE)


def shows_at_fingers(candidate: GraspCandidate, cell: Cell) -> bool:
    """Whether the grasp check would see by the fingers that something is between them, with some to spare, where they
    rest as planned; a grasp of which nobody knows where will do."""
    grasp, rest, spec = candidate.card.grasp, candidate.card.rest, cell.hand.spec
    if rest is None:
        return True
    limit = spec.actuation.torque_limit
    torque = np.clip(cell.stiffness * (grasp.squeeze - rest), -limit, limit)
    empty = empty_grasp(cell.settings.hand, grasp, candidate.palm.rotation)
    press = pressing_torque(rest, torque, empty, cell.stiffness, spec.actuation.frictionloss)
    between = torque_between_fingers(press, empty, touching_joints(cell.settings.hand, rest))
    return between > _SPARE * cell.settings.validation.torque
