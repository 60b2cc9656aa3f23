"""The start states that ship with the package: `python -m benchmarks.starts [OBJECT …]` searches for missing ones."""

from __future__ import annotations

import sys

from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.tasks.in_hand import OBJECTS, OF_OTHERS, OF_PALM, in_hand_object
from allegro_twin.learning.tasks.start_states import (
    ALL,
    ANYHOW,
    CRADLE,
    FINGERTIPS,
    TEST,
    TRAIN,
    Search,
    StartSet,
    file_name,
    write_start_states,
)

SETS = (TRAIN, TEST)
OTHER_HANDS = ("leap",)

if __name__ == "__main__":
    wanted: list[tuple[str, str, Search, StartSet]] = [("allegro", name, ANYHOW, ALL) for name in OF_PALM]
    wanted += [("allegro", name, FINGERTIPS, states) for name in (*OBJECTS, "hex_nut") for states in SETS]
    wanted += [("allegro", name, CRADLE, states) for name in (*OBJECTS, "hex_nut") for states in SETS]
    wanted += [(hand, name, search, states) for hand in OTHER_HANDS for name in OF_OTHERS
               for search in (FINGERTIPS, CRADLE) for states in SETS]  # fmt: skip
    for hand, name, search, states in wanted:
        thing, spec = in_hand_object(name), load_spec(hand)
        search = search.of(spec)
        path = data_root() / "conf" / "starts" / file_name(thing, search, states, spec)
        if sys.argv[1:] and name not in sys.argv[1:]:
            continue
        if not path.is_file():
            write_start_states(thing, path, search, states, spec)
        print(hand, name, path.name, flush=True)
