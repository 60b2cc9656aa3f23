"""What a drive does to a simulated hand, and that a hand without one is untouched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.recording.spec_json import spec_from_json, spec_to_json
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.open_loop import _bare
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.types import HandState, TorqueCommand
from tests.conftest import MakeSim

TORQUE = np.tile([0.02, 0.1, 0.08, 0.05], 4)


def driven(spec: HandSpec, **drive: Any) -> HandSpec:
    return replace(spec, drive=Drive.from_values(drive, 16))


def moved(backend: SimBackend, periods: int, torque: np.ndarray = TORQUE) -> list[HandState]:
    states = [backend.reset()]
    for _ in range(periods):
        backend.write(TorqueCommand(torque))
        states.append(backend.read())
    return states


def positions(states: list[HandState]) -> np.ndarray:
    return np.array([state.position for state in states])


def test_a_drive_that_changes_nothing_moves_bit_for_bit_like_none(spec: HandSpec, make_sim: MakeSim) -> None:
    without, with_one = moved(make_sim(spec), 100), moved(make_sim(driven(spec)), 100)
    np.testing.assert_array_equal(positions(without), positions(with_one))
    np.testing.assert_array_equal([s.velocity for s in without], [s.velocity for s in with_one])


def test_a_torque_acts_after_the_delay_and_not_before(spec: HandSpec, make_sim: MakeSim) -> None:
    limp = positions(moved(make_sim(spec), 4, np.zeros(16)))
    late = positions(moved(make_sim(driven(spec, delay=0.004)), 4))
    np.testing.assert_array_equal(late[:2], limp[:2])  # 4 ms are a period and a step of the next.
    assert (np.abs(late[2] - limp[2])[1:4] > 1e-6).all()
    soon = positions(moved(make_sim(driven(spec, delay=0.006)), 4))
    np.testing.assert_array_equal(soon[:3], limp[:3])


def test_a_link_lags_its_motor_by_the_backlash_where_the_push_turns_round(spec: HandSpec, make_sim: MakeSim) -> None:
    backend = make_sim(driven(spec, backlash=0.005), period=0.003)
    address = int(backend.model.joint(f"{spec.joints[5]}_play").qposadr[0])
    backend.reset()
    there = []
    for torque in (0.3, -0.3):
        for _ in range(30):
            backend.write(TorqueCommand(np.full(16, torque) * (np.arange(16) == 5)))
            state = backend.read()
        motor = backend.data.qpos[backend.model.joint(spec.joints[5]).qposadr[0]]
        there.append(state.position[5] - motor)
        assert there[-1] == pytest.approx(backend.data.qpos[address], abs=1e-12)
    assert sorted(np.sign(there)) == [-1.0, 1.0]
    assert np.abs(there) == pytest.approx([0.0025, 0.0025], abs=4e-4)


@pytest.mark.parametrize("compliance", [0.05, 0.02])
def test_a_link_hangs_on_teeth_that_bend_by_its_weight(spec: HandSpec, make_sim: MakeSim, compliance: float) -> None:
    held = replace(spec, actuation=replace(spec.actuation, frictionloss=np.full(16, 2.0)))  # No motor turns.
    backend = make_sim(driven(held, backlash=0.004, gear_compliance=compliance), period=0.003)
    backend.model.opt.gravity[:] = [9.81, 0.0, 0.0]  # Across the fingers.
    states = moved(backend, 400, np.zeros(16))
    plays = [backend.model.joint(f"{name}_play") for name in spec.joints]
    hangs = np.array([backend.data.qpos[play.qposadr[0]] for play in plays])
    mujoco.mj_rne(backend.model, backend.data, 0, (weight := np.zeros(backend.model.nv)))
    carries = np.array([weight[play.dofadr[0]] for play in plays])
    heavy = np.abs(carries) > 0.04  # Lighter links, at this time step, have softer teeth.
    assert heavy.sum() >= 3
    np.testing.assert_allclose(-hangs[heavy], (np.sign(carries) * 0.002 + compliance * carries)[heavy], rtol=0.02)
    assert np.abs(states[-1].velocity).max() < 1e-3


def test_teeth_that_do_not_bend_are_as_they_were_beside_others_that_do(spec: HandSpec, make_sim: MakeSim) -> None:
    bends = [0.05 if joint == 5 else 0.0 for joint in range(16)]
    hard, mixed = (make_sim(driven(spec, backlash=0.004, **more)).model for more in ({}, {"gear_compliance": bends}))
    plays = [hard.joint(f"{name}_play").id for name in spec.joints]
    same = (hard.jnt_solref[plays] == mixed.jnt_solref[plays]).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(~same), [5])
    np.testing.assert_array_equal(hard.jnt_range[plays], mixed.jnt_range[plays])


def test_everything_the_hand_touches_grows_slippery(spec: HandSpec, make_sim: MakeSim) -> None:
    backend = make_sim(spec)
    before = backend.model.geom_friction[:, 0].copy()
    backend.suffer("slippery", 0, 0.1)
    np.testing.assert_allclose(backend.model.geom_friction[:, 0], 0.1 * before)
    assert before.max() > 0.0


@pytest.mark.parametrize("name", ["leap", "sih", "qb_softhand", "model_o"])
def test_every_hand_grows_slippery_and_a_servo_does_not_grow_weak_in_silence(name: str, make_sim: MakeSim) -> None:
    backend = make_sim(load_spec(name))
    before = backend.model.geom_friction[:, 0].copy()
    backend.suffer("slippery", 0, 0.1)
    np.testing.assert_allclose(backend.model.geom_friction[:, 0], 0.1 * before)
    with pytest.raises(ConfigError, match="moves by servos of its own: `weak` is of motors at joints"):
        backend.suffer("weak", 0, 0.5)


def test_a_weak_motor_gives_its_share_and_no_more_at_its_limit(spec: HandSpec, make_sim: MakeSim) -> None:
    weak = driven(spec, strength=0.5)
    np.testing.assert_allclose(moved(make_sim(weak), 1)[-1].torque, 0.5 * TORQUE, rtol=1e-12)
    far_too_much = moved(make_sim(weak), 1, np.full(16, 9.0))[-1].torque
    np.testing.assert_allclose(far_too_much, 0.5 * spec.actuation.torque_limit, rtol=1e-12)


def test_encoders_are_off_coarse_and_noisy_and_the_noise_is_the_same_after_a_reset(
    spec: HandSpec, make_sim: MakeSim
) -> None:
    true = positions(moved(make_sim(spec), 10))
    off = positions(moved(make_sim(driven(spec, encoder_offset=-0.02)), 10))
    np.testing.assert_allclose(off, true - 0.02, atol=1e-12)
    coarse = positions(moved(make_sim(driven(spec, quantisation=0.01)), 10))
    np.testing.assert_allclose(coarse, np.rint(true / 0.01) * 0.01, atol=1e-12)
    noisy = make_sim(driven(spec, encoder_noise=1e-3))
    first, again = positions(moved(noisy, 200)), positions(moved(noisy, 200))
    np.testing.assert_array_equal(first, again)
    assert np.std(first - positions(moved(make_sim(spec), 200))) == pytest.approx(1e-3, rel=0.1)


def test_links_get_heavier_and_a_weight_hangs_at_one_tip(spec: HandSpec, make_sim: MakeSim) -> None:
    nominal = make_sim(spec)
    weights = [0.0] * 16
    weights[7] = 0.05
    loaded = make_sim(driven(spec, mass_scale=1.1, tip_mass=weights))
    palm = nominal.mass_of("palm_link")
    before, after = (float(each.model.body_mass.sum()) for each in (nominal, loaded))
    assert after - palm == pytest.approx(1.1 * (before - palm) + 0.05)
    assert loaded.mass_of("middle_weight") == pytest.approx(0.05)


def test_a_motor_that_pushes_hard_rubs_more(spec: HandSpec, make_sim: MakeSim) -> None:
    rubbing = make_sim(driven(spec, load_friction=0.2))
    moved(rubbing, 3)
    np.testing.assert_allclose(rubbing.model.dof_frictionloss[:16], spec.actuation.frictionloss + 0.2 * TORQUE)


def test_a_hand_file_holds_a_drive_and_a_recording_keeps_it(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("drive: {delay: 0.0035, encoder_noise: 5.0e-5}\n")
    spec = load_spec(serial=str(file))
    assert spec.drive is not None
    assert (spec.drive.delay, spec.drive.strength[3], spec.drive.encoder_noise[15]) == (0.0035, 1.0, 5e-5)
    again = spec_from_json(spec_to_json(spec)).drive
    assert again is not None
    assert again.plain() == spec.drive.plain()
    assert load_spec().drive is None
    assert "drive" not in spec_to_json(load_spec())


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("{dely: 0.003}", "drive: no key named 'dely'; did you mean 'delay'"),
        ("{delay: 3}", "drive.delay is 3 s, longer than any hand's (0.5 s): it is in s, 3 ms are 0.003"),
        ("{delay: [0.1, 0.2]}", "drive.delay needs numbers, not [0.1, 0.2]"),
        ("{strength: [1, 1]}", "drive.strength needs one number or 16, not 2"),
        ("{strength: 0}", "drive.strength must be above 0, not 0"),
        ("{stiction: 0.5}", "drive.stiction must be at least 1, not 0.5"),
    ],
)
def test_a_drive_that_cannot_be_is_one_line_with_the_file(tmp_path: Path, line: str, said: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"drive: {line}\n")
    with pytest.raises(ConfigError) as error:
        load_spec(serial=str(file))
    assert str(file) in str(error.value)
    assert said in str(error.value)


def test_a_weight_hangs_at_the_fingertip(spec: HandSpec, make_sim: MakeSim) -> None:
    heavy = driven(spec, tip_mass=[0.0, 0.0, 0.0, 0.05] * 4)
    of_models = make_sim(heavy).model, _bare(spec, 1e-3, bristly=False, loose=False, parasitic=False)
    for model in of_models:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        for finger in spec.fingers:
            weight = data.body(f"{finger.name}_weight").xipos
            np.testing.assert_allclose(weight, data.site(finger.tip).xpos, atol=1e-12)
