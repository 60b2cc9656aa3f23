"""How Rerun arranges a cell: the scene, the camera's pictures, forces and torques, and the states below."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from allegro_twin.spec import HandSpec
from allegro_twin.types import Array

_EYE, _AT = (0.85, -1.05, 0.75), (0.25, 0.0, 0.15)
"""m, from the arm's foot: where one looks from, and at what."""


def cell_layout(arm: HandSpec, hand: HandSpec, base: Array) -> rrb.Blueprint:
    """`base` is where the arm stands, (3,), m, world."""
    eye = rrb.EyeControls3D(
        position=base + np.array([0.55, 0.0, 0.0]) + _EYE, look_target=base + np.array([0.25, 0.0, 0.0]) + _AT,
        eye_up=[0, 0, 1],
    )  # fmt: skip
    scene = rrb.Spatial3DView(
        origin="world", name="Cell", eye_controls=eye, line_grid=False,
        background=rrb.Background(color=[222, 229, 238]),
    )  # fmt: skip
    pictures = rrb.Horizontal(
        rrb.Spatial2DView(origin="cell/colour", name="Colour"), rrb.Spatial2DView(origin="cell/depth", name="Depth")
    )
    force = rrb.Vertical(
        rrb.TimeSeriesView(origin="cell/force", name="Force on the hand (N, mean of 0.1 s)"),
        rrb.TimeSeriesView(origin="cell/moment", name="Torque on the hand (N·m, mean of 0.1 s)"),
        name="Force",
    )
    joints = rrb.TimeSeriesView(origin="arm/torque", name=f"{arm.name}: torque (N·m)")
    fingers = rrb.Vertical(*(_plot("torque", finger.name) for finger in hand.fingers), name="Fingers: torque (N·m)")
    places = rrb.Vertical(*(_plot("position", finger.name) for finger in hand.fingers), name="Fingers: position (rad)")
    side = rrb.Vertical(pictures, rrb.Tabs(force, joints, fingers, places), row_shares=[1, 2])
    below = rrb.Horizontal(
        rrb.StateTimelineView(origin="cell/state", name="States"),
        rrb.TextLogView(origin="cell/log", name="What happens"),
        column_shares=[1, 1],
    )  # fmt: skip
    body = rrb.Vertical(rrb.Horizontal(scene, side, column_shares=[3, 2]), below, row_shares=[4, 1])
    return rrb.Blueprint(body, rrb.TimePanel(timeline="time", state="collapsed"), collapse_panels=True)


def _plot(kind: str, finger: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=f"joints/{kind}/{finger}", name=finger, plot_legend=rrb.Corner2D.RightTop)
