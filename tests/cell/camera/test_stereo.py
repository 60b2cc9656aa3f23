"""Each error of a stereo camera's depth is as large as its source says, and is where it arises."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.camera.intrinsics import D435I_BASELINE, D435I_DEPTH, Image
from allegro_twin.cell.camera.settings import DepthNoise
from allegro_twin.cell.camera.stereo import Stereo, hidden, smeared
from tests.cell.camera.scenes import EXACT

LENS = D435I_DEPTH["640x480"]
STEREO = Stereo(LENS, D435I_BASELINE, 10.0)
SCATTER = EXACT.model_copy(update={"disparity": 0.08})


def wall(depth: float) -> Image:
    return np.full((LENS.height, LENS.width), depth, np.float32)


def told(exact: Image, noise: DepthNoise, seed: int = 0) -> Image:
    return STEREO.measured(exact, noise, np.random.default_rng(seed))


def test_without_errors_depth_is_what_it_is() -> None:
    np.testing.assert_allclose(told(wall(0.7), EXACT), 0.7, rtol=1e-6)


@pytest.mark.parametrize(("depth", "sigma"), [(0.25, 0.26), (0.3, 0.37), (0.5, 1.04), (0.7, 2.04), (1.0, 4.16)])
def test_depth_scatters_with_the_square_of_distance(depth: float, sigma: float) -> None:
    assert 1e3 * STEREO.sigma(depth, SCATTER) == pytest.approx(sigma, abs=0.006)  # mm, librealsense #3904
    assert 1e3 * told(wall(depth), SCATTER).std() == pytest.approx(sigma, rel=0.03)


def test_neighbours_share_their_noise_and_pixels_a_patch_apart_do_not() -> None:
    noise = smeared((480, 640), 4, np.random.default_rng(1)).astype(np.float64)
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    for axis in (0, 1):
        for lag in range(6):
            shared = (noise * np.roll(noise, lag, axis)).mean()
            assert shared == pytest.approx(max(0.0, 1.0 - lag / 4), abs=0.03)


def test_disparity_is_told_in_steps_of_a_thirty_second_and_depth_in_millimetres() -> None:
    steps = told(wall(1.0), SCATTER.model_copy(update={"subpixel": 32}))
    disparity = LENS.fx * D435I_BASELINE / steps.astype(np.float64)
    np.testing.assert_allclose(32 * disparity, np.rint(32 * disparity), atol=1e-3)
    whole = 1e3 * told(wall(1.0), SCATTER.model_copy(update={"unit": 0.001})).astype(np.float64)
    np.testing.assert_allclose(whole, np.rint(whole), atol=1e-3)
    assert len(np.unique(whole)) > 10


@pytest.mark.parametrize(("resolution", "nearest"), [("640x480", 152), ("848x480", 168)])
def test_nothing_is_known_nearer_than_126_pixels_of_disparity(resolution: str, nearest: float) -> None:
    lens = D435I_DEPTH[resolution]
    stereo = Stereo(lens, D435I_BASELINE, 10.0)
    assert 1e3 * stereo.nearest == pytest.approx(nearest, abs=0.6)  # mm, realsense-ros #2367
    for off, known in ((-0.002, False), (0.002, True)):
        exact = np.full((lens.height, lens.width), stereo.nearest + off, np.float32)
        assert np.isfinite(stereo.measured(exact, EXACT, np.random.default_rng(0))).all() == known


def test_nothing_is_known_beyond_the_furthest() -> None:
    assert np.isnan(told(wall(10.1), EXACT)).all()
    assert np.isfinite(told(wall(9.9), EXACT)).all()


def test_a_thing_hides_what_is_behind_it_on_its_left_by_the_difference_of_disparities() -> None:
    exact = wall(1.0)
    exact[:, 300:400] = 0.4
    scale = LENS.fx * D435I_BASELINE
    shadow = scale / 0.4 - scale / 1.0
    lost = np.isnan(told(exact, EXACT.model_copy(update={"shadow": True})))[:, 30:]
    assert lost.sum(axis=1) == pytest.approx(shadow, abs=1.0)
    columns = 30 + np.flatnonzero(lost[0])
    assert columns.max() == 299
    assert columns.min() == pytest.approx(300 - shadow, abs=1.0)


def test_the_right_imager_does_not_see_a_band_at_the_left() -> None:
    band = LENS.fx * D435I_BASELINE / 0.5
    disparity = np.full((3, 640), band, np.float32)
    assert hidden(disparity).sum(axis=1) == pytest.approx(band, abs=1.0)
    assert hidden(disparity)[:, : int(band)].all()


def test_half_of_the_pixels_beside_a_jump_in_depth_are_lost_and_no_others() -> None:
    exact = wall(1.0)
    exact[:, 300:] = 0.4
    lost = np.isnan(told(exact, EXACT.model_copy(update={"edge": 0.5, "grazing": (75.0, 85.0)})))
    assert lost[:, 299:301].mean() == pytest.approx(0.5, abs=0.05)
    assert not lost[:, :299].any()
    assert not lost[:, 301:].any()


@pytest.mark.parametrize(("angle", "part"), [(70.0, 0.0), (80.0, 0.5), (87.0, 1.0)])
def test_pixels_are_lost_where_a_surface_is_seen_flatly(angle: float, part: float) -> None:
    """A plane through (0, 0, 0.6) whose normal is so far from the ray in the picture's middle."""
    tilt, rays = np.radians(angle), LENS.rays().astype(np.float64)
    normal = np.array([0.0, np.sin(tilt), -np.cos(tilt)])
    depth = (0.6 * normal[2]) / (rays @ normal)
    depth = np.where(depth > 0.0, depth, np.inf).astype(np.float32)
    lost = np.isnan(told(depth, EXACT.model_copy(update={"grazing": (75.0, 85.0)})))
    across = np.degrees(np.arccos(np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1)))
    here = (np.abs(across - angle) < 0.5) & (depth < 2.0) & (depth > 0.2)
    assert here.sum() > 1000
    assert lost[here].mean() == pytest.approx(part, abs=0.06)
