"""Degenerate clouds end in an answer or in a refusal with a sentence, never in an error or in a number that is none."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.camera.intrinsics import D435I_DEPTH
from allegro_twin.cell.camera.mount import looking
from allegro_twin.cell.perception.fits.model import sample_points
from allegro_twin.cell.perception.fits.solids import fit_solids
from allegro_twin.cell.perception.pipeline import Detection, PerceptionPipeline
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.types import Array

SETTINGS = load_settings(PerceptionSettings, data_root() / "conf" / "perception" / "table.yaml")
LENS = D435I_DEPTH["424x240"]
POSE = looking((-0.36, 0.05, 0.38), (0.0, 0.0, 0.03))
RAYS = LENS.rays().astype(np.float64) @ POSE.rotation.T
TABLE = np.where(RAYS[..., 2] < -0.05, -POSE.position[2] / np.minimum(RAYS[..., 2], -0.05), np.nan)
ROWS, COLUMNS = np.indices(TABLE.shape)


def box(height: float) -> Array:
    """Depth of the table with a box of 8 x 8 cm on it, (240, 424), m."""
    low, high = np.array([-0.04, -0.04, 0.0]), np.array([0.04, 0.04, height])
    first, second = (low - POSE.position) / RAYS, (high - POSE.position) / RAYS
    near, far = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
    return np.where(far > near, near, TABLE)


def spiked(part: float, by: float) -> Array:
    """A shiny box: so much of it is seen too near, by so much, m."""
    depth, draws = box(0.06), np.random.default_rng(2)
    on = (depth != TABLE) & (draws.random(depth.shape) < part) & np.isfinite(depth)
    return np.where(on, depth - by, depth)


def strewn(value: float) -> Array:
    draws = np.random.default_rng(3)
    return np.where(draws.random(TABLE.shape) < 0.02, value, box(0.06))


CLOUDS = {
    "empty": np.full_like(TABLE, np.nan),
    "one point": np.where((ROWS == 120) & (COLUMNS == 212), 0.4, np.nan),
    "one row": np.where(ROWS == 121, TABLE, np.nan),
    "one column": np.where(COLUMNS == 212, TABLE, np.nan),
    "a wall": np.full_like(TABLE, 0.4),
    "nothing but the table": TABLE,
    "a box that is known at every third pixel alone": np.where(
        (box(0.06) != TABLE) & ((ROWS % 3 != 0) | (COLUMNS % 3 != 0)), np.nan, box(0.06)
    ),
    **{f"a box of which {part:.0%} are {by} m too near": spiked(part, by)
       for part in (0.005, 0.02, 0.2, 0.5, 0.9) for by in (0.02, 0.1, 0.3)},
    **{f"strewn with {value}": strewn(value) for value in (0.0, -1.0, 1e-30, 1e30, np.inf, -np.inf)},
    "in millimetres": 1e3 * box(0.06),
    "behind the camera": -box(0.06),
}  # fmt: skip


DEAR = [f"a box of which {part:.0%} are {by} m too near" for part in (0.2, 0.5, 0.9) for by in (0.02, 0.1, 0.3)]
"""What takes a second; one of them is in the fast tier."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in DEAR and name != DEAR[1] else ()) for name in CLOUDS]
)
def test_a_degenerate_cloud_has_an_answer(name: str) -> None:
    with np.errstate(invalid="ignore", over="ignore"):
        cloud = (LENS.rays() * CLOUDS[name][..., None]).astype(np.float32)
    seen = PerceptionPipeline(SETTINGS).detect(cloud, POSE.position, POSE.rotation)
    if isinstance(seen, Detection):
        assert np.isfinite([*seen.solid.position, *seen.solid.size, seen.solid.error, seen.sigma]).all()
    else:
        assert seen.sentence


def points_of(kind: str, count: int) -> Array:
    points = np.abs(np.random.default_rng(count).normal(0.0, 0.03, (count, 3)))
    match kind:
        case "one place":
            return np.repeat(points[:1], count, axis=0)
        case "a line":
            return points[:1] * np.linspace(1.0, 2.0, count)[:, None]
        case "a level plane":
            points[:, 2] = 0.03
        case "an upright plane":
            points[:, 0] = 0.0
        case "an upright line":
            points[:, :2] = 0.01
        case "two heights":
            points[:, 2] = np.where(np.arange(count) % 2, 0.01, 0.2)
        case "huge":
            points *= 1e3
        case "tiny":
            points *= 1e-6
    return points


@pytest.mark.parametrize("count", [1, 2, 3, 30, 400])
@pytest.mark.parametrize("sigma", [0.0, 1e-3, 0.1])
@pytest.mark.parametrize("kind", ["one place", "a line", "a level plane", "an upright plane", "an upright line",
                                  "two heights", "huge", "tiny"])  # fmt: skip
def test_degenerate_points_are_fitted_or_not_and_every_number_is_finite(kind: str, count: int, sigma: float) -> None:
    seen = sample_points(points_of(kind, count), 0.001, sigma, 0.7)
    assert np.isfinite(seen.outline).all()
    for solid in fit_solids(seen, np.random.default_rng(0)):
        assert np.isfinite([*solid.position, *solid.size, solid.error, *solid.axes.ravel()]).all()


def test_the_top_is_a_height_that_was_seen() -> None:
    """Half of the upper points are spikes: between them and the surface there is nothing, and no outline either."""
    height = np.concatenate([np.full(50, 0.05), [0.3]])
    points = np.stack([np.zeros(51), np.zeros(51), height], axis=1)
    assert sample_points(points, 0.001, 0.3, 0.7).top in (0.05, 0.3)
    assert sample_points(points_of("two heights", 2), 0.001, 0.5, 0.7).top == 0.01
