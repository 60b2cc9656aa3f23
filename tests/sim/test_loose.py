"""A joint that comes loose while its hand moves: in a simulation, and in a virtual hand by script and by chance."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.sim.drivetrain.backlash import allow_backlash
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import AILMENTS
from allegro_twin.types import Array, TorqueCommand
from tests.conftest import MakeSim, on_a_bus

TIP = 7
HUNG = np.where(np.arange(16) == TIP, 0.1, 0.0)  # N·m, which press the link against one tooth, then the other.


def test_a_loose_link_falls_from_tooth_to_tooth_from_that_moment_on(spec: HandSpec, make_sim: MakeSim) -> None:
    backend = make_sim(allow_backlash(spec, [TIP]))
    play = int(backend.model.joint(f"{spec.joints[TIP]}_play").qposadr[0])
    backend.reset()
    spread = {}
    for amount in (0.0, 0.04):
        if amount:
            backend.suffer("loose", TIP, amount)
        where = []
        for torque in (HUNG, -HUNG):
            for _ in range(40):
                backend.write(TorqueCommand(torque))
                backend.read()
                where.append(float(backend.data.qpos[play]))
        spread[amount] = np.ptp(where)
    assert spread[0.0] < 5e-4
    assert spread[0.04] == pytest.approx(0.04, abs=4e-3)  # Teeth are a little soft.


def test_a_joint_without_a_play_says_what_it_needs_to_come_loose(spec: HandSpec, make_sim: MakeSim) -> None:
    with pytest.raises(ConfigError, match="its drive.backlash must be at least 0.0001 rad"):
        make_sim(spec).suffer("loose", TIP, 0.04)


def pushed(script: tuple[dict[str, object], ...] = (), **chance: float) -> Array:
    """Where a virtual hand's joints are, pushed to and fro."""
    backend = on_a_bus("v4", scene={"kind": "sim"}, faults={"script": list(script), **chance})
    found = [backend.reset().position]
    for k in range(80):
        backend.write(TorqueCommand(HUNG if k // 20 % 2 == 0 else -HUNG))
        found.append(backend.read().position)
    backend.close()
    return np.array(found)


def test_a_virtual_hands_fingertip_comes_loose_by_script() -> None:
    tight, loose = (pushed(({"at": at, "what": "loose", "which": TIP, "amount": 0.06},)) for at in (9.0, 0.06))
    np.testing.assert_array_equal(tight[:10], loose[:10])
    assert np.abs(tight - loose)[:, TIP].max() > 0.02


def test_chance_loosens_fingertips_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for other in [name for name in AILMENTS if name != "loose"]:
        monkeypatch.delitem(AILMENTS, other)
    well, ill = pushed(), pushed(failures=4000.0, seed=1)
    assert np.abs(well - ill)[:, [3, 7, 11, 15]].max() > 0.01
