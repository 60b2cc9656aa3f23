"""Camera check after the lift: is the object in the hand, or still on the table?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from allegro_twin.cell.camera.camera import CameraFrame
from allegro_twin.cell.camera.intrinsics import Cloud
from allegro_twin.cell.motion.other_objects import near_points
from allegro_twin.cell.perception.cloud import Mask, finite, pass_through
from allegro_twin.cell.perception.clusters import find_clusters
from allegro_twin.cell.perception.errors import position_text
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.cell.perception.touching import surface_distance
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
_SOME = 0.15
"""Share of its points whose places are seen empty from which a part of it is gone: edges that scatter have less."""
_WRONG = 0.2
"""Share of the points that a cut between what is gone and what stands may leave on the wrong side."""
_OUT = 0.012
"""m out of the solid that was seen, from which something has moved: its fit may be off by half."""
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
    incomplete: bool = False
    """Some of the places where its points were are seen empty."""
    behind: str = ""
    """That only a part of what was seen as one object was lifted, and where the rest stands."""
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
    incomplete = _is_some(*_depths(frame, cloud, before.points, _SAME)[:2])
    return CameraCheck(
        near >= _FEW and near > beyond, seen >= _FEW and far > (1.0 - _PART) * seen, left, incomplete=incomplete
    )


class LiftedPart(NamedTuple):
    """A part of what was seen that is not where it stood."""

    found: Detection
    rest: tuple[Array, ...]
    """Points of what still stands there, (k, 3) each, world, m."""
    sight: CameraCheck


def lifted_part(
    frame: CameraFrame, cloud: Cloud, before: Detection, others: Array, moved: tuple[Pose, Pose], lift: float,
    settings: PerceptionSettings,
) -> LiftedPart | None:  # fmt: skip
    """Part of what was seen as one object that is seen in the hand, or whose place is seen empty, while the rest still
    stands on the table: then these were objects of their own. A part of a compound, or what lies on one side of a cut
    across the solid. None where there is none. Arguments as of `check_camera`."""
    for part in before.instead if before.solid.parts else ():
        rest = tuple(one.points for one in before.instead if one is not part)
        sight = check_camera(frame, cloud, part, np.concatenate([others, *rest]), moved, lift, settings)
        if not sight.left and (sight.there or sight.gone):
            return LiftedPart(part, rest, sight)
    cut = _cut(before, _behind(frame, cloud, before.points))
    if cut is None:
        return None
    part, stands = cut
    sight = check_camera(frame, cloud, part, np.concatenate([others, stands]), moved, lift, settings)
    if sight.left or not (sight.there or sight.gone) or _strays(frame, cloud, before, part, others, lift, settings):
        return None
    behind = f"a part of what was seen as one object stayed behind, at {position_text(stands.mean(axis=0))}"
    return LiftedPart(part, (stands,), replace(sight, behind=behind))


def _cut(before: Detection, off: Array) -> tuple[Detection, Array] | None:
    """What lies on the gone side of the best cut square to one of the solid's axes, and the points of the other side,
    (k, 3); None where no cut tells what is gone from what stands. `off` as `_behind` has it for the points, (n,)."""
    solid, gone, same = before.solid, off > _SAME, np.abs(off) <= _SAME
    if not _is_some(int(same.sum()), int(gone.sum())):
        return None
    local = (before.points - solid.position) @ solid.axes
    order = np.argsort(local, axis=0)
    gone_below, same_below = np.cumsum(gone[order], axis=0), np.cumsum(same[order], axis=0)  # (n, 3): up to each point.
    wrong = np.stack([gone.sum() - gone_below + same_below, gone_below + same.sum() - same_below])
    upper, last, axis = np.unravel_index(int(np.argmin(wrong)), wrong.shape)
    if wrong[upper, last, axis] > _WRONG * (gone.sum() + same.sum()):
        return None
    at = float(local[order[last, axis], axis])
    members: Mask = (local[:, axis] > at) == bool(upper)
    if not members.any() or members.all():
        return None
    points = before.points[members]
    return replace(before, solid=_half(solid, int(axis), at, upper=bool(upper)), points=points, instead=()), (
        before.points[~members]
    )


def _half(solid: Solid, axis: int, at: float, *, upper: bool) -> Solid:
    """What is left of a solid above or below a cut across one of its axes, at so much from its middle, m."""
    half = 0.5 * solid.size[axis]
    at = float(np.clip(at, -half, half))
    low, high = (at, half) if upper else (-half, at)
    first, second, third = (high - low if k == axis else edge for k, edge in enumerate(solid.size))
    shape = solid.shape if solid.shape == "cylinder" and axis == 0 else "box"
    position = solid.position + 0.5 * (low + high) * solid.axes[:, axis]
    return replace(solid, shape=shape, position=position, size=(first, second, third), parts=())


def _is_some(same: int, far: int) -> bool:
    return far >= _FEW and far > _SOME * (same + far)


def _depths(frame: CameraFrame, cloud: Cloud, points: Array, near: float) -> tuple[int, int, int]:
    """Numbers of points of the world, (n, 3), m, that the camera sees within `near` along the ray, behind which it sees
    something, and before which it does."""
    off = _behind(frame, cloud, points)
    return int((np.abs(off) <= near).sum()), int((off > near).sum()), int((off < -near).sum())


def _behind(frame: CameraFrame, cloud: Cloud, points: Array) -> Array:
    """How far behind each point of the world, (n, 3), m, the camera sees something along the ray, (n,), m; NaN where
    the point is not in the picture, or the picture is unknown there or shows the robot."""
    local = (points - frame.pose.position) @ frame.pose.rotation
    off, ahead = np.full(len(points), np.nan), np.flatnonzero(local[:, 2] > 1e-3)
    column, row = np.rint(frame.lens.pixel(local[ahead])).astype(np.int_).T
    inside = (column >= 0) & (column < frame.lens.width) & (row >= 0) & (row < frame.lens.height)
    seen = ahead[inside]
    off[seen] = cloud[row[inside], column[inside], 2] - local[seen, 2]
    off[~np.isfinite(off)] = np.nan
    return off


def _strays(
    frame: CameraFrame, cloud: Cloud, before: Detection, part: Detection, others: Array, lift: float,
    settings: PerceptionSettings,
) -> bool:  # fmt: skip
    """Whether something that is lower than a lifted part would be is seen out of the solid, where nothing was: it was
    pushed or has toppled."""
    below = float(before.table.height(part.points).min()) + max(lift - _NEAR, _LOW * lift)
    low = _low_points(frame, cloud, before, others, below, settings)
    out = np.min([surface_distance(part, low) for part in before.solid.parts or (before.solid,)], axis=0)
    return int((out > _OUT).sum()) >= settings.object.least


def _low_points(
    frame: CameraFrame, cloud: Cloud, before: Detection, others: Array, below: float, settings: PerceptionSettings
) -> Array:
    """Thinned points of what is on the table, lower than so much, m, and none of the `others`, (n, 3), world, m."""
    thin = cloud[:: settings.stride, :: settings.stride].reshape(-1, 3)
    world = frame.pose.world(thin[finite(thin)].astype(np.float64))
    height = before.table.height(world)
    low = pass_through(world, np.array(settings.region.lower), np.array(settings.region.upper))
    low &= (height > np.maximum(settings.object.above, 3.5 * before.sigma)) & (height < below)
    world = world[low]
    return np.asarray(world[~near_points(world, others, _BESIDE)]) if len(others) else np.asarray(world)


def _on_table(
    frame: CameraFrame, cloud: Cloud, before: Detection, others: Array, lift: float, settings: PerceptionSettings
) -> str:
    """Where an object is on the table that was not there before, as a sentence; or ""."""
    world = _low_points(frame, cloud, before, others, _LOW * lift, settings)
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
