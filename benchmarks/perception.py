"""How near perception comes to what a thing is and where it stands, on placements that are drawn; and what it costs.

`python -m benchmarks.perception [--placements 20] [--seed 0] [--noise 0.08]` prints the tables of
docs/results/perception.md.
"""

from __future__ import annotations

import argparse
import itertools
import platform
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from allegro_twin.cell.camera.camera import CameraFrame, DepthCamera
from allegro_twin.cell.camera.mount import CameraMount
from allegro_twin.cell.camera.settings import DepthCameraSettings, DepthNoise
from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.fits.model import SHAPES, Solid
from allegro_twin.cell.perception.pipeline import Detection, PerceptionPipeline
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.kinematics.orientation import matrix_from_quaternion
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, object_catalogue
from allegro_twin.types import Array
from benchmarks.principal_frame import principal_frame, voxel
from benchmarks.tabletop import compile_tabletop, place_standing

_EQUAL = 0.002  # m. Edges that differ by less are of one length: which is the longer cannot be seen.
_TIMES = 3  # A frame is looked at so often and the least time counts: others use the machine too.
_VOXEL = 0.003  # m, of the baseline.
Figure = tuple[str, float, float, str]


@dataclass(frozen=True, slots=True)
class Trial:
    """One picture of one thing."""

    thing: GraspObject
    shape: str
    """As it was seen, or the word of the refusal."""
    off: float
    """Of the middle, mm."""
    turned: float
    """Of the axes, degrees; NaN of a ball."""
    base_off: float
    """The same of the report's frame: of the centroid,"""
    base_turned: float
    """and of the main axis."""
    spent: float
    """ms."""
    beside: float
    """What the cloud of the same frame costs, turn by turn with it, ms: how busy the machine is."""


def trials(placements: int, seed: int, noise: DepthNoise) -> Iterator[Trial]:
    """Each thing of the catalogue so often, the same for the same numbers."""
    settings = load_settings(PerceptionSettings, data_root() / "conf" / "perception" / "table.yaml")
    pipeline, draws = PerceptionPipeline(settings), np.random.default_rng(seed)
    for thing in object_catalogue().values():
        for _ in range(placements):
            placed, mount, number = drawn(thing, draws)
            frame = picture(placed, DepthCameraSettings(mount=mount, noise=noise), number)
            yield _tried(pipeline, placed, frame)


def drawn(thing: GraspObject, draws: np.random.Generator) -> tuple[PlacedObject, CameraMount, int]:
    """On any side that it can stand on, anywhere in the middle of the table, seen from 35 to 65 degrees above it and
    from 0.4 to 0.6 m away, from anywhere around; and a seed for the camera."""
    sides = {"sphere": "z", "cylinder": "zx", "ellipsoid": "yz", "box": "xyz"}[thing.shape]
    up, yaw = sides[draws.integers(len(sides))], draws.uniform(-np.pi, np.pi)
    x, y = draws.uniform(-0.08, 0.08, 2)
    above, around, away = np.radians(draws.uniform(35, 65)), draws.uniform(-np.pi, np.pi), draws.uniform(0.4, 0.6)
    position = away * np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])
    mount = CameraMount(position=(position[0], position[1], position[2]), towards=(0.0, 0.0, 0.04))
    return place_standing(thing, up, yaw, x, y), mount, int(draws.integers(2**31))


def picture(placed: PlacedObject, settings: DepthCameraSettings, seed: int) -> CameraFrame:
    model, data = compile_tabletop([placed])
    camera = DepthCamera(model, settings, seed)
    frame = camera.capture(data)
    camera.close()
    return frame


def _tried(pipeline: PerceptionPipeline, placed: PlacedObject, frame: CameraFrame) -> Trial:
    thing, cloud, spent, beside = placed.grasp_object, frame.cloud, np.inf, np.inf
    for _ in range(_TIMES):
        begin = time.perf_counter()
        seen = pipeline.detect(cloud, frame.pose.position, frame.pose.rotation)
        between = time.perf_counter()
        frame.lens.cloud(frame.depth)
        spent, beside = min(spent, 1e3 * (between - begin)), min(beside, 1e3 * (time.perf_counter() - between))
    if isinstance(seen, PerceptionRefusal):
        return Trial(
            thing, seen.reason, np.inf, np.nan if thing.shape == "sphere" else 180.0, np.nan, np.nan, spent, beside
        )
    turn = matrix_from_quaternion(placed.quaternion)
    off, turned = 1e3 * float(np.linalg.norm(seen.solid.position - placed.position)), apart(thing, turn, seen.solid)
    return Trial(thing, seen.solid.shape, off, turned, *_baseline(seen, frame, placed, turn), spent, beside)


