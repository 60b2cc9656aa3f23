"""Looks of the cell's camera: at the table until an object is selected, and at what was lifted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.camera.sources import RecordedCamera
from allegro_twin.cell.checks.camera_check import CameraCheck, LiftedPart, check_camera, lifted_part
from allegro_twin.cell.motion.other_objects import on_tray, points_in_tray, tray_filled
from allegro_twin.cell.perception.cloud import finite
from allegro_twin.cell.perception.errors import PerceptionRefusal, check_age
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.steady import TargetTrack, check_steadiness, track_target
from allegro_twin.cell.perception.target import grasp_target
from allegro_twin.cell.planning.object_selection import ObjectSelector, SelectedObject, refusal_outcome
from allegro_twin.cell.planning.stored_grasps import GraspCandidate
from allegro_twin.cell.planning.wanted_object import wanted_first
from allegro_twin.cell.settings import TraySettings
from allegro_twin.cell.states import CellOutcome
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array, HandState, Vector

OnDetection: TypeAlias = Callable[[CameraFrame, "Detection | PerceptionRefusal"], None]
"""Hears what perception says of every picture."""


@dataclass(slots=True)
class Target:
    """The object that the cell goes for, as far as it is known."""

    candidate: GraspCandidate | None = None
    """How it is grasped."""
    through: tuple[Vector, ...] = ()
    """Postures of the arm on the way there, rad."""
    found: Detection | None = None
    """As it was detected last."""
    solid: Solid | None = None
    others: tuple[Array, ...] = ()
    """Points of each other object on the table at the last look, (k, 3), world, m."""

    def select(self, chosen: SelectedObject) -> None:
        """Go for another object."""
        self.candidate, self.through, self.others = chosen.plan.candidate, chosen.plan.through, chosen.others
        self.found, self.solid = chosen.found, chosen.found.solid

    def narrow(self, part: LiftedPart) -> None:
        """What looked like one object was several: this part was lifted, the others are still on the table."""
        self.others += part.rest
        self.found, self.solid = part.found, part.found.solid


class Pictures:
    """Takes pictures one after another, each with the posture of the arm in which it was taken."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        # A live camera's next picture must be a new one. A recording plays from the first look on.
        self._recorded = isinstance(cell.camera, RecordedCamera)
        self._last = None if self._recorded else cell.camera.capture(cell.robot.world.data)
        self._asked: tuple[CameraFrame, Vector] | None = None

    @property
    def is_due(self) -> bool:
        """Whether a picture was asked for and has not come yet."""
        return self._asked is not None

    def ask(self, state: HandState) -> None:
        """Take a picture; `state`: the arm's."""
        self._asked = self._cell.camera.capture(self._cell.robot.world.data), state.position

    def cancel(self) -> None:
        """Drop the picture that was asked for."""
        self._asked = None

    def fetch(self, t: float) -> tuple[CameraFrame, Vector] | None:
        """The picture that was asked for, and the posture of the arm, rad; None before it is there."""
        if self._asked is None or t < self._asked[0].ready - 1e-9:
            return None
        asked, self._asked = self._asked, None
        return asked

    def is_new(self, frame: CameraFrame) -> bool:
        """Whether it is another picture than the last one; it is the last one from now on."""
        new = self._last is None or frame.number != self._last.number
        self._last = frame if new else self._last
        return new

    def too_old(self, frame: CameraFrame, t: float) -> CellOutcome | None:
        """The fault of a camera that gives no new picture for too long; None before that."""
        old = check_age(frame.time, t, self._cell.settings.perception.oldest, self._recorded)
        return None if old is None else CellOutcome("fault", "camera", old.sentence)


