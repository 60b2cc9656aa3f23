"""`allegro-twin`, and `python -m allegro_twin`: quiet about Ctrl-C, and about what the computer refuses, from its first
import on."""

from __future__ import annotations

import os
import signal
import sys


def main() -> None:
    """Run the command line."""
    # No hand is open yet, and a library that is stopped in the middle of its import says so in many lines.
    before = signal.signal(signal.SIGINT, lambda number, frame: os._exit(130))
    from allegro_twin.files.standard_streams import open_streams
    from allegro_twin.surfaces.cli.computer_errors import REINSTALL, computer_error

    open_streams()
    try:
        from allegro_twin.surfaces.cli.main import main as run
    except (ImportError, OSError, MemoryError) as error:
        if not (said := computer_error(error, REINSTALL)):
            raise
        sys.stderr.write(f"allegro-twin: {said}\n")
        sys.exit(2)
    signal.signal(signal.SIGINT, before)
    run()


if __name__ == "__main__":
    main()
