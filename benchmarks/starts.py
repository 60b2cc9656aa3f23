"""The start states that ship with the package: `python -m benchmarks.starts` searches for those that are missing."""

from __future__ import annotations

import sys

from allegro_twin.files.assets import data_root
from allegro_twin.learning.tasks.in_hand import OBJECTS, OF_PALM, in_hand_object
from allegro_twin.learning.tasks.start_states import (
    ALL,
    ANYHOW,
    FINGERTIPS,
    TEST,
    TRAIN,
    file_name,
    write_start_states,
)

if __name__ == "__main__":
    wanted = [(name, ANYHOW, ALL) for name in OF_PALM]
    wanted += [(name, FINGERTIPS, states) for name in (*OBJECTS, "hex_nut") for states in (TRAIN, TEST)]
    for name, search, states in wanted:
        thing = in_hand_object(name)
        path = data_root() / "conf" / "starts" / file_name(thing, search, states)
        if sys.argv[1:] and name not in sys.argv[1:]:
            continue
        if not path.is_file():
            write_start_states(thing, path, search, states)
        print(name, path.name, flush=True)
