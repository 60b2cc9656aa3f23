"""Scaled parameters of a drive: one row of numbers of about the same size.

K = k (1 − μ) replaces the torque constant k, μ: friction added by a motor's torque. A / K, B / K, F / K and parasitic
torque / K replace armature, damping, friction and parasitic torque. A joint whose motor drives and hardly ever brakes
determines K and not μ; a joint whose link weighs little determines what is divided by K and not K. A descent in k, A, B
and F would have to follow a narrow curved valley.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from allegro_twin.sim.drivetrain.backlash import SMALLEST
from allegro_twin.sim.open_loop import DriveParameters
from allegro_twin.types import Array, Vector

STRAY = ("bias_torque", "stiffness", "uneven_damping", "cogging_cosine", "cogging_sine")
"""Parameters of parasitic torque."""
RIPPLE = ("ripple_cosine", "ripple_sine")
"""Parameters of a motor's torque that changes with the angle, as a share of it."""
COLD = ("cold_friction",)
"""Parameters of friction that falls while a hand warms up."""
NAMES = ("torque_constant", "armature", "damping", "frictionloss", "offset", "mass_scale")
PULLED = (*NAMES[1:4], *STRAY)
"""Parameters that a recording determines per torque constant."""
SHAPE = ("stiction", "stribeck_speed", "bristle", "load_friction")
"""Parameters of friction that breaks away and grows with the motor's torque."""
PLAY, TEETH = ("backlash",), ("gear_compliance",)
"""Parameters of loose links, and of teeth that bend."""
ALL = (*NAMES, *SHAPE, *PLAY, *STRAY, *RIPPLE, *COLD, *TEETH)
"""All parameters that every joint has."""
_UNITS = {
    "torque_constant": 0.1, "armature": 3e-4, "damping": 5e-3, "frictionloss": 5e-3, "offset": 0.01, "mass_scale": 0.05,
    "delay": 1e-3, "stiction": 0.1, "stribeck_speed": 0.02, "bristle": 2e-4,
    "load_friction": 0.02, "backlash": 5e-4,
    "bias_torque": 2e-3, "stiffness": 2e-3, "uneven_damping": 3e-3, "cogging_cosine": 1e-3, "cogging_sine": 1e-3,
    "ripple_cosine": 0.02, "ripple_sine": 0.02, "tilt": 0.01,
    "cold_friction": 0.1, "gear_compliance": 0.02,
}  # fmt: skip
"""How far each may change, about: N·m, kg·m², N·m·s/rad, N·m, rad, 1, s, 1, rad/s, rad, 1, rad, N·m, N·m/rad,
N·m·s/rad, N·m, N·m, 1, 1, rad, 1, rad/(N·m)."""
_FAR = -1e3
_LEAST = {
    "torque_constant": 0.05, "armature": 1e-5, "damping": 0.0, "frictionloss": 0.0, "offset": -0.5, "mass_scale": 0.3,
    "stiction": 1.0, "stribeck_speed": 0.02, "bristle": 2e-4, "load_friction": 0.0,
    "backlash": SMALLEST, "cold_friction": -0.5, "gear_compliance": 0.0,
} | dict.fromkeys((*STRAY, *RIPPLE), _FAR)  # fmt: skip


def index(name: str, n: int) -> slice:
    """Place of one kind of parameter: n values each, then the delay, then the tilt of every recording, three numbers
    each, if any."""
    if name == "tilt":
        return slice(len(ALL) * n + 1, None)
    if name == "delay":
        return slice(len(ALL) * n, len(ALL) * n + 1)
    first = ALL.index(name) * n
    return slice(first, first + n)


def units(n: int, recordings: int = 0) -> Vector:
    """Unit of each number, (p,). `recordings`: those that have a tilt."""
    joints = [np.full(n, _UNITS[name]) for name in ALL]
    return np.concatenate([*joints, [_UNITS["delay"]], np.full(3 * recordings, _UNITS["tilt"])])


def lower_bounds(n: int, recordings: int = 0) -> Vector:
    """Lower bound of each number, (p,)."""
    joints = [np.full(n, _LEAST[name]) for name in ALL]
    return np.concatenate([*joints, [0.0], np.full(3 * recordings, _FAR)]) / units(n, recordings)


def to_scaled(drive: DriveParameters) -> Vector:
    """Scaled parameters, (p,), in the order of `index`."""
    pulls = drive.torque_constant * (1.0 - drive.load_friction)
    values = {name: getattr(drive, name) for name in ALL} | {"torque_constant": pulls}
    values |= {name: values[name] / pulls for name in PULLED}
    row = np.concatenate([*values.values(), drive.delay[:1], drive.tilt.ravel()])
    return np.asarray(row / units(len(pulls), len(drive.tilt)))


def from_scaled(x: Vector, like: DriveParameters) -> DriveParameters:
    """Inverse of `to_scaled`. `like`: a drive of the same hand, for what is not among the parameters."""
    n = len(like.torque_constant)
    values = x * units(n, len(like.tilt))
    rows = {name: values[index(name, n)] for name in ALL}
    pulls = rows["torque_constant"]
    rows |= {name: rows[name] * pulls for name in PULLED}
    rows["torque_constant"] = pulls / (1.0 - rows["load_friction"])
    delay, tilt = np.full(n, values[index("delay", n)]), values[index("tilt", n)].reshape(-1, 3)
    return replace(like, **rows, delay=delay, tilt=tilt)


def scaling_jacobian(drive: DriveParameters) -> Array:
    """Derivative of a drive's values, in the order of `index`, by the scaled parameters, (p, p)."""
    n = len(drive.torque_constant)
    unit = units(n, len(drive.tilt))
    found = np.diag(unit)
    k, load = index("torque_constant", n), index("load_friction", n)
    found[k, k] /= 1.0 - drive.load_friction[:, None]
    found[k, load] = np.diag(unit[load] * drive.torque_constant / (1.0 - drive.load_friction))
    pulls = drive.torque_constant * (1.0 - drive.load_friction)
    for name in PULLED:
        part = index(name, n)
        found[part, part] *= pulls
        found[part, k] = np.diag(unit[k] * getattr(drive, name) / pulls)
    return found
