"""A mirror in Rerun: the expected hand beside the measured one, what pushes it, and what that means."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from allegro_twin.drivers.can.driver.health import Health
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.observer.observer import StateObserver
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.results.gap import drive_parameters
from allegro_twin.twin.mirror.fault_detection import Thresholds
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.twin.mirror.rerun_view import COUNTS, draw_mirror, mirror_scenery
from allegro_twin.viewing.rerun.viewer import Viewer
from tests.conftest import MakeSim
from tests.twin.mirror.test_mirror import N, moving
from tests.viewing.test_viewer import rows_of


@pytest.fixture
def hand(spec: HandSpec, make_sim: MakeSim) -> SimBackend:
    return make_sim(spec, posture=(spec.lower + spec.upper) / 2.0)


def test_the_view_has_both_hands_what_pushes_and_what_happens(spec: HandSpec, hand: SimBackend, tmp_path: Path) -> None:
    observer = StateObserver(spec, drive_parameters(spec, np.ones(N), np.zeros(N)), 0.003)
    each = Mirror(spec, observer, np.ones(N), Thresholds.default(spec))
    push, health = np.zeros(N), Health(missed=7)
    push[9] = 0.06
    viewer = Viewer(spec, mirror_scenery(spec), rate=10.0).to_file(tmp_path / "mirror.rrd")
    for _ in draw_mirror(each.watch(moving(spec, hand, push)), each, viewer, health):
        pass
    viewer.close()
    found = rows_of(tmp_path / "mirror.rrd")
    assert found["world/palm/target/link_1.0"]
    names = [row["names"] for t, row in found["joints/target/ring"] if t is None]
    assert names[0][0] == "ring_0 expected"
    pushed = {round(t, 1): row["scalars"][1] for t, row in found["joints/disturbance/ring"] if t is not None}
    assert abs(pushed[1.5]) < 0.005
    assert pushed[3.0] == pytest.approx(0.06, rel=0.2)
    events = [(t, row["state"]) for t, row in found["mirror/event"]]
    assert events[0][1] == ["not looked for: weak, friction, payload, wrong_file, supply"]
    assert events[1][1] == ["ring is touched"]
    assert events[1][0] == pytest.approx(2.01, abs=0.03)
    assert [row["names"] for t, row in found["mirror/link"] if t is None] == [list(COUNTS)]
    last = found["mirror/link"][-1][1]["scalars"]
    assert last[COUNTS.index("missed")] == 7.0
    assert "joints/temperature/ring" not in {name for name, rows in found.items() if any(t for t, _ in rows)}
    assert len(pushed) == pytest.approx(40, abs=3)  # Ten a second.
