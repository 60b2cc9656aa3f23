"""What is in the way of arm and hand is found before they go: the table, the thing, and the arm behind the wrist."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.planning.reachability import far_path
from allegro_twin.cell.run import perform
from allegro_twin.cell.states import MachineState
from allegro_twin.sim.contact.obstacle_clearance import NEAR, ObstacleClearance, TableObject
from allegro_twin.types import Array, Vector
from tests.cell.test_run import cell_of, states, still


@pytest.fixture(scope="module")
def cell() -> Cell:
    """A cell whose arm stands where it waits; made once."""
    return cell_of()


@pytest.fixture
def clearance(cell: Cell) -> Iterator[ObstacleClearance]:
    cell.robot.arm.reset()
    yield cell.clearance
    cell.clearance.clear_table()


def through(cell: Cell, *postures: Vector) -> tuple[Array, Array]:
    """Postures on the way, and an open hand for each."""
    legs = [far_path(begin, end, 1.5)[0] for begin, end in pairwise(postures)]
    arm = np.concatenate(legs)
    return arm, np.tile(cell.open, (len(arm), 1))


def moved(cell: Cell, **joints: float) -> Vector:
    posture = cell.posture.copy()
    for name, by in joints.items():
        posture[int(name[1:])] += by
    return posture


def test_nothing_is_in_the_way_of_a_hand_that_turns_in_the_air(cell: Cell, clearance: ObstacleClearance) -> None:
    clearance.clear_table()
    assert clearance.check_path(*through(cell, cell.posture, moved(cell, q0=0.8), moved(cell, q0=-0.8))) is None


@pytest.mark.parametrize("kind", ["box", "sphere", "cylinder", "lying ellipsoid", "lying cylinder"])
def test_a_thing_that_stands_in_the_way_is_named_and_one_beside_it_is_none(
    cell: Cell, clearance: ObstacleClearance, kind: str
) -> None:
    palm = cell.robot.palm(cell.robot.arm.reset()).position
    way = through(cell, moved(cell, q0=-0.6), moved(cell, q0=0.6))
    clearance.see(TableObject(kind, (0.1, 0.1, 0.1), 0.3, palm - np.array([0.0, 0.0, 0.05])))
    met = clearance.check_path(*way)
    assert met is not None
    assert met.other == "the thing"
    assert met.distance < NEAR
    clearance.see(TableObject(kind, (0.1, 0.1, 0.1), 0.3, palm + np.array([0.5, 0.0, -0.05])))
    assert clearance.check_path(*way) is None


def test_a_table_in_the_way_is_named_and_a_hand_that_lies_on_it_may_rise(
    cell: Cell, clearance: ObstacleClearance
) -> None:
    clearance.clear_table()
    down = through(cell, cell.posture, moved(cell, q1=1.0))
    met = clearance.check_path(*down)
    assert met is not None
    assert str(met).endswith("the table")
    near = next(
        row for row in range(len(down[0])) if clearance.check_path(down[0][: row + 1], down[1][: row + 1]) is not None
    )
    up = down[0][near::-1], down[1][near::-1]
    assert clearance.check_path(*up) is None


@pytest.mark.slow
def test_a_grasp_that_would_have_the_arm_in_the_table_is_refused_in_one_line_and_nothing_moves() -> None:
    hand = {"model": "qb_softhand", "side": "right"}
    cell = cell_of(hand=hand, objects=[{"name": "golf_ball", "at": [0.0, 0.03]}])
    report = perform(cell)
    assert str(report.end) == "refused: no_grasp"
    assert "mm deep in the table on the way to its golf_ball grasp" in report.end.sentence
    assert "\n" not in report.end.sentence
    assert states(report) == ["ToSecurityPose", "Look", "Done"]
    assert still(cell)


@pytest.mark.slow
def test_a_way_back_through_the_table_is_not_gone() -> None:
    cell = cell_of(decide={"retries": 1})
    low = cell.posture + np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])

    def gone(now: MachineState) -> None:
        if now.state == "Approach" and now.tries == 1:
            cell.robot.world.data.joint("apple").qpos[:3] = [2.0, 2.0, 1.0]
            cell.posture[:] = low  # Where it waits is in the table now.

    cell.posture.setflags(write=True)
    report = perform(cell, on_state=gone)
    assert str(report.end) == "fault: in the way"
    assert "on the way back to where it waits: the arm stands still" in report.end.sentence
    assert still(cell)


@pytest.mark.parametrize("finger", ["index", "middle", "ring", "thumb"])
def test_every_fingertip_that_is_near_something_is_found_whatever_its_shapes(
    cell: Cell, clearance: ObstacleClearance, finger: str
) -> None:
    tip = cell.robot.world.data.site(cell.hand.spec.finger(finger).tip).xpos.copy()
    here = cell.posture[None], cell.open[None]
    clearance.clear_table()
    assert clearance.of_others(*here) is None
    clearance.set_obstacles([TableObject("box", (0.02, 0.02, 0.1), 0.0, tip - np.array([0.0, 0.0, 0.055]))])
    met = clearance.of_others(*here)
    assert met is not None
    assert met.other == "another object"
    clearance.see(TableObject("box", (0.02, 0.02, 0.1), 0.0, tip - np.array([0.0, 0.0, 0.055])))
    assert {other for _, other in clearance._near(cell.posture, cell.open)} >= {"the thing", "another object"}
    clearance.clear_table()
    assert not clearance.crowded
