"""Still pictures of a run: its moments side by side, and one sheet of many runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.types import Sample
from allegro_twin.viewing import camera as cameras
from allegro_twin.viewing.camera import Camera, Picture, Scene
from allegro_twin.viewing.films import film_samples, open_film
from allegro_twin.viewing.overlays import Mark
from allegro_twin.viewing.views import AUTO

_PANES = "panes"
"""In a strip's metadata: how many pictures stand side by side."""
_QUICKLY = 3
"""zlib's level for pictures: a third of the time of its usual 6, a third more bytes (100 kB a strip)."""


def pictured(
    samples: Iterable[Sample], camera: Camera, path: Path, moments: Sequence[float], objects: Sequence[str] = ()
) -> Iterator[Sample]:
    """A stage that takes a picture at each of the moments (s), and in the end, side by side in one PNG. With `objects`
    the camera turns to where most of the grip on them is seen."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    left = sorted(moments)
    pictures: list[Picture] = []

    def take() -> None:
        pictures.append(camera.take_still(objects) if objects else camera.take())

    for sample in samples:
        if left and sample.state.t >= left[0] - 1e-9:
            take()
            left.pop(0)
        yield sample
    if left or not pictures:
        take()
    with atomic_file(path) as temporary:
        told = PngInfo()
        told.add_text(_PANES, str(len(pictures)))
        Image.fromarray(np.hstack(pictures)).save(temporary, pnginfo=told, compress_level=_QUICKLY)


def overview(strips: Mapping[str, Path], target: Path, *, pane: int = 1, columns: int = 6) -> None:
    """One picture of many trials: a pane of every strip that `pictured` made, with its name."""
    from PIL import Image, ImageDraw, ImageFont

    size = 240
    rows = -(-len(strips) // columns)
    sheet = Image.new("RGB", (columns * size, rows * size), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    for index, (name, path) in enumerate(strips.items()):
        strip = Image.open(path)
        panes = int(strip.info.get(_PANES, strip.width // strip.height))
        wide = strip.width // panes
        edge, left = min(wide, strip.height), min(pane, panes - 1) * wide
        middle = (left + (wide - edge) // 2, (strip.height - edge) // 2)
        corner = (index % columns * size, index // columns * size)
        part = strip.crop((*middle, middle[0] + edge, middle[1] + edge))
        sheet.paste(part.resize((size, size)), corner)
        draw.text((corner[0] + 8, corner[1] + 6), name, fill=(40, 40, 40), font=font)
    with atomic_file(target) as temporary:
        sheet.save(temporary, compress_level=_QUICKLY)


def picture_all(folder: Path, names: Iterable[str]) -> Path | None:
    """One picture of all trials in a folder; None where there are no pictures."""
    strips = {name: folder / f"{name}.png" for name in names}
    if not strips or not all(path.is_file() for path in strips.values()):
        return None
    overview(strips, folder / "overview.png")
    return folder / "overview.png"


def photographed(
    samples: Iterator[Sample],
    scene: Scene,
    video: Path | None,
    image: Path | None,
    moments: Sequence[float],
    size: tuple[int, int],
    view: str,
    stack: ExitStack,
    objects: Sequence[str] = (),
    marks: Callable[[], Sequence[Mark]] = tuple,
) -> Iterator[Sample]:
    """The stages that make a film and a strip; the stack closes the cameras and the film. In the view `auto` the
    strip's camera turns to the grip on the objects. `marks`: as of a camera. Raises as a camera does."""

    def eye() -> Camera:
        found = cameras.Camera(scene, width=size[0], height=size[1], view=view, marks=marks)
        stack.callback(found.close)
        return found

    if video is not None:
        import av  # noqa: F401  # Whoever has no films should hear so before the hand moves.

        samples = film_samples(samples, eye(), stack.enter_context(open_film(video)))
    return samples if image is None else pictured(samples, eye(), image, moments, objects if view == AUTO else ())


def save_png(picture: Picture, path: Path) -> None:
    """Write a picture as a .png; a file that is there is replaced as a whole."""
    from PIL import Image

    with atomic_file(path) as temporary:
        Image.fromarray(picture).save(temporary, format="png")
