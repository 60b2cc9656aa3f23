"""The running cell meets something hard: it stops, says what, backs off, and tries again or ends by its name."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from allegro_twin.cell.journal.rows import state_entry
from allegro_twin.cell.remote.remote_control import PalmCommand
from allegro_twin.cell.run import LabReport, perform
from allegro_twin.cell.states import CellOutcome, MachineState
from allegro_twin.kinematics.pose import Pose
from allegro_twin.types import Array
from tests.cell.test_remote_control import remote
from tests.cell.test_run import cell_of, states, still

REFLEX = CellOutcome("fault", "cartesian_reflex", "the force on the flange of fer along z is 41 N")


def test_recordings_ros_and_panel_hear_of_a_reflex_when_the_arm_backs_off() -> None:
    work: Any = SimpleNamespace(target=SimpleNamespace(candidate=None), held=SimpleNamespace(found=None))
    row = state_entry(MachineState("Retreat", 1.5, cause=REFLEX), work)
    assert (row["reason"], row["sentence"]) == ("cartesian_reflex", REFLEX.sentence)
    assert "end" not in row


HIGHER = np.array([0.0, 0.0, 0.06])
"""m: the table comes up so far, unseen."""


def raised(times: int) -> tuple[LabReport, list[MachineState], bool, Array]:
    """A run in which the table is higher during the first approaches, and the thing away; whether the arm stands."""
    cell, heard = cell_of(), list[MachineState]()
    world = cell.robot.world
    table, apple = world.model.geom("table").id, world.data.joint("apple")
    home, place = world.model.geom_pos[table].copy(), apple.qpos.copy()
    heights = list[Array]()

    def entered(now: MachineState) -> None:
        heard.append(now)
        heights.append(cell.robot.palm(cell.robot.arm_sim._state()).position)
        if now.state == "Approach" and now.tries <= times:
            world.model.geom_pos[table] = home + HIGHER
            apple.qpos[:3] = [2.0, 2.0, 1.0]  # Off the table.
        elif now.state == "ToSecurityPose":
            world.model.geom_pos[table] = home
            apple.qpos[:], apple.qvel[:] = place, 0.0

    report = perform(cell, on_state=entered)
    stands = still(cell)
    cell.close()
    return report, heard, stands, np.array(heights)


@pytest.mark.slow
def test_a_cell_that_meets_the_table_backs_off_upwards_and_takes_the_thing_at_the_second_try() -> None:
    report, heard, stands, palms = raised(1)
    assert str(report.end) == "held"
    assert report.is_lifted
    assert report.tries == 2
    assert stands
    assert states(report)[3:6] == ["Approach", "Retreat", "ToSecurityPose"]
    assert heard[4].cause is not None
    assert heard[4].cause.reason == "cartesian_reflex"
    assert "the force on the flange of fer along z is" in heard[4].cause.sentence
    assert palms[5, 2] - palms[4, 2] == pytest.approx(0.05, abs=0.01)


@pytest.mark.slow
def test_a_cell_that_meets_the_table_every_time_ends_by_the_name_of_the_reflex_and_stands() -> None:
    report, _, stands, _ = raised(9)
    assert str(report.end) == "fault: cartesian_reflex"
    assert "beyond upper_force_thresholds" in report.end.sentence
    assert states(report)[-2:] == ["Retreat", "Done"]
    assert stands


@pytest.mark.slow
def test_a_cell_that_is_led_onto_something_says_so_and_can_be_led_away() -> None:
    cell = cell_of()
    world = cell.robot.world
    world.model.geom_pos[world.model.geom("table").id] += [0.0, 0.0, 0.1]
    palm, turned = cell.security.position, cell.security.rotation
    low = Pose(np.array([palm[0], palm[1], 0.19]), turned)
    seen = remote(cell, {0.1: PalmCommand(low), 2.5: PalmCommand(cell.security)}, 5.0)
    assert len(seen.said) == 1
    assert "cartesian_reflex" in seen.said[0]
    assert "It is recovered and backs off by 0.05 m: lead it another way" in seen.said[0]
    np.testing.assert_allclose(seen.tool[-1][:3], palm, atol=5e-3)
    cell.close()
