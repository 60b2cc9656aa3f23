"""Targets over time: smoothed, without jumps, and whether they are still enough to move for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.settings import SteadySettings
from allegro_twin.cell.perception.target import GraspTarget
from allegro_twin.kinematics.orientation import angle_between_quaternions, slerp
from allegro_twin.types import Array, Vector


@dataclass(frozen=True, slots=True, eq=False)
class TargetSample:
    """One target as it came."""

    time: float
    """When its picture was taken, s."""
    position: Vector
    quaternion: Vector


@dataclass(frozen=True, slots=True, eq=False)
class TargetTrack:
    """The memory of the filters: hand it back with the next target."""

    position: Vector
    """Smoothed, (3,), m."""
    quaternion: Vector
    """Smoothed, w, x, y, z."""
    recent: tuple[TargetSample, ...]
    """What went into it over the window, oldest first."""
    jumped: tuple[TargetSample, ...] = ()
    """What was left out since."""


def track_target(track: TargetTrack | None, target: GraspTarget, time: float, settings: SteadySettings) -> TargetTrack:
    """The track with one more target, of a picture taken at a time, s. One that jumps is left out, until `patience`
    of them in a row say that the thing was moved: then the track begins anew."""
    new = TargetSample(time, target.position, target.quaternion)
    if track is None:
        return TargetTrack(new.position, new.quaternion, (new,))
    last = track.recent[-1]
    if time <= last.time:
        return track  # The same picture again says nothing new.
    if _apart(new, last.position, settings.jump, last.quaternion, settings.turn):
        jumped = (*track.jumped, new)
        if len(jumped) >= settings.patience:
            return TargetTrack(new.position, new.quaternion, (new,))
        return TargetTrack(track.position, track.quaternion, track.recent, jumped)
    part = 1.0 if settings.smooth == 0.0 else 1.0 - float(np.exp(-(time - last.time) / settings.smooth))
    recent = tuple(seen for seen in track.recent if seen.time > time - settings.window)
    position = track.position + part * (new.position - track.position)
    return TargetTrack(position, slerp(track.quaternion, new.quaternion, part), (*recent, new))


def check_steadiness(track: TargetTrack, settings: SteadySettings) -> PerceptionRefusal | None:
    """None where the arm may go: enough targets, all near the smoothed one, and none that jumps."""
    if track.jumped:
        far = float(np.linalg.norm(track.jumped[-1].position - track.position))
        said = f"the target jumped by {far:.3f} m ({len(track.jumped)} of {settings.patience} in a row)"
        return PerceptionRefusal(
            "jump", f"{said}; wait: either it comes back, or the thing was moved and is followed anew"
        )
    if len(track.recent) < settings.count:
        said = f"{len(track.recent)} targets in {settings.window} s, and {settings.count} are needed"
        return PerceptionRefusal("unsteady", f"{said}; wait, or raise the camera's rate or `steady.window`")
    off = [float(np.linalg.norm(seen.position - track.position)) for seen in track.recent]
    turned = [float(angle_between_quaternions(seen.quaternion, track.quaternion)) for seen in track.recent]
    if max(off) > settings.still or max(turned) > settings.straight:
        said = f"the target moves by {max(off):.3f} m and {max(turned):.2f} rad within {settings.window} s"
        return PerceptionRefusal("unsteady", f"{said}; wait until the thing and the arm stand still")
    return None


def _apart(seen: TargetSample, position: Array, distance: float, quaternion: Array, angle: float) -> bool:
    far = float(np.linalg.norm(seen.position - position))
    return far > distance or float(angle_between_quaternions(seen.quaternion, quaternion)) > angle