def apart(thing: GraspObject, turn: Array, solid: Solid) -> float:
    """The angle between a thing's axes and those that were seen, degrees, its symmetries counted out: of a ball there
    is none (NaN), of a solid of revolution only its axis counts, of a box any turn that leaves it as it is does not."""
    edges = 2.0 * thing.half_extents()
    if thing.shape == "sphere":
        return float("nan")
    if thing.shape in ("cylinder", "ellipsoid"):
        axis = turn[:, 2 if thing.shape == "cylinder" else 0]
        return float(np.degrees(np.arccos(min(1.0, abs(float(axis @ solid.axes[:, 0]))))))
    sorted_edges, least = np.sort(edges)[::-1], 180.0
    for order in itertools.permutations(range(3)):
        if np.abs(edges[list(order)] - sorted_edges).max() > _EQUAL:
            continue
        for signs in itertools.product((1.0, -1.0), repeat=3):
            axes = turn[:, order] * signs
            if np.linalg.det(axes) > 0.0:
                cosine = (np.trace(axes.T @ solid.axes) - 1.0) / 2.0
                least = min(least, float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))))
    return least


def _baseline(seen: Detection, frame: CameraFrame, placed: PlacedObject, turn: Array) -> tuple[float, float]:
    """Of the same points: how far the report's frame is off, mm, and its main axis from the thing's, degrees."""
    camera = (voxel(seen.points, _VOXEL) - frame.pose.position) @ frame.pose.rotation
    found = principal_frame(camera)
    off = 1e3 * float(np.linalg.norm(frame.pose.world(found.centroid) - placed.position))
    edges = 2.0 * placed.grasp_object.half_extents()
    longest = [turn[:, k] for k in range(3) if edges[k] > edges.max() - _EQUAL]
    if len(longest) > 1:  # A ball, a flat can, a cube: no main axis.
        return off, float("nan")
    axis = frame.pose.rotation @ found.axes[:, 0]
    return off, float(np.degrees(np.arccos(min(1.0, abs(float(axis @ longest[0]))))))


def figures() -> Iterator[Figure]:
    """Beside their bars."""
    done = list(trials(3, 0, DepthNoise()))
    yield "perception: middle of a YCB thing, median", float(np.median([t.off for t in done])), 3.0, "mm"
    yield "perception: its axes, median", float(np.nanmedian([t.turned for t in done])), 5.0, "°"
    yield "perception: one frame of 640x480, median", float(np.median([t.spent for t in done])), 12.0, "ms"


def _table(done: list[Trial]) -> None:
    print("| thing | middle, mm | 90 % | axes, ° | 90 % | right shape | PCA: mm | PCA: ° |")
    print("|---|---|---|---|---|---|---|---|")
    rows = [(name, [t for t in done if t.thing.name == name]) for name in dict.fromkeys(t.thing.name for t in done)]
    for name, of in [*rows, ("**all**", done)]:
        right = np.mean([t.shape == t.thing.shape for t in of])
        numbers = [_middle([t.off for t in of]), _most([t.off for t in of])]
        numbers += [_middle([t.turned for t in of]), _most([t.turned for t in of]), f"{right:.0%}"]
        numbers += [_middle([t.base_off for t in of]), _middle([t.base_turned for t in of])]
        print(f"| {name} | {' | '.join(numbers)} |")


def _confusion(done: list[Trial]) -> None:
    seen = [*SHAPES, *sorted({t.shape for t in done} - set(SHAPES))]
    print(f"\n| is \\ seen as | {' | '.join(seen)} |\n|{'---|' * (len(seen) + 1)}")
    for shape in SHAPES:
        counts = [sum(t.shape == word for t in done if t.thing.shape == shape) for word in seen]
        print(f"| {shape} | {' | '.join(map(str, counts))} |")


def _middle(values: list[float]) -> str:
    known = [value for value in values if not np.isnan(value)]
    return f"{np.median(known):.1f}" if known else "–"


def _most(values: list[float]) -> str:
    known = [value for value in values if not np.isnan(value)]
    return f"{np.quantile(known, 0.9, method='higher'):.1f}" if known else "–"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--placements", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--noise", type=float, default=0.08, help="of disparity, pixels")
    given = parser.parse_args()
    done = list(trials(given.placements, given.seed, DepthNoise(disparity=given.noise)))
    print(f"{len(done)} pictures, seed {given.seed}, disparity noise {given.noise} px, {platform.machine()}\n")
    _table(done)
    _confusion(done)
    spent = [t.spent for t in done]
    middle, most = np.median(spent), np.quantile(spent, 0.9)
    times = np.median([t.spent / t.beside for t in done])
    print(f"\nOne frame, the least of {_TIMES} looks: median {middle:.1f} ms, 90 % {most:.1f} ms,")
    print(f"{times:.1f} times what making its cloud costs, turn by turn ({np.median([t.beside for t in done]):.2f} ms)")


if __name__ == "__main__":
    main()
