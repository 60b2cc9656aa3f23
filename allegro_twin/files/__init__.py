"""Files: what ships with the package, YAML as settings, files written whole or not at all, fingerprints.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.files.assets import data_root, find_file, read_yaml
    from allegro_twin.files.atomic_write import atomic_file, atomic_folder
    from allegro_twin.files.fingerprints import fingerprint, source_fingerprint
    from allegro_twin.files.output_folder import lock_folder
    from allegro_twin.files.schema import Positive, Settings, load_settings, parse_settings

__all__ = [
    "Positive",
    "Settings",
    "atomic_file",
    "atomic_folder",
    "data_root",
    "find_file",
    "fingerprint",
    "load_settings",
    "lock_folder",
    "parse_settings",
    "read_yaml",
    "source_fingerprint",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "assets": (
            "data_root",
            "find_file",
            "read_yaml",
        ),
        "atomic_write": (
            "atomic_file",
            "atomic_folder",
        ),
        "fingerprints": (
            "fingerprint",
            "source_fingerprint",
        ),
        "output_folder": ("lock_folder",),
        "schema": (
            "Positive",
            "Settings",
            "load_settings",
            "parse_settings",
        ),
    },
)
