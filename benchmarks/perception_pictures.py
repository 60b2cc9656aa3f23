"""The pictures of docs/reference/camera.md and docs/results/perception.md: `python -m benchmarks.perception_pictures
docs/images`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from allegro_twin.cell.camera.camera import DepthCamera
from allegro_twin.cell.camera.intrinsics import D435I_COLOUR, D435I_COLOUR_AT
from allegro_twin.cell.camera.mount import CameraMount, CameraPose
from allegro_twin.cell.camera.settings import DepthCameraSettings
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.pipeline import Detection, PerceptionPipeline
from allegro_twin.cell.perception.settings import PerceptionSettings
from allegro_twin.cell.perception.target import GraspTarget, grasp_target
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.sim.objects.catalogue import PlacedObject, load_object
from allegro_twin.types import Array
from benchmarks.tabletop import compile_tabletop, place_standing

Picture = NDArray[np.uint8]
_AXES = ((220, 40, 40), (40, 160, 60), (40, 90, 220))
_SOLID = (255, 230, 60)
_MOUNT = CameraMount(position=(-0.36, 0.05, 0.36), towards=(0.0, 0.0, 0.03))
_SHOWN = (
    ("tomato_soup_can", "z"), ("sugar_box", "y"), ("mug", "x"),
    ("foam_brick", "z"), ("pear", "z"), ("tennis_ball", "z"),
)  # fmt: skip


def camera_picture() -> Picture:
    """Colour, exact depth, depth as it is told, and their difference: blue is nearer, red further, 5 mm at most."""
    things = [place_standing(load_object(name), up, 0.5, x, y) for name, up, x, y in (
        ("mug", "z", 0.0, 0.0), ("sugar_box", "z", 0.06, 0.14), ("lemon", "z", -0.08, -0.1))]  # fmt: skip
    model, data = compile_tabletop(things)
    camera = DepthCamera(model, DepthCameraSettings(mount=_MOUNT, colour=True))
    frame = camera.capture(data)
    exact = camera.exact(data, frame.pose)
    camera.close()
    assert frame.colour is not None
    off = np.clip((frame.depth - exact) / 0.005, -1.0, 1.0)
    difference = np.stack([1.0 + np.minimum(off, 0.0), 1.0 - np.abs(off), 1.0 - np.maximum(off, 0.0)], axis=-1)
    difference = np.where(np.isnan(off)[..., None], 0.0, difference)
    shades = [_grey(exact), _grey(frame.depth), (255 * difference).astype(np.uint8)]
    return np.concatenate([np.concatenate([frame.colour, shades[0]], 1), np.concatenate(shades[1:], 1)], 0)


def perception_picture() -> Picture:
    """Six things: the solid that was fitted, its middle, and the target's frame: x red, y green, z blue."""
    settings = load_settings(PerceptionSettings, data_root() / "conf" / "perception" / "table.yaml")
    tiles = [_tile(place_standing(load_object(name), up, 0.7, 0.0, 0.0), settings) for name, up in _SHOWN]
    return np.concatenate([np.concatenate(tiles[:3], 1), np.concatenate(tiles[3:], 1)], 0)


def _tile(placed: PlacedObject, settings: PerceptionSettings) -> Picture:
    model, data = compile_tabletop([placed])
    camera = DepthCamera(model, DepthCameraSettings(mount=_MOUNT, colour=True))
    frame = camera.capture(data)
    camera.close()
    found = PerceptionPipeline(settings).detect(frame.cloud, frame.pose.position, frame.pose.rotation)
    assert isinstance(found, Detection), found
    assert frame.colour is not None
    image = Image.fromarray(frame.colour)
    draw, eye = ImageDraw.Draw(image), frame.pose
    for line in _wires(found.solid):
        draw.line([tuple(p) for p in _pixels(line, eye)], fill=_SOLID, width=2)
    _dot(draw, _pixels(found.solid.position[None], eye)[0], _SOLID)
    aim = grasp_target(found, settings.target)
    if isinstance(aim, GraspTarget):
        for axis, color in zip(aim.rotation.T, _AXES, strict=True):
            draw.line([tuple(p) for p in _pixels(np.stack([aim.position, aim.position + 0.04 * axis]), eye)], color, 3)
    off = 1e3 * float(np.linalg.norm(found.solid.position - placed.position))
    draw.text((130, 92), f"{placed.grasp_object.name}: {found.solid.shape}, {off:.1f} mm off", fill=(0, 0, 0))
    return np.asarray(image)[80:400, 120:500]


def _wires(solid: Solid) -> list[Array]:
    """Lines over the surface of a solid in the world, (k, 3) each, m."""
    half, turn = np.array(solid.size) / 2, np.linspace(0.0, 2.0 * np.pi, 49)
    ring = np.stack([np.zeros(49), np.cos(turn), np.sin(turn)], axis=1)
    if solid.shape == "box":
        square = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]])
        lines = [np.insert(square, k, side, axis=1) * half for k in (0, 1) for side in (-1.0, 1.0)]
    elif solid.shape == "cylinder":
        lines = [(ring + np.array([side, 0.0, 0.0])) * half for side in (-1.0, 0.0, 1.0)]
        lines += [np.array([[-1.0, *ring[k, 1:]], [1.0, *ring[k, 1:]]]) * half for k in range(0, 48, 6)]
    else:
        lines = [np.roll(ring, k, axis=1) * half for k in range(3)]
    return [line @ solid.axes.T + solid.position for line in lines]


def _pixels(points: Array, eye: CameraPose) -> Array:
    """Of places in the world in the colour picture."""
    beside = eye.world(np.array(D435I_COLOUR_AT))
    return D435I_COLOUR.pixel((points - beside) @ eye.rotation)


def _dot(draw: ImageDraw.ImageDraw, at: Array, color: tuple[int, int, int]) -> None:
    x, y = at
    draw.ellipse((x - 5, y - 5, x + 5, y + 5), fill=color, outline=(0, 0, 0))


def _grey(depth: NDArray[np.float32]) -> Picture:
    """From white at 0.25 m to dark at 0.95 m; black is unknown."""
    shade = np.clip(1.0 - (depth - 0.25) / 0.7, 0.05, 1.0)
    return np.repeat((255 * np.where(np.isfinite(depth), shade, 0.0)).astype(np.uint8)[..., None], 3, axis=-1)


def main() -> None:
    folder = Path(sys.argv[1])
    Image.fromarray(camera_picture()[::2, ::2]).save(folder / "camera_d435i.png", optimize=True)
    Image.fromarray(perception_picture()).quantize(256, Image.Quantize.MAXCOVERAGE).save(
        folder / "perception_solids.png", optimize=True
    )


if __name__ == "__main__":
    main()
