"""`allegro-twin`, and `python -m allegro_twin`: quiet about Ctrl-C from its first import on."""

from __future__ import annotations

import os
import signal


def main() -> None:
    """Run the command line."""
    # No hand is open yet, and a library that is stopped in the middle of its import says so in many lines.
    before = signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))
    from allegro_twin.surfaces.cli.main import main as run

    signal.signal(signal.SIGINT, before)
    run()


if __name__ == "__main__":
    main()
