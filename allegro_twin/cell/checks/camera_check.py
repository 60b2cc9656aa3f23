"""Camera check after the lift: is the object in the hand, or still on the table?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.motion.other_objects import near_points
from allegro_twin.cell.perception.cloud import finite, pass_through
from allegro_twin.cell.perception.clusters import find_clusters
from allegro_twin.cell.perception.errors import position_text
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array

_SAME = 0.008
"""m. A point that is this near to where it was has not moved."""
_NEAR = 0.03
"""m along the ray. So far an object shifts in the hand while the fingers close."""
_FEW = 20
"""Points that have to be seen before they say anything."""
_CLEAR = 0.015
"""m. Of an object on the table, what is lower than this cannot be told from the table behind it."""
_PART = 0.3
"""Share of the points that stood there which must not have moved to be the object."""
_LOW = 0.5
"""Times the lift: what is lower than this has not been lifted."""
_BESIDE = 0.03
"""m. What is this near to something that stood there before is that."""


@dataclass(frozen=True, slots=True)
class CameraCheck:
    """Result of the camera check: where one picture shows the object that was grasped."""

    there: bool = False
    """It is seen in the hand."""
    gone: bool = False
    """The place on the table where it stood is seen, and is empty."""
    left: str = ""
    """Why it is not in the hand: where something is on the table that should be in the air."""
    fresh: bool = True
    """The picture is a new one; of one that is not, nothing else is told."""

    @property
    def held(self) -> bool | None:
        """The word of this check; None where the hand or the arm hides the object."""
        if self.left:
            return False
        return True if self.there else None

    @property
    def hidden(self) -> str:
        """Why it says nothing, for a sentence."""
        return "the camera does not see it in the hand" if self.fresh else "the camera is frozen, or its cable is out"


def check_camera(
    frame: CameraFrame, cloud: Cloud, before: Detection, others: Array, moved: tuple[Pose, Pose], lift: float,
    settings: PerceptionSettings,
) -> CameraCheck:  # fmt: skip
    """The verdict of a picture taken after the lift.

    `cloud` is that of `frame` without arm and hand. `before` is what was found before the grasp, `others` are points of
    other objects then, (k, 3), world, m. `moved`: the palm at the grasp and now. `lift`: by how much, m.
    """
    grasped, now = moved
    turn = now.rotation @ grasped.rotation.T
    carried = (before.points - grasped.position) @ turn.T + now.position
    height = before.table.height(before.points)
    under = max(float(before.table.height(carried).min()), _LOW * lift)  # A tall side covers itself above this.
    stood = before.points[(height > min(_CLEAR, 0.5 * float(height.max()))) & (height < under)]
    same, far, _ = _depths(frame, cloud, stood, _SAME)
    seen = same + far
    left = ""
    if seen >= _FEW and same > _PART * seen:
        left = f"the camera sees it where it stood, at {position_text(before.solid.position)}"
    left = left or _on_table(frame, cloud, before, others, lift, settings)
    near, beyond, _ = _depths(frame, cloud, carried, _NEAR)
    return CameraCheck(near >= _FEW and near > beyond, seen >= _FEW and far > (1.0 - _PART) * seen, left)


class LiftedPart(NamedTuple):
    """A part of what was seen that is not where it stood."""

    found: Detection
    sight: CameraCheck


def lifted_part(
    frame: CameraFrame, cloud: Cloud, before: Detection, others: Array, moved: tuple[Pose, Pose], lift: float,
    settings: PerceptionSettings,
) -> LiftedPart | None:  # fmt: skip
    """Part of a compound that is seen in the hand, or whose place is seen empty, while the compound still stands on the
    table: then its parts were objects of their own. None where there is none, and for what is no compound. Arguments as
    of `check_camera`."""
    for part in before.instead if before.solid.parts else ():
        rest = [one.points for one in before.instead if one is not part]
        sight = check_camera(frame, cloud, part, np.concatenate([others, *rest]), moved, lift, settings)
        if not sight.left and (sight.there or sight.gone):
            return LiftedPart(part, sight)
    return None


def _depths(frame: CameraFrame, cloud: Cloud, points: Array, near: float) -> tuple[int, int, int]:
    """Numbers of points of the world, (n, 3), m, that the camera sees within `near` along the ray, behind which it sees
    something, and before which it does. A point does not count where the picture is unknown or shows the robot."""
    local = (points - frame.pose.position) @ frame.pose.rotation
    local = local[local[:, 2] > 1e-3]
    column, row = np.rint(frame.lens.pixel(local)).astype(np.int_).T
    inside = (column >= 0) & (column < frame.lens.width) & (row >= 0) & (row < frame.lens.height)
    off = cloud[row[inside], column[inside], 2] - local[inside, 2]
    off = off[np.isfinite(off)]
    return int((np.abs(off) <= near).sum()), int((off > near).sum()), int((off < -near).sum())


def _on_table(
    frame: CameraFrame, cloud: Cloud, before: Detection, others: Array, lift: float, settings: PerceptionSettings
) -> str:
    """Where an object is on the table that was not there before, as a sentence; or ""."""
    thin = cloud[:: settings.stride, :: settings.stride].reshape(-1, 3)
    world = frame.pose.world(thin[finite(thin)].astype(np.float64))
    height = before.table.height(world)
    low = pass_through(world, np.array(settings.region.lower), np.array(settings.region.upper))
    low &= (height > np.maximum(settings.object.above, 3.5 * before.sigma)) & (height < _LOW * lift)
    world = world[low]
    if len(others):
        world = world[~near_points(world, others, _BESIDE)]
    if len(world) < settings.object.least:
        return ""
    grid, sizes = find_clusters(world[:, :2], 2.0 * settings.object.gap)
    if sizes.max() < settings.object.least:
        return ""
    middle = world[grid.of(world[:, :2]) == int(np.argmax(sizes)) + 1].mean(axis=0)
    return (
        f"the camera sees an object on the table at {position_text(middle)}, where none was; what was to be taken "
        f"stood at {position_text(before.solid.position)}"
    )
