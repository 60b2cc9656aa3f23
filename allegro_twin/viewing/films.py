"""H.264 films: of a run as it happens, in real time of the hand's clock, or of any pictures."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import ConfigError, HandError, RecordingError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.types import Sample
from allegro_twin.viewing.camera import Camera, Picture

CONTAINERS = {".mp4": "mp4", ".mkv": "matroska", ".mov": "mov"}
"""Formats by the suffixes of their files."""
_log = logging.getLogger(__name__)


def filmed(samples: Iterable[Sample], camera: Camera, path: Path, fps: int = 30) -> Iterator[Sample]:
    """A stage that makes an H.264 film in real time of the hand's clock, as `open_film` does."""
    with open_film(path, fps) as add:
        yield from film_samples(samples, camera, add, fps)


def film_samples(
    samples: Iterable[Sample], camera: Camera, add: Callable[[Picture], None], fps: int = 30
) -> Iterator[Sample]:
    """A stage that adds pictures to a film that is open, so many a second of the hand's clock."""
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
def open_film(path: Path, fps: int = 30) -> Iterator[Callable[[Picture], None]]:
    """A film to which pictures of one size are added, so many a second; it is there when the block ends, also by a
    HandError or Ctrl-C: it is what was filmed until then. Raises ConfigError for a suffix that no film has, ImportError
    without PyAV, and at the end of the block RecordingError when the disk is full; where the block ends by an error of
    its own that is logged."""
    container = CONTAINERS.get(path.suffix)
    if container is None:
        raise ConfigError(f"{path}: a film ends in {' or '.join(CONTAINERS)}")
    import av

    ended: BaseException | None = None
    try:
        with atomic_file(path) as temporary, av.open(str(temporary), "w", format=container) as written:
            made = _Film(path, written, fps)
            try:
                yield made.add
            except (HandError, KeyboardInterrupt, GeneratorExit) as error:
                if not made.begun:
                    raise
                ended = error
            made.finish()
    except RecordingError as error:
        if ended is None:
            raise
        _log.warning("%s", error)
    if ended is not None:
        raise ended


class _Film:
    """H.264 in a container of PyAV. An error of the disk or the codec waits for `finish`: whoever is filmed goes on."""

    def __init__(self, path: Path, written: Any, fps: int) -> None:
        self._path, self._written, self._fps = path, written, fps
        self._stream: Any = None
        self._error: Exception | None = None

    @property
    def begun(self) -> bool:
        """Whether there is a picture."""
        return self._stream is not None

    def add(self, picture: Picture) -> None:
        """One more; all have the size of the first."""
        if self._error is not None:
            return
        import av

        picture = _even(picture)
        if self._stream is None:
            self._stream = self._written.add_stream("libx264", rate=self._fps, options={"crf": "23"})
            self._stream.height, self._stream.width = picture.shape[:2]
            self._stream.pix_fmt = "yuv420p"
        try:
            self._written.mux(self._stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        except (OSError, av.FFmpegError) as error:
            self._error = error

    def finish(self) -> None:
        """Write what the codec has still. Raises OSError, also that of a picture before, and RecordingError where the
        codec failed."""
        import av

        try:
            if self._error is not None:
                raise self._error
            if self._stream is not None:
                self._written.mux(self._stream.encode())
        except OSError:
            raise
        except av.FFmpegError as error:
            why = f"the codec failed ({error.strerror}); is there enough memory, or a limit (`ulimit -v`)?"
            raise RecordingError(f"cannot write {self._path}: {why}") from error


def _even(picture: Picture) -> Picture:
    """With the last row or column twice where there is an odd number of them: the codec halves the colours."""
    rows, columns = picture.shape[0] % 2, picture.shape[1] % 2
    return np.pad(picture, ((0, rows), (0, columns), (0, 0)), mode="edge") if rows or columns else picture