class TableLook:
    """Looks at the table until an object is selected, or tells why none is."""

    def __init__(self, cell: Cell, pictures: Pictures, selector: ObjectSelector, on_detection: OnDetection) -> None:
        self._cell, self._pictures, self._selector, self._on_detection = cell, pictures, selector, on_detection
        self.refused: CellOutcome | None = None
        """Why the last picture had nothing to go for."""
        self.landed = False
        """Whether this look shows that what had left the hand over the tray is in it."""
        self.points_in_tray = np.zeros((0, 3))
        """Points of the tray and of its contents, (k, 3), world, m."""
        self._track: TargetTrack | None = None
        self._lost_over_tray = False

    def begin(self) -> None:
        """Look anew."""
        self._pictures.cancel()
        self.refused, self.landed, self._track = None, False, None

    def lose_over_tray(self) -> None:
        """An object left the hand over the tray: the next look tells whether it is in it."""
        self._lost_over_tray = True

    def look(self, state: HandState, hand: HandState | None) -> SelectedObject | None:
        """The object to go for; None while there is no picture, and where `refused` says why there is none."""
        if not self._pictures.is_due:
            self._pictures.ask(state)
        came = self._pictures.fetch(state.t)
        if came is None:
            return None
        frame, posture = came
        if not self._pictures.is_new(frame):
            self.refused = self._pictures.too_old(frame, state.t)
            return None
        chosen = self._selected(frame, posture, self._cell.open if hand is None else hand.position)
        self.refused = None if isinstance(chosen, SelectedObject) else chosen
        return chosen if isinstance(chosen, SelectedObject) else None

    def _selected(self, frame: CameraFrame, posture: Vector, fingers: Vector) -> SelectedObject | CellOutcome:
        cell, settings = self._cell, self._cell.settings
        alone = cell.self_filter.remove_robot(frame.cloud, posture, fingers)
        cloud = without_tray(alone if settings.at_the_wrist else frame.cloud, frame, cell)
        viewpoint = frame.pose.position, frame.pose.rotation
        if settings.tray is not None:
            self._look_into_tray(alone, frame, settings.tray)
            every = cell.pipeline.detect_all(cloud, *viewpoint)
            chosen = self._selector.first(every, frame, alone)
            self._on_detection(frame, chosen.found if isinstance(chosen, SelectedObject) else every[0])
            return chosen
        if cell.wanted is None:
            seen = cell.pipeline.detect(cloud, *viewpoint)
        else:
            seen = wanted_first(cell.pipeline.detect_all(cloud, *viewpoint), cell.wanted)[0]
        self._on_detection(frame, seen)
        seen = self._steady(seen, frame.time)
        if isinstance(seen, PerceptionRefusal):
            return refusal_outcome(seen)
        return self._selector.first([seen], frame, alone)

    def _look_into_tray(self, alone: Cloud, frame: CameraFrame, tray: TraySettings) -> None:
        before = self.points_in_tray
        self.points_in_tray = points_in_tray(frame.pose.world(alone.astype(np.float64)), tray)
        if self._lost_over_tray and tray_filled(before, self.points_in_tray, self._cell.settings.perception.object.gap):
            self.landed = True
            self._selector.put_away()
        self._lost_over_tray = False

    def _steady(self, seen: Detection | PerceptionRefusal, time: float) -> Detection | PerceptionRefusal:
        """The detection, once its target stands still where the settings ask for that; until then why it does not."""
        settings = self._cell.settings.perception
        if settings.steady is None or isinstance(seen, PerceptionRefusal):
            return seen
        target = grasp_target(seen, settings.target)
        if isinstance(target, PerceptionRefusal):
            return target
        self._track = track_target(self._track, target, time, settings.steady)
        return check_steadiness(self._track, settings.steady) or seen


@dataclass(slots=True)
class LiftedLook:
    """Looks at what was lifted."""

    cell: Cell
    pictures: Pictures
    target: Target
    """Narrowed where the picture shows that only a part of it was lifted."""
    check: CameraCheck | None = field(default=None, init=False)
    """What the last picture says."""

    @property
    def is_idle(self) -> bool:
        """Whether no picture was taken, and none is due."""
        return self.check is None and not self.pictures.is_due

    def forget(self) -> None:
        """Drop what was seen."""
        self.check = None
        self.pictures.cancel()

    def begin(self, state: HandState) -> None:
        """Take a picture of what is in the hand; `state`: the arm's."""
        self.check = None
        self.pictures.ask(state)

    def look(self, state: HandState, hand: HandState, grasped: Pose) -> CameraCheck | None:
        """What the picture says; None while it has not come. `grasped`: the palm before the lift."""
        came = None if self.check is not None else self.pictures.fetch(state.t)
        if came is None:
            return self.check
        frame, posture = came
        cell, target, lift, settings = self.cell, self.target, self.cell.settings.lift, self.cell.settings.perception
        if target.found is None or not self.pictures.is_new(frame):
            self.check = CameraCheck(fresh=False)
            return self.check
        cloud = without_tray(cell.self_filter.remove_robot(frame.cloud, posture, hand.position), frame, cell)
        others, moved = np.concatenate([np.empty((0, 3)), *target.others]), (grasped, cell.robot.palm(state))
        self.check = check_camera(frame, cloud, target.found, others, moved, lift, settings)
        part = lifted_part(frame, cloud, target.found, others, moved, lift, settings) if self.check.left else None
        if part is not None:
            target.narrow(part)
            self.check = part.sight
        return self.check


def without_tray(cloud: Cloud, frame: CameraFrame, cell: Cell) -> Cloud:
    """A cloud in which the points of the tray and of what is in it are NaN."""
    tray = cell.settings.tray
    if tray is None:
        return cloud
    known, there = finite(cloud), np.zeros(cloud.shape[:2], np.bool_)
    world = frame.pose.world(cloud[known].astype(np.float64))
    there[known] = on_tray(world, world[:, 2], tray, cell.settings.perception.object.gap)
    return np.where(there[..., None], np.float32(np.nan), cloud)
