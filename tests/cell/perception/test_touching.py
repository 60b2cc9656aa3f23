"""Things that touch are taken apart where solids explain them, and one thing stays one."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.perception.fits.model import Shape, Solid
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.touching import surface_distance
from allegro_twin.types import Array
from tests.cell.test_run import cell_of

TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def seen(*objects: tuple[str, tuple[float, float], float]) -> list[Detection]:
    cell = cell_of(objects=[{"name": name, "at": at, "yaw": yaw} for name, at, yaw in objects])
    cell.robot.arm.reset()
    frame = cell.camera.capture(cell.robot.world.data)
    found = cell.pipeline.detect_all(frame.cloud, frame.pose.position, frame.pose.rotation)
    cell.close()
    assert all(isinstance(each, Detection) for each in found), found
    return [each for each in found if isinstance(each, Detection)]


@pytest.mark.parametrize("objects", [
    [("foam_brick", (0.0, 0.0), 0.0), ("rubiks_cube", (0.067, 0.01), 0.0)],
    [("lemon", (0.0, 0.0), 30.0), ("orange", (0.02, 0.066), 0.0)],
    pytest.param(
        [("foam_brick", (0.0, 0.0), 0.0), ("rubiks_cube", (0.067, 0.01), 0.0), ("peach", (0.02, 0.0672), 0.0)],
        marks=pytest.mark.slow,
    ),
])  # fmt: skip
def test_what_touches_is_as_many_solids_as_there_are_things(
    objects: list[tuple[str, tuple[float, float], float]],
) -> None:
    found = seen(*objects)
    assert len(found) == len(objects)
    places = np.array([each.solid.position[:2] for each in found])
    for _, at, _ in objects:
        assert np.linalg.norm(places - at, axis=1).min() < 0.01
    assert all(each.others == len(objects) - 1 for each in found)


def test_all_that_stands_apart_is_found_the_largest_first() -> None:
    found = seen(("golf_ball", (-0.08, -0.08), 0.0), ("cracker_box", (0.05, 0.05), 20.0))
    assert [each.solid.shape for each in found] == ["box", "sphere"]


def test_one_thing_is_one_solid() -> None:
    for name in ("apple", "cracker_box", "tuna_fish_can", "mug", "pear"):
        assert len(seen((name, (0.0, 0.0), 30.0))) == 1


SIZES: dict[Shape, tuple[float, float, float]] = {
    "sphere": (0.06, 0.06, 0.06), "cylinder": (0.1, 0.06, 0.06), "box": (0.1, 0.06, 0.04),
    "ellipsoid": (0.09, 0.06, 0.06),
}  # fmt: skip


@pytest.mark.parametrize("shape", SIZES)
def test_the_distance_to_a_surface_is_that_along_its_normal(shape: Shape) -> None:
    solid = Solid(shape, np.array([0.1, 0.2, 0.3]), TURNED, SIZES[shape], 0.0)
    half = np.array(SIZES[shape]) / 2.0
    for axis in range(3):  # Through the middle of a face, or the end of an axis.
        for way, off in ((1.0, 0.01), (-1.0, -0.004)):
            own: Array = np.zeros(3)
            own[axis] = way * (half[axis] + off)
            distance = surface_distance(solid, (TURNED @ own + solid.position)[None])[0]
            assert distance == pytest.approx(off, abs=6e-4 if shape == "ellipsoid" else 1e-12)
