"""HTML of the page: banners, the state of joints, and the health of a hand."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from allegro_twin.hands.description.appearance import series_color
from allegro_twin.kinematics.orientation import angle_between_quaternions
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel.stream import SessionInfo, StreamFrame, goals_reached

GOOD, BAD, CALM = "#0a7d38", "#c8102e", "#555"
FONT = "font:12px/1.5 system-ui,sans-serif;color:#333;padding:2px 12px"
_WARM = 60.0  # °C, from which on the guard fades torques: docs/explanation/safety.md.


class JointGroup(NamedTuple):
    """Motors that belong together."""

    name: str
    joints: tuple[int, ...]
    """In the spec's order of every array, from the palm outward."""


def joint_groups(spec: HandSpec) -> tuple[JointGroup, ...]:
    """Every motor in one group: those of each finger, and before it those that it shares with others."""
    owners: dict[int, tuple[str, ...]] = {
        joint: tuple(finger.name for finger in spec.fingers if joint in finger.joints) for joint in range(spec.n_joints)
    }
    found: dict[tuple[str, ...], list[int]] = {}
    for finger in spec.fingers:
        for joint in sorted(finger.joints, key=lambda joint: -len(owners[joint])):
            if joint not in found.setdefault(owners[joint], []):
                found[owners[joint]].append(joint)
    if loose := [joint for joint, fingers in owners.items() if not fingers]:
        found[()] = loose
    return tuple(JointGroup(_group_name(spec, fingers), _ordered(spec, joints)) for fingers, joints in found.items())


def _group_name(spec: HandSpec, fingers: tuple[str, ...]) -> str:
    if len(fingers) == len(spec.fingers) > 1:
        return "all fingers"
    return ", ".join(fingers) or "the rest"


def _ordered(spec: HandSpec, joints: list[int]) -> tuple[int, ...]:
    """As the finger has them, from the palm outward."""
    orders = [finger.joints for finger in spec.fingers if set(joints) <= {*finger.joints}]
    return tuple(joint for joint in orders[0] if joint in joints) if orders else tuple(joints)


def units(spec: HandSpec) -> str:
    """Unit of positions; where motors move joints through tendons or linkages, of the motors' positions."""
    return "of the motor" if spec.followers else "rad"


def joint_states(spec: HandSpec, frame: StreamFrame) -> str:
    """The heads of the columns, with measured positions and torques that the page's own script draws into the rows of
    the sliders. A joint is its name, its colour, its position within its limits (0 to 1) and in numbers, and its torque
    (-1 to 1) likewise."""
    rows = []
    for group in joint_groups(spec):
        for place, joint in enumerate(group.joints):
            lower, upper, limit = spec.lower[joint], spec.upper[joint], spec.actuation.torque_limit[joint]
            position, torque = float(frame.position[joint]), float(frame.torque[joint])
            part, effort = (position - lower) / (upper - lower), torque / limit
            rows.append([spec.joint_labels[joint], hexed(place), _inside(part, 0.0), f"{position:+.3f}",
                         _inside(effort, -1.0), f"{torque:+.3f}"])  # fmt: skip
    heads = '<span>goal</span><span class="is">is</span><span class="torque">torque</span>'
    return f'<div class="joint-states" data-joints="{escape(json.dumps(rows))}">{heads}</div>'


def episode_state(info: SessionInfo, frame: StreamFrame) -> str:
    """How far an episode is, how far the object from its goal, and whose goal that is."""
    t, limit, reached, by_hand, theirs, plans = frame.look["episode"]
    lines = [f"{t:.1f} of {limit:.0f} s" if t else f"its {limit:.0f} s begin when it is performed"]
    if info.plans and t:
        lines[0] += f" · {plans:.1f} plans a second"
    if info.turns:
        off = angle_between_quaternions(frame.look["object"][3:], frame.look["object_goal"][3:])
        lines += [f"{math.degrees(float(off)):.0f}° from the goal {'set by hand' if theirs else 'of the task'}",
                  goals_reached(int(reached), int(by_hand))]  # fmt: skip
    return f'<div style="{FONT}">{"<br>".join(map(escape, lines))}</div>'


def health(spec: HandSpec, frame: StreamFrame, rate: float) -> str:
    """Warnings of the link, lost periods, and temperatures of the motors."""
    lines = [f"{frame.t:.1f} s since the hand was opened", f"{rate:.0f} pictures a second of the hand's clock",
             f"{frame.lost} periods without a state", *frame.link]  # fmt: skip
    return f'<div style="{FONT}">{"<br>".join(map(escape, lines))}{_temperatures(spec, frame)}</div>'


def _temperatures(spec: HandSpec, frame: StreamFrame) -> str:
    if not any(math.isfinite(value) for value in frame.temperature):
        return "<br>this hand reports no temperatures"
    cells = []
    for group in joint_groups(spec):
        values = "".join(
            f'<td style="padding:0 8px;color:{BAD if frame.temperature[joint] >= _WARM else "#333"}">'
            f"{frame.temperature[joint]:.0f}</td>"
            for joint in group.joints
        )
        cells.append(f"<tr><td>{escape(group.name)}</td>{values}</tr>")
    return f'<table style="margin-top:8px"><tr><td>°C</td></tr>{"".join(cells)}</table>'


def banner(lines: Sequence[tuple[str, str]]) -> str:
    """Lines of a colour and a text each."""
    rows = "".join(f'<div style="color:{color}">{escape(text)}</div>' for color, text in lines)
    return f'<div style="{FONT};font-size:13px">{rows}</div>'


def hexed(number: int) -> str:
    """The colour of a series, as CSS has it."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in series_color(number))


def _inside(part: float, least: float) -> float | None:
    """A part for a bar; None where it is not known."""
    return round(min(max(part, least), 1.0), 3) if math.isfinite(part) else None
