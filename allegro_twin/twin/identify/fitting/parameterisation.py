"""Scaled parameters of a drive: one row of numbers of about the same size.

K = k (1 − μ) replaces the torque constant k, μ: friction added by a motor's torque. A / K, B / K and F / K replace
armature, damping and friction. A joint whose motor drives and hardly ever brakes determines K and not μ; a joint whose
link weighs little determines what is divided by K and not K. A descent in k, A, B and F would have to follow a narrow
curved valley.
"""

from __future__ import annotations

import numpy as np

from allegro_twin.sim.drivetrain.backlash import SMALLEST
from allegro_twin.sim.open_loop import DriveParameters
from allegro_twin.types import Array, Vector

NAMES = ("torque_constant", "armature", "damping", "frictionloss", "offset", "mass_scale")
PULLED = NAMES[1:4]
"""Parameters that a recording determines per torque constant."""
SHAPE = ("stiction", "stribeck_speed", "bristle", "load_friction")
"""Parameters of friction that breaks away and grows with the motor's torque."""
PLAY = ("backlash",)
"""Parameters of loose links."""
ALL = (*NAMES, *SHAPE, *PLAY)
"""All parameters that every joint has."""
_UNITS = {
    "torque_constant": 0.1, "armature": 3e-4, "damping": 5e-3, "frictionloss": 5e-3, "offset": 0.01, "mass_scale": 0.05,
    "delay": 1e-3, "stiction": 0.1, "stribeck_speed": 0.02, "bristle": 2e-4,
    "load_friction": 0.02, "backlash": 5e-4,
}  # fmt: skip
"""How far each may change, about: N·m, kg·m², N·m·s/rad, N·m, rad, 1, s, 1, rad/s, rad, 1, rad."""
_LEAST = {
    "torque_constant": 0.05, "armature": 1e-5, "damping": 0.0, "frictionloss": 0.0, "offset": -0.5, "mass_scale": 0.3,
    "stiction": 1.0, "stribeck_speed": 0.02, "bristle": 2e-4, "load_friction": 0.0,
    "backlash": SMALLEST,
}  # fmt: skip


def index(name: str, n: int) -> slice:
    """Place of one kind of parameter: n values each, the delay last."""
    if name == "delay":
        return slice(len(ALL) * n, len(ALL) * n + 1)
    first = ALL.index(name) * n
    return slice(first, first + n)


def units(n: int) -> Vector:
    """Unit of each number, (p,)."""
    return np.concatenate([np.full(n, _UNITS[name]) for name in ALL] + [[_UNITS["delay"]]])


def lower_bounds(n: int) -> Vector:
    """Lower bound of each number, (p,)."""
    return np.concatenate([np.full(n, _LEAST[name]) for name in ALL] + [[0.0]]) / units(n)


def to_scaled(drive: DriveParameters) -> Vector:
    """Scaled parameters, (p,), in the order of `index`."""
    values = [getattr(drive, name) for name in ALL] + [drive.delay[:1]]
    values[0] = pulls = drive.torque_constant * (1.0 - drive.load_friction)
    values[1:4] = [value / pulls for value in values[1:4]]
    return np.asarray(np.concatenate(values) / units(len(pulls)))


def from_scaled(x: Vector) -> DriveParameters:
    """Inverse of `to_scaled`."""
    n = len(x) // len(ALL)
    values = x * units(n)
    rows = {name: values[index(name, n)] for name in ALL}
    pulls = rows["torque_constant"]
    rows |= {name: rows[name] * pulls for name in PULLED}
    rows["torque_constant"] = pulls / (1.0 - rows["load_friction"])
    return DriveParameters(**rows, delay=np.full(n, values[-1]))


def scaling_jacobian(drive: DriveParameters) -> Array:
    """Derivative of a drive's values, in the order of `index`, by the scaled parameters, (p, p)."""
    n = len(drive.torque_constant)
    unit = units(n)
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
