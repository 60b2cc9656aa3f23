"""The states that ship with the package: `python -m benchmarks.starts rubiks_cube` searches for them anew."""

from __future__ import annotations

import sys

from allegro_twin.files.assets import data_root
from allegro_twin.learning.tasks.start_states import file_name, write_start_states
from allegro_twin.sim.objects.catalogue import load_object

if __name__ == "__main__":
    for name in sys.argv[1:]:
        path = data_root() / "conf" / "starts" / file_name(load_object(name))
        write_start_states(load_object(name), path)
        print(path)
