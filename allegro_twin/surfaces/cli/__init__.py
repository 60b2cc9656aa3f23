"""The command line, allegro-twin. One folder for each panel of its --help.

What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.surfaces.cli import console, exit_codes, options
    from allegro_twin.surfaces.cli.grasps.trials import engine_of
    from allegro_twin.surfaces.cli.main import app

__all__ = ["app", "console", "engine_of", "exit_codes", "options"]
__getattr__, __dir__ = exports(__name__, {"grasps.trials": ("engine_of",), "main": ("app",)})
