"""How the cell's arm goes: as on a spring that no friction holds."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.arm.faults import DisturbedBackend
from allegro_twin.cell.arm.impedance import Stiffness
from allegro_twin.cell.arm.target import SMOOTH
from allegro_twin.cell.motion.arm_motion import ArmGuide, GuidedImpedance
from allegro_twin.loop import run, until
from tests.cell.arm.rigs import rig
from tests.cell.arm.test_control import BARE


@pytest.mark.parametrize("name", ["fer", "fr3"])
def test_a_push_moves_the_cells_arm_as_its_spring_says_in_spite_of_friction_and_a_noisy_sensor(name: str) -> None:
    push = np.zeros((2500, 3))
    push[50:, 0] = -10.0
    arm = rig(name, push)
    guide = ArmGuide(arm.model.spec.ready, arm.model)
    guide.let_go()
    law = GuidedImpedance(arm.model, guide, Stiffness(1000.0, 50.0).diagonal(), SMOOTH, BARE)
    noisy = DisturbedBackend(arm.guard, np.array([1.3, 1.3, 1.3, 0.0, 0.0, 0.0]))
    *_, last = until(2.5, run(noisy, law))
    assert arm.moved(last.state)[0] == pytest.approx(-0.01, rel=0.03)
