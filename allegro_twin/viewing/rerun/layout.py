"""How Rerun arranges what it is given: the hand, its joints finger by finger, and the phases below."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.spec import HandSpec
from allegro_twin.viewing.rerun.scene import Scenery
from allegro_twin.viewing.skeleton import Skeleton
from allegro_twin.viewing.views import seen

_TABS = {
    "Position (rad)": ("position", "target"),
    "Torque (N·m)": ("torque", "torque_limit"),
    "Velocity (rad/s)": ("velocity",),
    "Command": ("command",),
}


MORE = {"disturbance": "External torque (N·m)", "residual": "Off by (rad)", "temperature": "Temperature (°C)"}
"""What a mirror adds."""


def layout(spec: HandSpec, scenery: Scenery, start: str) -> rrb.Blueprint:
    """`start` is the view of the hand that one begins with."""
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
    hand = rrb.Spatial3DView(
        origin="world", name="Hand", eye_controls=_eye(spec, scenery, start), line_grid=False,
        background=rrb.Background(color=[222, 229, 238]),
    )  # fmt: skip
    body: rrb.Container = rrb.Horizontal(hand, rrb.Tabs(*tabs), column_shares=[3, 2])
    if scenery.phases:
        marks = rrb.StateTimelineView(origin="trial", name="Phases and verdict")
        words = rrb.TextDocumentView(origin="verdict", name="Verdict")
        body = rrb.Vertical(body, rrb.Horizontal(marks, words, column_shares=[3, 2]), row_shares=[5, 1])
    if scenery.more:
        events = rrb.StateTimelineView(origin="mirror/event", name="What happens")
        body = rrb.Vertical(body, events, row_shares=[6, 1])
    panel = rrb.TimePanel(timeline="time", state="collapsed")
    return rrb.Blueprint(body, panel, collapse_panels=True)


def _plot(finger: str, kinds: tuple[str, ...]) -> rrb.TimeSeriesView:
    contents = [f"+ joints/{kind}/{finger}" for kind in kinds]
    return rrb.TimeSeriesView(origin="joints", contents=contents, name=finger, plot_legend=rrb.Corner2D.RightTop)


def _eye(spec: HandSpec, scenery: Scenery, start: str) -> rrb.EyeControls3D:
    """The same views as the camera's."""
    palm = matrix_from_quaternion(np.array(scenery.palm[3:]))
    target, place = seen(start, spec.side, *Skeleton(scenery.bodies, spec).tips(), palm)
    middle = np.array(scenery.palm[:3]) + palm @ target.middle
    # Rerun's field of view is wider than MuJoCo's.
    return rrb.EyeControls3D(
        position=middle - place.distance * place.direction(spec.side), look_target=middle, eye_up=[0, 0, 1]
    )
