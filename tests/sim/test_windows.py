"""The model that is fitted moves as the simulation does, late commands and friction that breaks away included."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.drivetrain.lugre_friction import followed_deflection, steady_deflection
from allegro_twin.sim.open_loop import BEFORE, HISTORY, DriveParameters, OpenLoopPlayer, Segments
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.types import Array, TorqueCommand
from tests.conftest import MakeSim

K = 100
MIDDLE = (load_spec().lower + load_spec().upper) / 2.0


def duties() -> Array:
    """Changing torques, (K, n), N·m."""
    t = np.arange(K)[:, None] * 0.003
    rng = np.random.default_rng(0)
    phase = 2 * np.pi * rng.uniform(2, 8, 16) * t + rng.uniform(0, 6, 16)
    return np.asarray(0.12 * np.sin(phase))


def simulated(make_sim: MakeSim, spec: HandSpec, duty: Array) -> Array:
    backend = make_sim(spec, posture=MIDDLE)
    backend.reset()
    found = []
    for row in duty:
        backend.write(TorqueCommand(row))
        found.append(backend.read().position)
    return np.array(found)


def parameters(spec: HandSpec, **changed: Any) -> DriveParameters:
    own, one = spec.actuation, np.ones(16)
    values: dict[str, Any] = {
        "torque_constant": one, "armature": own.armature, "damping": own.damping, "frictionloss": own.frictionloss,
        "offset": 0 * one, "delay": 0 * one, "mass_scale": one, "stiction": one, "stribeck_speed": one, "bristle": one,
        "load_friction": 0 * one, "backlash": 0 * one,
    }  # fmt: skip
    return DriveParameters(**values | changed)


def piece(player: OpenLoopPlayer, drive: DriveParameters, duty: Array, gravity: Array) -> Segments:
    """One that begins at rest in the middle, carried by its motors, so that no bristle is bent."""
    player.links_only(drive.mass_scale, np.zeros(16))
    weight = player.link_torque(MIDDLE, np.zeros(16), np.zeros(16), gravity)
    push = np.broadcast_to(weight / drive.torque_constant, (1, BEFORE + 1, 16))
    return Segments(
        duty[None], gravity[None], np.zeros((1, 16)), np.zeros((1, 16)), push, np.zeros(1), np.zeros((1, HISTORY, 16))
    )


def played(spec: HandSpec, drive: DriveParameters, duty: Array, *, bristly: bool = False) -> Array:
    player = OpenLoopPlayer(spec, 0.003, 0.001, bristly=bristly)  # The scene's time step.
    pieces = piece(player, drive, np.concatenate([np.zeros((BEFORE, 16)), duty]), np.array([0.0, 0.0, -9.81]))
    found: Array = player.play(drive, MIDDLE[None] + drive.offset, np.zeros((1, 16)), pieces)[0]
    return found


def test_a_piece_is_the_simulation_to_a_few_encoder_counts(spec: HandSpec, make_sim: MakeSim) -> None:
    np.testing.assert_allclose(played(spec, parameters(spec), duties()), simulated(make_sim, spec, duties()), atol=4e-4)


def test_a_piece_knows_by_the_motion_before_it_how_far_friction_that_gives_far_is_bent(
    spec: HandSpec, make_sim: MakeSim
) -> None:
    shape: dict[str, Any] = {"stiction": 1.1, "stribeck_speed": 0.1, "bristle": 0.012}
    soft = replace(spec, drive=Drive.from_values(shape, 16))
    drive = parameters(spec, **{name: np.full(16, value) for name, value in shape.items()})
    there, duty, first = simulated(make_sim, soft, duties()), duties(), 60
    velocity = np.gradient(there, 0.003, axis=0)
    player = OpenLoopPlayer(spec, 0.003, 0.001, bristly=True)
    began = piece(player, drive, duty[first + 1 - BEFORE :], np.array([0.0, 0.0, -9.81]))
    past = np.concatenate([np.zeros((HISTORY - first, 16)), velocity[:first]])[None]
    off = []
    for came in (past, np.zeros_like(past)):
        played_on = player.play(drive, there[[first]], velocity[[first]], began._replace(past=came))[0]
        off.append(np.abs(played_on - there[first + 1 :]).max(axis=0))
    assert np.median(off[0]) < 1.5e-3
    assert np.median(off[0]) < 0.3 * np.median(off[1])


def test_bristles_follow_the_motion_at_first_and_end_where_steady_motion_bends_them() -> None:
    ratio, speed, bristle = np.array([1.4]), np.array([0.1]), np.array([0.01])
    bent = followed_deflection(ratio, speed, bristle, np.full((3000, 1), 0.05), 0.001)
    np.testing.assert_allclose(bent[1], 2.0 * 0.05 * 0.001, rtol=0.02)  # Way come, so far.
    np.testing.assert_allclose(bent[-1], steady_deflection(ratio, speed, bristle, np.array([0.05])), rtol=0.02)
    np.testing.assert_allclose(bent[:50, 0].max(), 0.05 * 0.05, rtol=0.2)
    level = bent[-1, 0]  # By e of the level that this speed has, not of the bristle's largest.
    np.testing.assert_allclose(bent[round(level / (0.05 * 0.001)) - 1], level * (1.0 - np.exp(-1.0)), rtol=0.01)


def test_half_the_command_at_twice_the_constant_is_the_same(spec: HandSpec) -> None:
    twice = parameters(spec, torque_constant=np.full(16, 2.0))
    np.testing.assert_allclose(played(spec, twice, duties() / 2), played(spec, parameters(spec), duties()), atol=1e-12)


def test_a_delay_of_a_whole_period_is_the_motion_a_period_later(spec: HandSpec, make_sim: MakeSim) -> None:
    late = parameters(spec, delay=np.full(16, 0.004))
    truth = simulated(make_sim, replace(spec, drive=Drive.from_values({"delay": 0.004}, 16)), duties())
    np.testing.assert_allclose(played(spec, late, duties()), truth, atol=4e-4)
    assert np.abs(played(spec, parameters(spec), duties()) - truth).max() > 5e-3


def test_an_offset_is_reported_and_the_weight_acts_at_the_true_place(spec: HandSpec) -> None:
    off = parameters(spec, offset=np.full(16, 0.05))
    np.testing.assert_allclose(played(spec, off, duties()), played(spec, parameters(spec), duties()) + 0.05, atol=1e-9)


def test_friction_that_breaks_away_is_the_same_in_both(spec: HandSpec, make_sim: MakeSim) -> None:
    shape = {"stiction": 1.5, "stribeck_speed": 0.15, "bristle": 1e-3}
    truth = simulated(make_sim, replace(spec, drive=Drive.from_values(shape, 16)), duties())
    drive = parameters(spec, **{name: np.full(16, value) for name, value in shape.items()})
    np.testing.assert_allclose(played(spec, drive, duties(), bristly=True), truth, atol=4e-4)
    assert np.abs(played(spec, parameters(spec), duties()) - truth).max() > 2e-3


def test_friction_that_grows_with_the_motors_torque_is_the_same_in_both(spec: HandSpec, make_sim: MakeSim) -> None:
    shape = {"stiction": 1.3, "stribeck_speed": 0.15, "bristle": 1e-3}
    rows = {name: np.full(16, value) for name, value in shape.items()}
    truth = simulated(make_sim, replace(spec, drive=Drive.from_values(shape | {"load_friction": 0.2}, 16)), duties())
    loaded = parameters(spec, **rows, load_friction=np.full(16, 0.2))
    np.testing.assert_allclose(played(spec, loaded, duties(), bristly=True), truth, atol=6e-4)
    assert np.abs(played(spec, parameters(spec, **rows), duties(), bristly=True) - truth).max() > 2e-3


def test_a_joint_gives_a_little_before_it_breaks_away(spec: HandSpec, make_sim: MakeSim) -> None:
    drive = Drive.from_values({"stiction": 1.5, "stribeck_speed": 0.15, "bristle": 2e-3}, 16)
    own = replace(spec, drive=drive)
    breakaway = 1.5 * spec.actuation.frictionloss[4]  # The middle finger's spread, which gravity does not pull upright.
    travel = []
    for share in (0.8, 1.4):
        duty = np.zeros((K, 16))
        duty[:, 4] = share * breakaway
        travel.append(np.ptp(simulated(make_sim, own, duty)[:, 4]))
    assert travel[0] == pytest.approx(-2e-3 * np.log(1.0 - 0.8), rel=0.25)  # ż = v (1 − z / bristle), slowly.
    assert travel[1] > 0.02


def test_a_joint_that_is_held_begins_where_its_motor_has_bent_its_bristles(spec: HandSpec) -> None:
    """Pushed to 0.9 of what breaks it away it holds still; with other bristles it would first give by 1.8 mrad."""
    shape = {"stiction": 1.5, "stribeck_speed": 0.15, "bristle": 2e-3}
    drive = parameters(spec, **{name: np.full(16, value) for name, value in shape.items()})
    player = OpenLoopPlayer(spec, 0.003, bristly=True)
    push = 0.9 * 1.5 * drive.frictionloss
    resting = piece(player, drive, np.zeros((BEFORE + K, 16)), np.array([0.0, 0.0, -9.81]))
    held = resting._replace(duty=resting.push[:, :1] + push + resting.duty, push=resting.push + push)
    start = MIDDLE[None], np.zeros((1, 16))
    assert np.ptp(player.play(drive, *start, held), axis=1).max() < 2e-4
    assert np.ptp(player.play(drive, *start, held._replace(push=resting.push)), axis=1).max() > 1e-3


@pytest.mark.parametrize("weight", [0.0, 0.05])
def test_a_weight_at_a_tip_pulls(spec: HandSpec, weight: float) -> None:
    player, drive = OpenLoopPlayer(spec, 0.003), parameters(spec)
    pieces = piece(player, drive, np.zeros((BEFORE + K, 16)), np.array([-9.81, 0.0, 0.0]))
    pieces.weight[0, 3] = weight
    start = MIDDLE[None], np.zeros((1, 16))
    moved = player.play(drive, *start, pieces)[0][-1]
    without = player.play(drive, *start, pieces._replace(weight=np.zeros((1, 16))))[0][-1]
    assert (np.abs(moved - without)[1] > 0.01) == (weight > 0)
    np.testing.assert_allclose(moved[4:], without[4:], atol=1e-12)


def test_a_loose_link_is_the_same_in_both(spec: HandSpec, make_sim: MakeSim) -> None:
    play, k, down = 0.005, slice(8, 60), np.array([0.0, 0.0, -9.81])  # The simulation begins between the teeth.
    truth = simulated(make_sim, replace(spec, drive=Drive.from_values({"backlash": play}, 16)), duties())
    drive, player = parameters(spec, backlash=np.full(16, play)), OpenLoopPlayer(spec, 0.003, 0.001, loose=True)
    pieces = piece(OpenLoopPlayer(spec, 0.003), drive, np.concatenate([np.zeros((BEFORE, 16)), duties()]), down)
    lying = -play / 2.0 * np.sign(pieces.push[0, 0])
    found = player.play(drive, (MIDDLE + lying)[None], np.zeros((1, 16)), pieces)[0]
    rigid = played(spec, parameters(spec), duties())
    off, without = (np.sqrt(np.square(each[k] - truth[k]).mean(axis=0)) for each in (found, rigid))
    assert np.median(off) < 4e-4
    assert np.median(without) > 1.5e-3
