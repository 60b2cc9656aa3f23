"""Two fingers that hook into each other: a command that would lead there is refused before it is sent."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import guarded
from allegro_twin.backend import position_of
from allegro_twin.errors import CommandError, ConfigError
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.safety import Guard
from allegro_twin.sim.contact.interlock import Interlock
from allegro_twin.sim.contact.self_clearance import SelfClearance
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.types import Array, PositionCommand, Vector
from tests.conftest import MakeSim
from tests.hands.models import made

SPEC = load_spec("sih")
OPEN = SPEC.lower
FIST = np.array([2.0, 2.4, 2.4, 2.4, 1.4])
"""Thumb before the palm, and the fingers through it."""
PINCH = np.array([0.9, 1.2, 1.2, 1.2, 1.4])
LATE = 0.1
"""rad: so far a motor is behind a command that moves."""


@pytest.fixture
def sim(make_sim: MakeSim) -> SimBackend:
    return make_sim(SPEC)


@pytest.fixture
def guard(sim: SimBackend) -> Iterator[Guard]:
    config = RunConfig.model_validate(
        {"hand": {"model": "sih"}, "backend": {"kind": "sim"}, "controller": {"kind": "position"}}
    )
    made = guarded(config, SPEC, sim)
    yield made
    made.close()


def gone(guard: Guard, goal: Array, periods: int = 300) -> Vector:
    """In a straight line from where the hand is; where it is then."""
    origin = guard.read().position
    for k in range(periods):
        guard.write(PositionCommand(origin + (k + 1) / periods * (goal - origin)))
        position = guard.read().position
    return position


def test_a_command_into_each_other_is_refused_in_one_line_and_the_hand_is_limp(guard: Guard, sim: SimBackend) -> None:
    guard.reset()
    with pytest.raises(CommandError, match="index and thumb of sih_right would be .* mm inside each other") as caught:
        guard.write(PositionCommand(FIST))
    assert "\n" not in str(caught.value)
    for _ in range(5):
        state = sim.read()
    np.testing.assert_array_equal(state.torque, 0.0)
    with pytest.raises(CommandError):
        guard.write(PositionCommand(OPEN))
    guard.reset()
    np.testing.assert_allclose(gone(guard, PINCH), PINCH, atol=LATE)


def test_a_hand_that_closes_step_by_step_is_stopped_before_its_fingers_are_in_each_other(guard: Guard) -> None:
    state, clearance = guard.reset(), SelfClearance(SPEC, SPEC.apart)
    with pytest.raises(CommandError):
        for share in np.linspace(0.0, 1.0, 400):
            guard.write(PositionCommand(OPEN + share * (FIST - OPEN)))
            state = guard.read()
    assert 0.1 < state.position[1] < 2.0
    assert clearance(state.position[None]).min() > -0.0005


def test_thumb_and_finger_may_cross_one_after_the_other_where_there_is_room(guard: Guard) -> None:
    """The same place, by another way: the fingers close first, with the thumb beside them."""
    guard.reset()
    beside = np.array([0.2, 2.4, 2.4, 2.4, 0.0])
    np.testing.assert_allclose(gone(guard, beside, 400), beside, atol=LATE)


def test_the_way_is_looked_at_and_not_its_end_alone() -> None:
    """Both ends are clear, and between them the thumb would go through the index finger."""
    lock, clearance, rng = Interlock(SPEC), SelfClearance(SPEC, SPEC.apart), np.random.default_rng(3)
    postures = rng.uniform(SPEC.lower, SPEC.upper, (300, 5))
    clear = postures[clearance(postures).min(axis=1) > 0.001]
    blocked = 0
    for one, other in pairwise(clear):
        way = clearance(np.linspace(one, other, 60)).min()
        try:
            lock(one, other)
        except CommandError:
            blocked += 1
            assert way < 0.0
        else:
            assert way > -0.004  # What the steps of a tenth of a radian can miss.
    assert 0.03 < blocked / len(clear) < 0.9


def test_fingers_that_are_in_each_other_can_be_taken_apart() -> None:
    lock, clearance = Interlock(SPEC), SelfClearance(SPEC, SPEC.apart)
    way = np.linspace(OPEN, FIST, 500)
    inside = way[next(k for k, row in enumerate(clearance(way)) if row.min() < -0.003)]
    lock(inside, OPEN)
    lock(inside, inside)
    with pytest.raises(CommandError):
        lock(inside, FIST)


def test_only_hands_whose_card_names_such_fingers_are_looked_at() -> None:
    assert SPEC.apart == (("thumb", "index"), ("thumb", "middle"))
    for name in ("leap", "model_o", "qb_softhand", "allegro"):
        assert not load_spec(name).apart
    three = SelfClearance(SPEC, SPEC.apart)
    assert {frozenset(pair) for pair in three.pairs} == {frozenset(pair) for pair in SPEC.apart}
    every = SelfClearance(SPEC)
    columns = [k for k, pair in enumerate(every.pairs) if frozenset(pair) in {frozenset(p) for p in SPEC.apart}]
    postures = np.random.default_rng(1).uniform(SPEC.lower, SPEC.upper, (20, 5))
    np.testing.assert_array_equal(np.sort(three(postures), axis=1), np.sort(every(postures)[:, columns], axis=1))


def test_through_the_wire_it_is_refused_before_a_byte_is_sent() -> None:
    content = {"hand": {"model": "sih"}, "backend": {"kind": "schunk", "port": "virtual"}, "period": 0.02,
               "controller": {"kind": "position"}}  # fmt: skip
    rig = assemble(RunConfig.model_validate(content))
    driver: Any = rig.driver
    rig.backend.reset()
    said: list[bytes] = []
    driver._opened.send = said.append  # Nothing goes out.
    with pytest.raises(CommandError, match="hook into each other"):
        rig.backend.write(PositionCommand(FIST))
    assert said == []
    with pytest.raises(CommandError):
        rig.backend.read()
    rig.backend.close()


def test_a_card_that_names_a_finger_that_is_not_there_says_so(tmp_path: Path) -> None:
    card = made("soft", tmp_path)
    card.write_text(card.read_text() + "apart: [[first, thumb]]\n")
    with pytest.raises(ConfigError, match="apart: 'thumb' is none of the fingers: first, second"):
        load_spec(str(card))


def test_a_guard_without_such_a_look_lets_it_through(sim: SimBackend, guard: Guard) -> None:
    bare = Guard(sim, guard._limits)
    bare.reset()
    for goal in (FIST, OPEN):
        bare.write(PositionCommand(goal))
        np.testing.assert_array_equal(position_of(bare.applied, SPEC).position, goal)
