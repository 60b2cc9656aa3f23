"""A sweep finds the real ends of every joint, hidden stops and shifted encoders included."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.control.controllers import PD, GravityFeedforward
from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.loop import run, until
from allegro_twin.safety import Guard, Limits
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.spec import HandSpec, Side
from allegro_twin.twin.identify.motions.limits import (
    BEYOND,
    TORQUE,
    FoundLimits,
    alike_joints,
    centring_offsets,
    check_both_ends,
    limit_sweep,
    limits_in_samples,
)
from allegro_twin.types import Command, HandState, Sample, TorqueCommand, Vector, frozen
from tests.conftest import MakeSim


class Shifted:
    """A hand whose encoders are off by so much, and that says to be the nominal one; its encoders and motors may have
    another sign, and joints be in another order."""

    def __init__(
        self,
        inner: SimBackend,
        offset: Vector,
        spec: HandSpec,
        encoder: Vector | float = 1.0,
        motor: Vector | float = 1.0,
        order: Sequence[int] = range(16),
    ) -> None:
        self._inner, self._offset, self.spec, self.period = inner, offset, spec, inner.period
        self._encoder, self._motor, self._order = encoder, motor, list(order)

    def reset(self) -> HandState:
        return self._seen(self._inner.reset())

    def read(self) -> HandState:
        return self._seen(self._inner.read())

    def write(self, command: Command) -> None:
        assert isinstance(command, TorqueCommand)
        torque = np.zeros(16)
        torque[self._order] = self._motor * command.torque
        self._inner.write(TorqueCommand(frozen(torque)))

    def close(self) -> None:
        self._inner.close()

    def _seen(self, state: HandState) -> HandState:
        read = {name: frozen(self._encoder * getattr(state, name)[self._order]) for name in ("position", "velocity")}
        return replace(state, position=frozen(read["position"] + self._offset), velocity=read["velocity"])


def sweep(hand: Shifted) -> FoundLimits:
    spec = hand.spec
    rest = load_posture("calibrate", spec)
    wide = Limits(frozen(np.full(16, TORQUE)), frozen(np.full(16, 50.0)), spec.lower - BEYOND, spec.upper + BEYOND)
    moves = limit_sweep(spec, rest)
    controller = PD(moves, load_gains("default", spec), GravityFeedforward(hand_kinematics(spec).gravity_torque))
    return limits_in_samples(until(moves.begin(rest).seconds, run(Guard(hand, wide), controller)), np.full(16, TORQUE))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_hidden_stops_and_offsets_are_found_within_a_hundredth_of_a_radian(
    seed: int, side: Side, make_sim: MakeSim
) -> None:
    spec = load_spec(side=side)
    rng = np.random.default_rng(seed)
    hidden = replace(
        spec,
        lower=frozen(spec.lower + rng.uniform(-0.08, 0.08, 16)),
        upper=frozen(spec.upper + rng.uniform(-0.08, 0.05, 16)),
    )
    offset = frozen(rng.uniform(-0.1, 0.1, 16))
    rest = load_posture("calibrate", spec)
    found = sweep(Shifted(make_sim(hidden, posture=hidden.posture(rest)), offset, spec))
    assert found.ran is not None
    assert not found.ran.any()
    np.testing.assert_allclose(found.lower - offset, hidden.lower, atol=0.01)
    np.testing.assert_allclose(found.upper - offset, hidden.upper, atol=0.01)
    middle_shift = (hidden.lower + hidden.upper - spec.lower - spec.upper) / 2
    np.testing.assert_allclose(centring_offsets(found, spec), offset + middle_shift, atol=0.01)


@pytest.mark.slow
def test_a_sign_that_is_reversed_and_fingers_that_are_swapped_are_named(spec: HandSpec, make_sim: MakeSim) -> None:
    """index_2 has its motor reversed, middle_2 its encoder, ring_2 both."""
    motor, encoder = np.ones(16), np.ones(16)
    motor[[2, 10]], encoder[[6, 10]] = -1.0, -1.0
    posture = spec.posture(load_posture("calibrate", spec))
    with pytest.raises(ConfigError) as told:
        check_both_ends(
            sweep(Shifted(make_sim(spec, posture=posture), frozen(np.zeros(16)), spec, encoder, motor)), spec
        )
    for joint, cause in (
        ("index_2", "it ran against its torque, so the sign of its motor is reversed"),
        ("middle_2", "it ran against its torque, so the sign of its encoder is reversed"),
        ("ring_2", "the sign of its encoder is reversed, and its motor's"),
    ):
        assert re.search(rf"{joint} was seen from [^;]*: {cause}", str(told.value)), str(told.value)
    order = [12, 13, 14, 15, *range(4, 12), 0, 1, 2, 3]
    with pytest.raises(ConfigError, match="index_0 was seen .*: it and thumb_0 are swapped"):
        check_both_ends(sweep(Shifted(make_sim(spec, posture=posture), frozen(np.zeros(16)), spec, order=order)), spec)


def test_the_sweep_leaves_no_joint_out_and_ends_at_rest(spec: HandSpec) -> None:
    rest = load_posture("calibrate", spec)
    path = limit_sweep(spec, rest).begin(rest)
    rows = np.array([path(t).position for t in np.arange(0, path.seconds, 0.01)])
    np.testing.assert_allclose(rows.min(axis=0), spec.lower - BEYOND, atol=0.01)
    np.testing.assert_allclose(rows.max(axis=0), spec.upper + BEYOND, atol=0.01)
    np.testing.assert_array_equal(path(path.seconds).position, rest)


def pressed(spec: HandSpec, speed: float, seconds: float) -> FoundLimits:
    """Of joint 1, which comes at 0.8 rad/s with little torque, and then goes on for so long against much."""
    samples, period, came = [], 0.003, 200
    for k in range(came + round(seconds / period) + 50):
        t, still, position = period * k, np.zeros(16), spec.lower + 0.2
        on = min(max(k - came, 0), round(seconds / period))
        position[1] += min(k, came) * period * 0.8 + on * period * speed
        torque = np.where(np.arange(16) == 1, 0.1 if k < came else 0.25 if on < round(seconds / period) else -0.25, 0.0)
        state = HandState(t, k, frozen(position), frozen(still), frozen(still), frozen(still), frozen(np.zeros(3)))
        samples.append(Sample(state, TorqueCommand(frozen(torque))))
    return limits_in_samples(samples, np.full(16, TORQUE))


@pytest.mark.parametrize(("speed", "seconds"), [(0.025, 0.38), (0.04, 0.3), (0.05, 0.45), (0.3, 0.45), (0.8, 0.3)])
def test_a_joint_that_had_not_come_to_rest_before_it_was_called_back_was_at_no_stop(
    spec: HandSpec, speed: float, seconds: float
) -> None:
    found = pressed(spec, speed, seconds)
    assert found.at_stop is not None
    assert found.creep is not None
    assert not found.at_stop[1, 1]
    assert found.creep[1, 1] == pytest.approx(speed, abs=1e-6)


@pytest.mark.parametrize("seconds", [0.06, 0.1, 0.15, 0.19, 0.45])
def test_a_joint_that_stands_at_its_stop_is_at_rest_however_lately_it_came(spec: HandSpec, seconds: float) -> None:
    """A shifted encoder has the stop near the sweep's end."""
    found = pressed(spec, 0.0, seconds)
    assert found.at_stop is not None
    assert found.creep is not None
    assert found.at_stop[1, 1]
    assert not found.creep.any()


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.29, 0.31])
def test_stops_of_a_smaller_range_are_found_by_encoders_that_are_off_by_all_that_the_sweep_allows(
    offset: float, spec: HandSpec, make_sim: MakeSim
) -> None:
    hidden = replace(spec, lower=frozen(spec.lower + 0.015), upper=frozen(spec.upper - 0.015))
    posture = hidden.posture(load_posture("calibrate", spec))
    found = sweep(Shifted(make_sim(hidden, posture=posture), frozen(np.full(16, offset)), spec))
    check_both_ends(found, spec)
    np.testing.assert_allclose(found.lower - offset, hidden.lower, atol=0.01)
    np.testing.assert_allclose(found.upper - offset, hidden.upper, atol=0.01)


def test_without_samples_there_are_no_limits() -> None:
    with pytest.raises(ConfigError, match="no limits were found"):
        limits_in_samples([])


def test_fingers_of_a_hand_whose_limits_were_measured_still_move_in_parallel() -> None:
    model, noise = load_spec(), np.random.default_rng(0).uniform(-0.003, 0.003, 16)
    own = replace(model, serial="mine", lower=frozen(model.lower + noise), upper=frozen(model.upper + noise))
    assert alike_joints(own) == alike_joints(model)
    assert len(alike_joints(own)) == 8
