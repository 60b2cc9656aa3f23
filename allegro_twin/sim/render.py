"""Pictures and films of a simulated scene, with or without a screen."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError
from allegro_twin.files.whole import whole_file
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample

Picture = NDArray[np.uint8]
"""Rows, columns, RGB."""
_HINT = "headless rendering needs EGL: apt-get install libegl1 libgl1-mesa-dri, or set MUJOCO_GL"


class Scene(Protocol):
    """What can be looked at: a backend, or one simulation of a batch."""

    @property
    def spec(self) -> HandSpec: ...
    @property
    def model(self) -> mujoco.MjModel: ...
    @property
    def data(self) -> mujoco.MjData: ...


class Camera:
    """Takes pictures of a backend's scene, looking at the palm. Raises ConfigError where nothing can be rendered."""

    def __init__(
        self,
        backend: Scene,
        *,
        width: int = 480,
        height: int = 480,
        distance: float = 0.5,
        azimuth: float = 140.0,
        elevation: float = -22.0,
    ) -> None:
        self._backend, self._view = backend, mujoco.MjvCamera()
        side = 1.0 if backend.spec.side == "right" else -1.0
        self._view.distance, self._view.azimuth, self._view.elevation = distance, side * azimuth, elevation
        self._palm = backend.model.body("palm_link").id
        try:
            self._renderer: Any = mujoco.Renderer(backend.model, height, width)
        except (ImportError, AttributeError, RuntimeError, OSError, mujoco.FatalError) as error:
            raise ConfigError(f"cannot render: {_HINT} ({str(error).strip().splitlines()[0]})") from error

    def take(self) -> Picture:
        """The scene as it is now."""
        self._view.lookat = self._target()
        self._renderer.update_scene(self._backend.data, self._view)
        picture: Picture = self._renderer.render()
        return picture

    def take_depth(self) -> NDArray[np.float32]:
        """How far everything is, rows and columns, m."""
        self._renderer.enable_depth_rendering()
        try:
            depth: NDArray[np.float32] = np.array(self.take())
        finally:
            self._renderer.disable_depth_rendering()
        return depth

    def close(self) -> None:
        self._renderer.close()

    def _target(self) -> Array:
        """The middle of the grasp: 5 cm in front of the palm."""
        data = self._backend.data
        target: Array = data.xpos[self._palm] + data.xmat[self._palm].reshape(3, 3) @ (0.05, 0.0, -0.02)
        return target


def filmed(samples: Iterable[Sample], camera: Camera, path: Path, fps: int = 30) -> Iterator[Sample]:
    """A stage that makes an H.264 film in real time of the hand's clock."""
    with _opened(path, fps) as add:
        frames = 0
        for sample in samples:
            while frames <= sample.state.t * fps:
                add(camera.take())
                frames += 1
            yield sample


def film(pictures: Iterable[Picture], path: Path, fps: int) -> None:
    """An H.264 film of pictures, so many a second. Raises ConfigError without PyAV."""
    try:
        with _opened(path, fps) as add:
            for picture in pictures:
                add(picture)
    except ImportError as error:
        raise ConfigError(f"a film needs PyAV: pip install 'allegro-twin[view]' ({error})") from error


@contextmanager
def _opened(path: Path, fps: int) -> Iterator[Callable[[Picture], None]]:
    """A film to which pictures of one size are added."""
    import av

    with whole_file(path) as temporary, av.open(str(temporary), "w", format=path.suffix[1:]) as container:
        stream: Any = None

        def add(picture: Picture) -> None:
            nonlocal stream
            if stream is None:
                stream = container.add_stream("libx264", rate=fps, options={"crf": "23"})
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))

        yield add
        if stream is not None:
            container.mux(stream.encode())


def pictured(samples: Iterable[Sample], camera: Camera, path: Path, moments: Sequence[float]) -> Iterator[Sample]:
    """A stage that takes a picture at each of the moments (s), and in the end, side by side in one PNG."""
    from PIL import Image

    left = sorted(moments)
    pictures: list[Picture] = []
    for sample in samples:
        if left and sample.state.t >= left[0] - 1e-9:
            pictures.append(camera.take())
            left.pop(0)
        yield sample
    if left or not pictures:
        pictures.append(camera.take())
    with whole_file(path) as temporary:
        Image.fromarray(np.hstack(pictures)).save(temporary)


def overview(strips: Mapping[str, Path], target: Path, *, pane: int = 1, columns: int = 6) -> None:
    """One picture of many trials: a pane of every strip that `pictured` made, with its name."""
    from PIL import Image, ImageDraw

    size = 240
    rows = -(-len(strips) // columns)
    sheet = Image.new("RGB", (columns * size, rows * size), "white")
    draw = ImageDraw.Draw(sheet)
    for index, (name, path) in enumerate(strips.items()):
        strip = Image.open(path)
        edge = strip.height
        left = min(pane * edge, strip.width - edge)
        corner = (index % columns * size, index // columns * size)
        sheet.paste(strip.crop((left, 0, left + edge, edge)).resize((size, size)), corner)
        draw.text((corner[0] + 8, corner[1] + 6), name, fill=(40, 40, 40))
    with whole_file(target) as temporary:
        sheet.save(temporary)
