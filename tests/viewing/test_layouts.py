"""What Rerun is asked to arrange is what somebody has looked at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra view")

from allegro_twin.hands.description.appearance import VisualShape
from allegro_twin.hands.description.specs import load_spec  # Behind the check for the extra.
from allegro_twin.viewing.rerun.layout import cell_layout, hand_layout
from allegro_twin.viewing.scenery import Scenery
from allegro_twin.viewing.skeleton import bodies_of
from tests.snapshots import assert_snapshot

SNAPSHOTS = Path(__file__).with_name("snapshots")


def numbers(value: Any) -> str:
    found = np.round(np.array(value.as_arrow_array().to_pylist(), dtype=float), 6) + 0.0
    return str(found.reshape(-1).tolist())


def told(part: Any, depth: int = 0) -> list[str]:
    """A container or a view, and what is in it, a line each."""
    facts = [
        type(part).__name__,
        *(f"{key}={getattr(part, key)}" for key in ("name", "origin") if getattr(part, key, None)),
    ]
    facts += [
        f"{key}={getattr(part, key)}" for key in ("row_shares", "column_shares") if getattr(part, key, None) is not None
    ]
    inside = [each for each in part.contents if not isinstance(each, str)]
    if not inside:
        facts.append(f"contents={part.contents}")
    for key, each in sorted((getattr(part, "properties", None) or {}).items()):
        places = [f"{name} {numbers(getattr(each, name))}" for name in ("position", "look_target", "eye_up")
                  if getattr(each, name, None) is not None]  # fmt: skip
        facts.append(f"{key}({', '.join(places)})")
    lines = [" " * depth + " ".join(facts)]
    for each in inside:
        lines += told(each, depth + 2)
    return lines


def test_a_hand_stands_beside_its_fingers_and_above_its_phases() -> None:
    spec = load_spec()
    full = Scenery(
        bodies_of(spec), objects={"mug": [VisualShape("sphere", (0.02,))]}, phases=[("lift", 0.0, 1.0)],
        palm=(0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0), more=("disturbance", "temperature"), link=("missed",),
    )  # fmt: skip
    assert_snapshot("\n".join(told(hand_layout(spec, full, "side").root_container)), SNAPSHOTS / "hand.txt")
    alone = Scenery(bodies_of(spec))
    assert_snapshot("\n".join(told(hand_layout(spec, alone, "palm").root_container)), SNAPSHOTS / "hand_alone.txt")


def test_a_cell_is_looked_at_from_beside_its_arm() -> None:
    arm, hand = load_spec("fer"), load_spec()
    shown = cell_layout(hand, arm, (1.0, 2.0, 3.0)).root_container
    assert_snapshot("\n".join(told(shown)), SNAPSHOTS / "cell.txt")
