"""What Rerun is told once: the shapes, the names and colours of the series, the phases, and the verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from allegro_twin.description.appearance import LIMIT, Color, lighter, of_series
from allegro_twin.description.shapes import Shape
from allegro_twin.look.scenery import Scenery
from allegro_twin.look.surfaces import joined, surface
from allegro_twin.spec import Finger, HandSpec

_GHOST = (40, 140, 240, 70)
"""RGBA of a hand that is only wanted."""


def draw_still(stream: rr.RecordingStream, spec: HandSpec, scene: Scenery) -> None:
    """Everything that does not move of itself."""
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    pose = np.array(scene.palm)
    stream.log("world/palm", rr.Transform3D(translation=pose[:3], quaternion=rr.Quaternion(xyzw=pose[[4, 5, 6, 3]])))
    for body in scene.bodies:
        path = f"world/palm/{body.name}" if body.parent >= 0 else "world/palm"
        _shapes(stream, f"{path}/look", body.shapes)
        if body.parent >= 0:
            _shapes(stream, f"world/palm/target/{body.name}/look", body.shapes, ghost=True)
    for name, shapes in scene.objects.items():
        _shapes(stream, f"world/objects/{name}/look", shapes)
    _shapes(stream, "world/fixed", scene.fixed)
    for finger in spec.fingers:
        _series(stream, spec, finger)
    parts = [finger.name for finger in spec.fingers] + ["palm"]
    colors = [_rgb(of_series(k)) for k in range(len(parts))]
    stream.log("contact/force", rr.SeriesLines(names=parts, colors=colors), static=True)
    stream.log("world/contact", rr.Arrows3D.from_fields(colors=colors, radii=[0.0018]), static=True)
    for name, begin, _ in scene.phases:
        stream.set_time("time", duration=begin)
        stream.log("trial/phase", rr.StateChange(state=name))
    if scene.phases:
        stream.log("verdict", rr.TextDocument("no verdict yet"))
    stream.reset_time()


def draw_verdict(stream: rr.RecordingStream, scene: Scenery, held: bool, words: str) -> None:
    """At the end of the trial, and in words for all of it."""
    if scene.phases:
        stream.set_time("time", duration=scene.phases[-1][2])
        stream.log("trial/verdict", rr.StateChange(state="held" if held else "not held"))
        stream.reset_time()
    stream.log("verdict", rr.TextDocument(words), static=True)


def _shapes(stream: rr.RecordingStream, path: str, shapes: Sequence[Shape], *, ghost: bool = False) -> None:
    if not shapes:
        return
    whole = joined([surface(shape) for shape in shapes])
    look = {"albedo_factor": _GHOST} if ghost else {"vertex_colors": whole.colors}
    mesh = rr.Mesh3D(vertex_positions=whole.vertices, vertex_normals=whole.normals, **look)
    stream.log(path, mesh, static=True)


def _series(stream: rr.RecordingStream, spec: HandSpec, finger: Finger) -> None:
    names = [spec.aliases[joint] if spec.aliases else spec.joints[joint] for joint in finger.joints]
    colors = [of_series(k) for k in range(len(names))]
    for kind in ("position", "velocity", "torque", "command"):
        lines = rr.SeriesLines(names=names, colors=[_rgb(color) for color in colors], widths=[1.5])
        stream.log(f"joints/{kind}/{finger.name}", lines, static=True)
    wanted = rr.SeriesLines(names=[f"{n} target" for n in names], colors=[_rgb(lighter(c)) for c in colors], widths=[1])
    stream.log(f"joints/target/{finger.name}", wanted, static=True)
    count = len(np.unique(spec.actuation.torque_limit[list(finger.joints)]))
    limits = rr.SeriesLines(names=["limit"] * count + ["- limit"] * count, colors=[_rgb(LIMIT)] * 2 * count, widths=[1])
    stream.log(f"joints/torque_limit/{finger.name}", limits, static=True)


def _rgb(color: Color) -> list[int]:
    return [round(255 * part) for part in color]
