"""What the campaign prints and keeps of its hands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.twin_table import BARS, table, write
from benchmarks.twins import item


def hand(seed: int, backlash: float) -> dict[str, Any]:
    """A row as the campaign has it: everything off by a thousandth, a torque constant not determined."""
    errors = {f"{name}{end}": json.dumps([value] * 16) for name in BARS for end, value in _ENDS.items()}
    errors["torque_constant_determined"] = json.dumps([1.0, 1.0, 0.0] + [1.0] * 13)
    moved = {"nominal_mrad": json.dumps([200.0] * 16), "open_loop_mrad": json.dumps([float(seed)] * 16)}
    moved["truth_mrad"] = json.dumps([0.5] * 16)
    own = {"key": "x", "error": None, "kind": "mismatched", "seed": seed, "backlash_true": backlash, "loose": seed == 2}
    return own | errors | moved | {"residual": json.dumps([1.0] * 16), "cpu_s": 80.0, "data_s": 40.0}


_ENDS = {"": -0.001, "_inside": 1.0, "_determined": 1.0}
ROWS = [hand(2, 0.005), hand(1, 0.0), hand(5, 0.005)]


def test_a_campaign_is_a_table_of_determined_values_beside_their_bars() -> None:
    lines = list(table(ROWS, "mismatched"))
    assert lines[0] == "mismatched: 3 hands, seeds 1, 2, 5"
    assert "| torque constant | 0.1 / 0.1 / 0.1 % | 45 of 48 | 100 % | 3 / 10 % |" in lines
    assert "| hands with backlash of which some was seen | 1 of 2 | | | |" in lines
    assert (
        "| open loop 5 s, with backlash, by joint | 3.5 / 5 / 5 mrad | 32 of 32 within | | ≤ 15 mrad, ≥ 10× |" in lines
    )
    assert "| the same by hand | 2, 5 mrad | | | ≤ 15 mrad, ≥ 10× |" in lines
    assert "| the same with the true drive | 0.5, 0.5 mrad | | | |" in lines
    assert "| the same, nominal: median; better by, median | 200 mrad; 70× | | | |" in lines
    assert "| CPU for 60 s of data, median / worst | 120 / 120 s | | | ≤ 180 s |" in lines


def test_what_is_kept_is_every_hand_joint_by_joint(tmp_path: Path) -> None:
    write(tmp_path / "all.json", ROWS, "a command", "a machine")
    kept = json.loads((tmp_path / "all.json").read_text())
    assert (kept["command"], kept["machine"], [each["seed"] for each in kept["hands"]]) == (
        "a command",
        "a machine",
        [1, 2, 5],
    )
    np.testing.assert_array_equal(kept["hands"][0]["damping"], [-0.001] * 16)
    assert not {"key", "error"} & set(kept["hands"][0])


def test_a_third_of_the_mismatched_hands_has_backlash() -> None:
    loose = [seed for seed in range(20) if item(seed, "mismatched", "known")["backlash"]]
    assert loose == [1, 4, 7, 10, 13, 16, 19]
    assert not any(item(seed, "matched", "known")["backlash"] for seed in range(20))
