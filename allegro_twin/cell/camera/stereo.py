"""Stereo camera model: noise of a pair of imagers, added to exact depth where it arises, in the disparity.

Disparity is d = f·B/Z, pixels. docs/reference/camera.md has every term with its source.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from allegro_twin.cell.camera.intrinsics import Image, Intrinsics
from allegro_twin.cell.camera.settings import DepthNoise

SEARCH = 126
"""The largest disparity that is searched for, pixels: nearest depth is f·B/126 (realsense-ros #2367)."""
_JUMP = 1.0  # Pixels of disparity between neighbours: more is an edge, not a slope.
_FLAT = np.float32(1e-6)

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Stereo:
    """A camera's two imagers."""

    lens: Intrinsics
    baseline: float
    """m."""
    furthest: float
    """m."""

    @property
    def nearest(self) -> float:
        """MinZ = f·B/126, m."""
        return self.lens.fx * self.baseline / SEARCH

    def sigma(self, depth: float, noise: DepthNoise) -> float:
        """The standard deviation of depth there, σ = Z²·s/(f·B), m."""
        return depth**2 * noise.disparity / (self.lens.fx * self.baseline)

    def measured(self, exact: Image, noise: DepthNoise, draws: np.random.Generator) -> Image:
        """The depth picture that the camera tells of an exact one (rows, columns), m along z; NaN is unknown."""
        scale = np.float32(self.lens.fx * self.baseline)
        exact = np.where(exact < self.furthest, exact, np.float32(np.inf))
        true = scale / exact
        lost = (true > SEARCH) | (true <= 0)
        if noise.shadow:
            lost |= hidden(true)
        lost |= _edges(true, noise.edge, draws)
        lost |= _grazing(true, self.lens, noise.grazing, draws)
        told = true + noise.disparity * smeared(true.shape, noise.patch, draws) if noise.disparity else true
        if noise.subpixel:
            told = np.rint(told * noise.subpixel) / np.float32(noise.subpixel)
        depth = scale / np.maximum(told, _FLAT)
        if noise.unit:
            depth = np.rint(depth / np.float32(noise.unit)) * np.float32(noise.unit)
        depth[lost | (depth > self.furthest)] = np.nan
        return np.asarray(depth, np.float32)


def hidden(disparity: Image) -> Mask:
    """Pixels of the left imager (rows, columns) whose point the right one does not see.

    A point of column u is at u - d there. It is hidden by any point further right in the left picture that is further
    left in the right one, and outside where u - d < 0. A thing thinner than its own shift hides more than it should by
    this, as it does for matchers that keep the order of points.
    """
    there = np.arange(disparity.shape[1], dtype=np.float32) - disparity
    least = np.minimum.accumulate(there[:, ::-1], axis=1)[:, ::-1]
    return np.asarray((there > least + 0.5) | (there < 0))


def smeared(shape: tuple[int, ...], patch: int, draws: np.random.Generator) -> Image:
    """Noise of standard deviation 1 at every pixel, averaged over squares of `patch`², which wrap around."""
    noise = draws.standard_normal(shape, dtype=np.float32)
    for axis in (0, 1):
        total = noise
        for step in range(1, patch):
            total = total + np.roll(noise, step, axis)
        noise = total
    return np.asarray(noise / np.float32(patch))


def _edges(disparity: Image, part: float, draws: np.random.Generator) -> Mask:
    """Random mask of a share of the pixels on both sides of a depth jump."""
    beside = np.zeros(disparity.shape, np.bool_)
    across = np.abs(np.diff(disparity, axis=1)) > _JUMP
    along = np.abs(np.diff(disparity, axis=0)) > _JUMP
    beside[:, 1:] |= across
    beside[:, :-1] |= across
    beside[1:] |= along
    beside[:-1] |= along
    beside[beside] = draws.random(np.count_nonzero(beside)) < part
    return beside


def _grazing(disparity: Image, lens: Intrinsics, limits: tuple[float, float], draws: np.random.Generator) -> Mask:
    """Where the surface is seen too flatly. On a plane disparity is linear in the pixel, so that with its gradient
    (a, b) and rays r = (x/f, y/f, 1) the normal is along (f·a, f·b, d - a·x - b·y), of which r has the part d."""
    x, y, length2 = _pixels(lens)
    a, b = _slope(disparity, 1), _slope(disparity, 0)
    across = np.square(disparity - a * x - b * y)
    across += np.square(np.float32(lens.fx) * a)
    across += np.square(np.float32(lens.fy) * b)
    cosine2 = np.square(disparity) / np.maximum(across * length2, _FLAT)
    first, last = np.cos(np.radians(limits))
    steep = cosine2 < np.float32(first**2)
    drawn = draws.random(np.count_nonzero(steep), dtype=np.float32)
    steep[steep] = np.sqrt(cosine2[steep]) < last + (first - last) * drawn
    return np.asarray(steep)


@cache
def _pixels(lens: Intrinsics) -> tuple[Image, Image, Image]:
    """Columns (1, w) and rows (h, 1) from the principal point, pixels, and the squared length of each ray (h, w)."""
    rays = lens.rays()
    x, y = np.float32(lens.fx) * rays[:1, :, 0], np.float32(lens.fy) * rays[:, :1, 1]
    return x, y, np.square(rays).sum(axis=-1)


def _slope(disparity: Image, axis: int) -> Image:
    """Along an axis, a pixel: to the neighbour that differs less, so that a jump beside a surface is no slope."""
    change, slope = np.diff(disparity, axis=axis), np.zeros_like(disparity)
    inner = (slice(None),) * axis
    before, after = change[(*inner, slice(None, -1))], change[(*inner, slice(1, None))]
    slope[(*inner, slice(1, -1))] = np.where(np.abs(before) < np.abs(after), before, after)
    return slope
