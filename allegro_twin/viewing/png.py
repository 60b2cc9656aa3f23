"""A picture as a file."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.viewing.camera import Picture


def save(picture: Picture, path: Path) -> None:
    """Write it as a .png; a file that is there is replaced as a whole."""
    from PIL import Image

    with atomic_file(path) as temporary:
        Image.fromarray(picture).save(temporary, format="png")
