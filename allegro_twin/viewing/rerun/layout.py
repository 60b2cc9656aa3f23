"""Rerun layouts: of a hand with its joints and phases, and of a cell with its camera, forces and states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb

from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.spec import HandSpec
from allegro_twin.viewing.scenery import Scenery
from allegro_twin.viewing.skeleton import Skeleton
from allegro_twin.viewing.views import aimed_view

_TABS = {
    "Position (rad)": ("position", "target"),
    "Torque (N·m)": ("torque", "torque_limit"),
    "Velocity (rad/s)": ("velocity",),
    "Command": ("command",),
}


MORE = {"disturbance": "External torque (N·m)", "residual": "Off by (rad)", "temperature": "Temperature (°C)"}
"""Quantities that a mirror adds."""
_EYE, _AT = (1.4, -1.05, 0.75), (0.5, 0.0, 0.15)
"""m, from the arm's base: the place of the eye of a cell, and the point that it looks at."""


def hand_layout(spec: HandSpec, scenery: Scenery, start: str) -> rrb.Blueprint:
    """A hand; `start` is the first view of it."""
    tabs = [
        rrb.Vertical(*(_plot(finger.name, kinds) for finger in spec.fingers), name=title)
        for title, kinds in _TABS.items()
    ]
    for kind in scenery.more:
        tabs.append(rrb.Vertical(*(_plot(finger.name, (kind,)) for finger in spec.fingers), name=MORE[kind]))
    if scenery.link:
        tabs.append(rrb.TimeSeriesView(origin="mirror/link", name="Link (losses)"))
    if scenery.objects:
        tabs.append(rrb.TimeSeriesView(origin="contact/force", name="Contact force (N)"))
    hand = _scene("Hand", _eye(spec, scenery, start))
    body: rrb.Container = rrb.Horizontal(hand, rrb.Tabs(*tabs), column_shares=[3, 2])
    if scenery.phases:
        marks = rrb.StateTimelineView(origin="trial", name="Phases and verdict")
        words = rrb.TextDocumentView(origin="verdict", name="Verdict")
        body = rrb.Vertical(body, rrb.Horizontal(marks, words, column_shares=[3, 2]), row_shares=[5, 1])
    if scenery.more:
        events = rrb.StateTimelineView(origin="mirror/event", name="What happens")
        body = rrb.Vertical(body, events, row_shares=[6, 1])
    return _blueprint(body)


def cell_layout(hand: HandSpec, arm: HandSpec, base: Sequence[float]) -> rrb.Blueprint:
    """A cell; `base` is where the arm stands, (3,), m, world."""
    eye = rrb.EyeControls3D(position=np.add(base, _EYE), look_target=np.add(base, _AT), eye_up=[0, 0, 1])
    scene = _scene("Cell", eye)
    pictures = rrb.Horizontal(
        rrb.Spatial2DView(origin="cell/colour", name="Colour"), rrb.Spatial2DView(origin="cell/depth", name="Depth")
    )
    force = rrb.Vertical(
        rrb.TimeSeriesView(origin="cell/force", name="Force on the hand (N, mean of 0.1 s)"),
        rrb.TimeSeriesView(origin="cell/moment", name="Torque on the hand (N·m, mean of 0.1 s)"),
        name="Force",
    )
    joints = rrb.TimeSeriesView(origin="arm/torque", name=f"{arm.name}: torque (N·m)")
    fingers = rrb.Vertical(*(_plot(finger.name, ("torque",)) for finger in hand.fingers), name="Fingers: torque (N·m)")
    places = rrb.Vertical(
        *(_plot(finger.name, ("position",)) for finger in hand.fingers), name="Fingers: position (rad)"
    )
    side = rrb.Vertical(pictures, rrb.Tabs(force, joints, fingers, places), row_shares=[1, 2])
    below = rrb.Horizontal(
        rrb.StateTimelineView(origin="cell/state", name="States"),
        rrb.TextLogView(origin="cell/log", name="What happens"),
        column_shares=[1, 1],
    )  # fmt: skip
    body = rrb.Vertical(rrb.Horizontal(scene, side, column_shares=[3, 2]), below, row_shares=[4, 1])
    return _blueprint(body)


def _scene(name: str, eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    background = rrb.Background(color=[222, 229, 238])
    return rrb.Spatial3DView(origin="world", name=name, eye_controls=eye, line_grid=False, background=background)


def _blueprint(body: rrb.Container) -> rrb.Blueprint:
    return rrb.Blueprint(body, rrb.TimePanel(timeline="time", state="collapsed"), collapse_panels=True)


def _plot(finger: str, kinds: tuple[str, ...]) -> rrb.TimeSeriesView:
    contents = [f"+ joints/{kind}/{finger}" for kind in kinds]
    return rrb.TimeSeriesView(origin="joints", contents=contents, name=finger, plot_legend=rrb.Corner2D.RightTop)


def _eye(spec: HandSpec, scenery: Scenery, start: str) -> rrb.EyeControls3D:
    """Eye of a Rerun view, at the same place as the camera's of that name."""
    palm = matrix_from_quaternion(np.array(scenery.palm[3:]))
    target, place = aimed_view(start, spec.side, *Skeleton(scenery.bodies, spec).tips(), palm)
    middle = np.array(scenery.palm[:3]) + palm @ target.middle
    # Rerun's field of view is wider than MuJoCo's.
    return rrb.EyeControls3D(
        position=middle - place.distance * place.direction(spec.side), look_target=middle, eye_up=[0, 0, 1]
    )
