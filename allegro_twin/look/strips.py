"""Still pictures of a run: its moments side by side, and one sheet of many runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from allegro_twin.files.whole import whole_file
from allegro_twin.look.camera import Camera, Picture
from allegro_twin.types import Sample


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
