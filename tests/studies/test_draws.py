"""Trial i is what it is for every policy, and a prefix of whole blocks is balanced."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from studies.preemption.draws import block, case
from studies.preemption.jobs import sweep_of
from studies.preemption.policies import Seen, begins, due
from studies.preemption.protocol import Policy, load_study
from studies.preemption.scenes import Bench, Job
from tests.studies.small import study


def test_a_block_has_every_object_under_every_error_once() -> None:
    full = load_study("preemption")
    size = block(full, "test")
    cells = Counter((c.object, c.sigma, c.sigma_yaw) for c in (case(full, "test", i) for i in range(size)))
    assert size == 84
    assert set(cells.values()) == {1}
    assert len(cells) == 84
    frictions = Counter(case(full, "test", i).friction for i in range(size))
    assert set(frictions.values()) == {28}


def test_nine_blocks_have_every_cell_of_the_protocol_once() -> None:
    full = load_study("preemption")
    cells = {(c.object, c.sigma, c.sigma_yaw, c.friction, c.approach)
             for c in (case(full, "test", i) for i in range(9 * 84))}  # fmt: skip
    assert len(cells) == 7 * 4 * 3 * 3 * 3


def test_policies_have_the_same_draws_down_to_the_scene() -> None:
    of = study()
    bench = Bench(of, "model_o")
    setups = [bench.setup(Job(policy, case(of, "test", 3))) for policy in of.policies]
    for other in setups[1:]:
        np.testing.assert_array_equal(other.thing, setups[0].thing)
        np.testing.assert_array_equal(other.drive, setups[0].drive)
        np.testing.assert_array_equal(other.model.geom_friction, setups[0].model.geom_friction)
        np.testing.assert_array_equal(other.goal, setups[0].goal)
    moved = bench.setup(Job(of.policies[0], case(of, "test", 1)))
    assert np.abs(moved.thing - bench.setup(Job(of.policies[0], case(of, "test", 0))).thing).max() > 1e-3


def test_sets_numbers_and_streams_are_different_draws() -> None:
    of = study()
    first = case(of, "test", 1)
    other = case(of, "test", 1, of.controls["seeds"])
    assert (other.object, other.sigma, other.friction) == (first.object, first.sigma, first.friction)
    places = {(c.x, c.y) for c in (first, other, case(of, "test", 3), case(of, "train", 1))}
    assert len(places) == 4
    assert case(of, "test", 1) == first
    assert case(of, "test", 1, of.controls["frozen"]) == first
    sure = case(of, "test", 1, of.controls["weightless"])
    assert (sure.x, sure.y, sure.yaw, sure.friction) == (0.0, 0.0, 0.0, 1.0)


def test_errors_are_as_large_as_their_cell_says() -> None:
    full = load_study("preemption")
    drawn = [case(full, "test", i) for i in range(1512)]
    for sigma in full.strata.position:
        x = np.array([c.x for c in drawn if c.sigma == sigma])
        assert float(x.std()) == pytest.approx(sigma, rel=0.12)


def _seen(**changed: object) -> Seen:
    one = np.ones(1)
    still = Seen(0.0, 1.0 * one, np.zeros(1, bool), 0.1 * one, 0.0 * one, 0.0 * one, 0.06 * one, 0.01 * one)
    return still._replace(**changed)  # type: ignore[arg-type]


def test_each_policy_begins_when_it_should() -> None:
    full = load_study("preemption")
    rests = np.ones(1, bool)
    assert not begins(full.policy("P0e"), _seen(t=2.0), 0.8)[0]
    assert begins(full.policy("P0e"), _seen(settled=rests), 0.8)[0]
    assert not begins(full.policy("P50"), _seen(t=0.596), 0.8)[0]
    assert begins(full.policy("P50"), _seen(t=0.6), 0.8)[0]
    assert begins(full.policy("Pc"), _seen(force=np.full(1, 0.1)), 0.8)[0]
    assert not begins(full.policy("Pc"), _seen(force=np.full(1, 0.01)), 0.8)[0]
    # 5 mm + 0.1 of 60 mm + 0.1 s of 0.2 m/s + 10 mm.
    fast = np.full(1, 0.2)
    assert begins(full.policy("Pd"), _seen(speed=fast, remaining=np.full(1, 0.0409)), 0.8)[0]
    assert not begins(full.policy("Pd"), _seen(speed=fast, remaining=np.full(1, 0.0411)), 0.8)[0]


@pytest.mark.parametrize("name", ["P25", "Pd", "Pc"])
def test_a_hand_closes_at_the_latest_when_the_arm_rests(name: str) -> None:
    policy = load_study("preemption").policy(name)
    assert begins(replace_overlap(policy), _seen(settled=np.ones(1, bool)), 0.8)[0]


def replace_overlap(policy: Policy) -> Policy:
    return policy.model_copy(update={"overlap": 0.0})


def test_a_state_machine_looks_ten_times_a_second_from_its_phase_on() -> None:
    looks = [k for k in range(250) if due(10.0, np.array([0.25]), 0.004 * k, 0.004)[0]]
    assert len(looks) == 10
    assert {b - a for a, b in itertools.pairwise(looks)} == {25}
    assert due(None, np.zeros(3), 0.1, 0.004).all()
    other = [k for k in range(250) if due(10.0, np.array([0.75]), 0.004 * k, 0.004)[0]]
    assert looks != other


@pytest.mark.slow
def test_an_unfinished_sweep_has_given_each_hand_the_same() -> None:
    full = load_study("preemption")
    sweep = sweep_of(full, ("allegro", "sih"), 168)
    tests = [item for item in sweep.items if item["set"] == "test" and not item["control"]]
    half = Counter(item["hand"] for item in tests[: 2 * 84 * 8])
    assert half == {"allegro": 84 * 8, "sih": 84 * 8}
    with pytest.raises(ConfigError, match="--pairs 2000: the protocol has 1512 pairs"):
        sweep_of(full, ("sih",), 2000)


def test_a_case_is_plain() -> None:
    drawn = case(study(), "test", 2)
    assert replace(drawn) == drawn
