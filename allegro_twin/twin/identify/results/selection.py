"""The drive that goes into a hand's file: what is not determined stays as it was, and the others fit that.

Values that look alike in the motion are doubtful each and sure together: a torque constant that was found with 4 % of
load friction is 4 % too high in a file without any. With x the values as the descent has them, C their covariance,
h those that stay as they were (x°) and r the others, the most likely r are

    x_r + C_rh C_hh⁻¹ (x°_h − x_h)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from allegro_twin.sim.open_loop import DriveParameters
from allegro_twin.twin.identify.fitting.fit import Fit
from allegro_twin.twin.identify.fitting.parameterisation import index, least, scaled, slope, unscaled

Held = Mapping[str, NDArray[np.bool_]]
"""Which values stay as they were, (n,) for each kind; of the delay one."""


def settled(found: Fit, held: Held, before: DriveParameters) -> DriveParameters:
    """`before`: what is in the file, relative to the calibration of the recordings."""
    drive, n = found.drive, len(found.floor)
    stays = {name: np.where(mask, getattr(before, name), getattr(drive, name)) for name, mask in held.items()}
    x, there = scaled(drive), scaled(replace(drive, **stays))
    fixed = np.zeros(len(x), dtype=bool)
    for name, mask in held.items():
        fixed[index(name, n)] = mask
    inverse = np.linalg.inv(slope(drive))
    C = inverse @ found.spread.covariance @ inverse.T
    moved = np.linalg.solve(C[np.ix_(fixed, fixed)], (there - x)[fixed])
    x = np.where(fixed, there, x + C[:, fixed] @ moved)
    made = unscaled(np.maximum(x, least(n)))
    stays = {name: np.where(mask, getattr(before, name), getattr(made, name)) for name, mask in held.items()}
    return replace(made, **stays)
