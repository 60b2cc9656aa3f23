"""A picture as a file."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.files.whole import whole_file
from allegro_twin.look.camera import Picture


def save(picture: Picture, path: Path) -> None:
    """Write it as a .png; a file that is there is replaced as a whole."""
    from PIL import Image

    with whole_file(path) as temporary:
        Image.fromarray(picture).save(temporary, format="png")
