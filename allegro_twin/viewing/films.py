"""H.264 films: of a run as it happens, in real time of the hand's clock, or of any pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.types import Sample
from allegro_twin.viewing.camera import Camera, Picture

CONTAINERS = {".mp4": "mp4", ".mkv": "matroska", ".mov": "mov"}
"""Formats by the suffixes of their files."""


def filmed(samples: Iterable[Sample], camera: Camera, path: Path, fps: int = 30) -> Iterator[Sample]:
    """A stage that makes an H.264 film in real time of the hand's clock."""
    with open_film(path, fps) as add:
        frames = 0
        for sample in samples:
            while frames <= sample.state.t * fps:
                add(camera.take())
                frames += 1
            yield sample


def check_av() -> None:
    """Raise ConfigError without PyAV."""
    if find_spec("av") is None:
        raise ConfigError("a film needs PyAV: pip install 'allegro-twin[view]'")


def film(pictures: Iterable[Picture], path: Path, fps: int) -> None:
    """An H.264 film of pictures, so many a second. Raises ConfigError without PyAV."""
    check_av()
    with open_film(path, fps) as add:
        for picture in pictures:
            add(picture)


@contextmanager
def open_film(path: Path, fps: int) -> Iterator[Callable[[Picture], None]]:
    """A film to which pictures of one size are added, so many a second; it is there when the block ends. Raises
    ConfigError for a suffix that no film has, ImportError without PyAV."""
    container = CONTAINERS.get(path.suffix)
    if container is None:
        raise ConfigError(f"{path}: a film ends in {' or '.join(CONTAINERS)}")
    import av

    with atomic_file(path) as temporary, av.open(str(temporary), "w", format=container) as written:
        stream: Any = None

        def add(picture: Picture) -> None:
            nonlocal stream
            picture = _even(picture)
            if stream is None:
                stream = written.add_stream("libx264", rate=fps, options={"crf": "23"})
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"
            written.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))

        yield add
        if stream is not None:
            written.mux(stream.encode())


def _even(picture: Picture) -> Picture:
    """With the last row or column twice where there is an odd number of them: the codec halves the colours."""
    rows, columns = picture.shape[0] % 2, picture.shape[1] % 2
    return np.pad(picture, ((0, rows), (0, columns), (0, 0)), mode="edge") if rows or columns else picture
