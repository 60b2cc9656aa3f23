"""Compensation of a tool's own weight in the wrench of the flange's sensor, and how the tool is identified by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from allegro_twin.array_api import cross
from allegro_twin.errors import ConfigError
from allegro_twin.spec.arm import Load
from allegro_twin.types import Array, Vector, frozen

_LIKE = 1e-2  # Of the least singular value of the gravities in one column: poses that hardly differ.


@dataclass(frozen=True, slots=True, eq=False)
class WrenchCompensation:
    """Compensation of the tool's weight: from the flange's measured wrench to the external one.

    w_ext = w_meas - (m Rᵀg; c × m Rᵀg) - bias, in the flange's frame; R is the flange's orientation in the base. The
    tool is taken to be at rest: what its acceleration costs is felt as a force.
    """

    load: Load
    bias: Vector = field(default_factory=lambda: frozen(np.zeros(6)))
    """What the sensor shows of nothing, (6,), N and N·m."""

    def flange_wrench(self, wrench: Vector, axes: Array, gravity: Vector) -> Vector:
        """What touches the tool, at the flange in its frame, (6,), N and N·m. `gravity` is in the base, m/s²."""
        return wrench - tool_weight(self.load, axes, gravity) - self.bias

    def base_wrench(self, wrench: Vector, axes: Array, gravity: Vector, at: Vector) -> Vector:
        """External wrench on the tool in the axes of the base, about a point `at` of the flange's frame, (3,), m: (6,),
        N and N·m."""
        measured = self.flange_wrench(wrench, axes, gravity)
        force = measured[:3]
        return np.concatenate([axes @ force, axes @ (measured[3:] - cross(at, force))])

    def with_tare(self, wrenches: Sequence[Vector]) -> WrenchCompensation:
        """The compensation under which the mean of the flange's `wrenches`, (6,) each, N and N·m, is zero. Raises
        ConfigError without samples."""
        if not len(wrenches):
            raise ConfigError("a tare needs at least one sample: let the arm rest and take some")
        return replace(self, bias=frozen(self.bias + np.mean(wrenches, axis=0)))


class IdentifiedTool(NamedTuple):
    """A tool as its weight shows it."""

    load: Load
    bias: Vector
    """(6,), N and N·m."""
    residual: float
    """Residual of the force, root mean square, N."""


def tool_weight(load: Load, axes: Array, gravity: Vector) -> Vector:
    """(m Rᵀg; c × m Rᵀg), (6,), N and N·m."""
    force = load.mass * (axes.T @ gravity)
    return np.concatenate([force, cross(np.asarray(load.centre), force)])


def identify_tool(axes: Sequence[Array], wrenches: Sequence[Vector], gravity: Vector) -> IdentifiedTool:
    """Mass, centre and bias by least squares, from what the flange felt at rest in several orientations.

    With gₖ = Rₖᵀg: fₖ = m gₖ + b_f and τₖ = -[gₖ]ₓ (m c) + b_τ, linear in (m, m c, b). Raises ConfigError for poses
    that are too much alike: three that differ by some 30° about two axes are enough.
    """
    down = np.array([each.T @ gravity for each in axes])
    if len(down) < 3 or np.linalg.svd(down - down.mean(axis=0), compute_uv=False)[1] < _LIKE * np.linalg.norm(gravity):
        raise ConfigError(
            f"{len(down)} poses do not tell the tool's weight from the sensor's bias: turn it about two axes"
        )
    rows, values = [], []
    for g, wrench in zip(down, wrenches, strict=True):
        skew = np.array([[0.0, -g[2], g[1]], [g[2], 0.0, -g[0]], [-g[1], g[0], 0.0]])
        rows += [np.hstack([g[:, None], np.zeros((3, 3)), np.eye(3), np.zeros((3, 3))]),
                 np.hstack([np.zeros((3, 1)), -skew, np.zeros((3, 3)), np.eye(3)])]  # fmt: skip
        values += [wrench[:3], wrench[3:]]
    table, measured = np.vstack(rows), np.concatenate(values)
    found = np.linalg.lstsq(table, measured, rcond=None)[0]
    left = (measured - table @ found).reshape(-1, 2, 3)[:, 0]
    if not found[0] > 0.0:
        raise ConfigError(f"the tool would weigh {found[0]:.3f} kg: is the sensor's force the one on the flange?")
    load = Load(float(found[0]), frozen(found[1:4] / found[0]))
    return IdentifiedTool(load, frozen(found[4:]), float(np.sqrt(np.mean(left**2))))
