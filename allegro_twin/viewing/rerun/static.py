"""Static entities of a Rerun recording: shapes, names and colours of series, phases, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from allegro_twin.hands.description.appearance import LIMIT, Color, VisualShape, lighten, series_color
from allegro_twin.spec import Finger, HandSpec
from allegro_twin.viewing.scenery import ArmScenery, Scenery
from allegro_twin.viewing.surfaces import join_surfaces, surface_of

FRAMES = {"goal": 0.12, "tool": 0.08}
"""Axes that are drawn in the world, and how long, m: the goal of the flange, and the palm."""
_AXES, _MOMENTS = ("x", "y", "z"), ("about x", "about y", "about z")
_GHOST = (40, 140, 240, 90)
"""RGBA of a hand that is only wanted, or expected."""
_THINNER = 0.0012  # m: such a hand is hidden in the real one where that is where it should be.


def draw_still(stream: rr.RecordingStream, spec: HandSpec, scene: Scenery) -> None:
    """Everything that does not move of itself."""
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for body in scene.bodies:
        path = f"world/palm/{body.name}" if body.parent >= 0 else "world/palm"
        draw_shapes(stream, f"{path}/look", body.shapes)
    for name, shapes in scene.objects.items():
        draw_shapes(stream, f"world/objects/{name}/look", shapes)
    draw_shapes(stream, "world/fixed", scene.fixed)
    for finger in spec.fingers:
        _series(stream, spec, finger, scene)
    parts = [finger.name for finger in spec.fingers] + ["palm"]
    colors = [_rgb(series_color(k)) for k in range(len(parts))]
    stream.log("contact/force", rr.SeriesLines(names=parts, colors=colors), static=True)
    stream.log("world/contact", rr.Arrows3D.from_fields(colors=colors, radii=[0.002]), static=True)
    if scene.link:
        stream.log("mirror/link", rr.SeriesLines(names=list(scene.link)), static=True)
    if scene.phases:
        begins = [begin for _, begin, _ in scene.phases]
        _states(stream, "trial/phase", begins, [name for name, _, _ in scene.phases])


def draw_arm(stream: rr.RecordingStream, spec: HandSpec, arm: ArmScenery) -> None:
    """The arm of a cell, its frames, and its series."""
    stream.log("world/arm", rr.Transform3D(translation=arm.base), static=True)
    for body in arm.bodies:
        draw_shapes(stream, f"world/arm/{body.name}/look", body.shapes)
    draw_shapes(stream, "world/flange/look", arm.adapter)
    for name, length in FRAMES.items():
        stream.log(f"world/{name}", rr.TransformAxes3D(length), static=True)
    for path, names in {"arm/torque": spec.joint_labels, "cell/force": _AXES, "cell/moment": _MOMENTS}.items():
        colors = [_rgb(series_color(k)) for k in range(len(names))]
        stream.log(path, rr.SeriesLines(names=list(names), colors=colors, widths=[1.5]), static=True)


def draw_ghost(stream: rr.RecordingStream, scene: Scenery) -> None:
    """The links of the hand that is only wanted."""
    for body in scene.bodies:
        if body.parent >= 0:
            draw_shapes(stream, f"world/palm/target/{body.name}/look", body.shapes, ghost=True)


def draw_ghost_object(stream: rr.RecordingStream, scene: Scenery, under: str) -> None:
    """The object that is grasped, where it is not; `under`: a path."""
    name, shapes = next(iter(scene.objects.items()))
    draw_shapes(stream, f"{under}/{name}/look", shapes, ghost=True)


def draw_verdict(stream: rr.RecordingStream, scene: Scenery, held: Mapping[str, bool], text: str) -> None:
    """Beside the phases that were checked whether it was `held` in them, and the `text` (Markdown) for all of it."""
    times, states = [0.0], [""]
    for name, begin, end in scene.phases:
        if name in held:
            if times[-1] == begin:
                del times[-1], states[-1]
            times += [begin, end]
            states += ["held" if held[name] else "not held", ""]
    _states(stream, "trial/verdict", times, states)
    stream.log("verdict", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _states(stream: rr.RecordingStream, path: str, times: list[float], names: list[str]) -> None:
    columns = rr.StateChange.columns(state=names)
    stream.send_columns(path, indexes=[rr.TimeColumn("time", duration=times)], columns=columns)


def draw_shapes(stream: rr.RecordingStream, path: str, shapes: Sequence[VisualShape], *, ghost: bool = False) -> None:
    """One mesh of all of them, at rest in the frame of its path."""
    if not shapes:
        return
    whole = join_surfaces([surface_of(shape) for shape in shapes])
    vertices = whole.vertices - _THINNER * whole.normals if ghost else whole.vertices
    look = {"albedo_factor": _GHOST} if ghost else {"vertex_colors": whole.colors}
    mesh = rr.Mesh3D(vertex_positions=vertices, vertex_normals=whole.normals, **look)
    stream.log(path, mesh, static=True)


def _series(stream: rr.RecordingStream, spec: HandSpec, finger: Finger, scene: Scenery) -> None:
    names = [spec.joint_labels[joint] for joint in finger.joints]
    colors = [series_color(k) for k in range(len(names))]
    for kind in ("position", "velocity", "torque", "command", *scene.more):
        lines = rr.SeriesLines(names=names, colors=[_rgb(color) for color in colors], widths=[1.5])
        stream.log(f"joints/{kind}/{finger.name}", lines, static=True)
    wanted = rr.SeriesLines(
        names=[f"{n} {scene.ghost}" for n in names], colors=[_rgb(lighten(c)) for c in colors], widths=[1]
    )
    stream.log(f"joints/target/{finger.name}", wanted, static=True)
    count = len(np.unique(spec.actuation.torque_limit[list(finger.joints)]))
    limits = rr.SeriesLines(names=["limit"] * count + ["- limit"] * count, colors=[_rgb(LIMIT)] * 2 * count, widths=[1])
    stream.log(f"joints/torque_limit/{finger.name}", limits, static=True)


def _rgb(color: Color) -> list[int]:
    return [round(255 * part) for part in color]
