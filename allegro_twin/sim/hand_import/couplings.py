"""Joints that an MJCF couples by polynomials, and how far a driven joint goes before a joint that follows it stops."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array

_PLACES = 2001  # Positions of a driven joint that are tried.
_ROUNDING = 2e-3  # rad or m. By less a follower passes its stop where numbers of a file are rounded.


def couplings(model: mujoco.MjModel) -> list[int]:
    """Equalities that couple one joint to another, by number; those that are switched off are left out."""
    of_joints = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_obj2id >= 0)
    return [int(k) for k in np.flatnonzero(of_joints & model.eq_active0.astype(bool))]


def coupled_positions(model: mujoco.MjModel, joint: int, positions: Array) -> dict[int, Array]:
    """Positions of the joints that go with one, by id, rad or m, each of the shape of `positions`: also those that
    follow a follower. A law is inverted where it is a straight line."""
    found, laws, start = {joint: np.asarray(positions)}, couplings(model), model.qpos0[model.jnt_qposadr]
    while True:
        known = len(found)
        for k in laws:
            one, other, law = int(model.eq_obj1id[k]), int(model.eq_obj2id[k]), model.eq_data[k, :5]
            if other in found and one not in found:
                found[one] = start[one] + np.polynomial.polynomial.polyval(found[other] - start[other], law)
            elif one in found and other not in found and law[1] and not law[2:].any():
                found[other] = start[other] + (found[one] - start[one] - law[0]) / law[1]
        if len(found) == known:
            del found[joint]
            return found


def coupled_slopes(model: mujoco.MjModel, joint: int) -> dict[int, float]:
    """How fast the joints that go with one move where the file has it at rest, by id, per speed of that one."""
    at = float(model.qpos0[model.jnt_qposadr[joint]])
    around = coupled_positions(model, joint, np.array([at - 1e-5, at + 1e-5]))
    return {each: float(np.ptp(rows) * np.sign(rows[1] - rows[0]) / 2e-5) for each, rows in around.items()}


def reachable_range(
    model: mujoco.MjModel, joint: int, lower: float, upper: float, path: Path
) -> tuple[float, float, str]:
    """The part of a driven joint's range in which all that follow it are within theirs, rad or m, and a note; no note
    where it is the whole. Raises ConfigError where nothing is left."""
    places = np.linspace(lower, upper, _PLACES)
    rooms = {each: np.minimum(rows - model.jnt_range[each, 0], model.jnt_range[each, 1] - rows)
             for each, rows in coupled_positions(model, joint, places).items() if model.jnt_limited[each]}  # fmt: skip
    if all(room.min() >= -_ROUNDING for room in rooms.values()):
        return lower, upper, ""
    first = min(rooms, key=lambda each: float(rooms[each].min()))
    name, stops = model.joint(first).name, "{:g} … {:g}".format(*model.jnt_range[first])
    own, room = model.joint(joint).name, np.min(list(rooms.values()), axis=0)
    inside = np.flatnonzero(room >= 0.0)
    if len(inside) < 2:
        raise ConfigError(
            f"{path}: joint {name} follows {own} and is outside its own range {stops} wherever {own} is in {lower:g} … "
            f"{upper:g}: correct how it follows, or its range"
        )
    run = max(np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1), key=len)
    low, high = (_crossing(places, room, int(end), step) for end, step in ((run[0], -1), (run[-1], 1)))
    note = (f"the range of {own} is shortened from {lower:g} … {upper:g} to {low:.5g} … {high:.5g}: {name} follows it, "
            f"and has the range {stops}")  # fmt: skip
    return low, high, note


def _crossing(places: Array, room: Array, end: int, step: int) -> float:
    """Where the room ends between a place that has some and the next, which has none."""
    beyond = end + step
    if not 0 <= beyond < len(places):
        return float(places[end])
    share = room[end] / (room[end] - room[beyond])
    return float(places[end] + share * (places[beyond] - places[end]))
