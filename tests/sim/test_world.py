"""A world belongs to the devices in it: who is let go of takes no part, and the last one takes the world along."""

from __future__ import annotations

import gc
import pickle
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import HandFault
from allegro_twin.grasping.scenario import load_protocol, load_scenario
from allegro_twin.grasping.trial import Trial
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.engine.world import World
from allegro_twin.spec import HandSpec
from allegro_twin.spec.drivetrain import Drive
from allegro_twin.types import PositionCommand, TorqueCommand
from tests.conftest import MakeSim

SPEC = load_spec()


class Counted:
    """A member that counts its periods."""

    substeps, every_step = 2, True

    def __init__(self) -> None:
        self.periods = self.laid = 0

    def lay(self) -> None:
        self.laid += 1

    def begin_period(self) -> None:
        self.periods += 1

    def before_step(self, step: int) -> None:
        return


def test_a_trial_that_nobody_holds_leaves_no_memory_behind() -> None:
    """Without a look for circles, which Python takes when it likes: a search makes thousands of trials."""
    scenario, path = load_scenario("lemon")
    gc.collect()
    gc.disable()
    try:
        trial = Trial(
            scenario, SPEC, load_grasp(scenario.grasp, SPEC), folder=path.parent, protocol=load_protocol("table_pick")
        )
        data: weakref.ref[Any] = weakref.ref(trial.backend.world)
        del trial
        assert data() is None
    finally:
        gc.enable()


def test_a_member_that_somebody_holds_is_told_of_every_period_and_one_let_go_of_is_not(make_sim: MakeSim) -> None:
    sim = make_sim(SPEC)
    world: World = sim.world
    kept, gone = Counted(), Counted()
    world.join(kept)
    world.join(gone)
    world.restart()
    assert (kept.laid, gone.laid) == (1, 1)
    del gone
    world.advance(world.steps + 4)
    assert kept.periods == 2
    world.restart()
    assert kept.laid == 2


LATE: dict[str, float] = {
    "delay": 0.005, "encoder_noise": 1e-4, "load_friction": 0.1, "stiction": 1.5, "stribeck_speed": 0.1,
    "bristle": 1e-3, "backlash": 0.01, "cold_friction": 0.3, "warm_up": 1.0, "bias_torque": 0.01,
}  # fmt: skip
"""A drive in which every part has a past."""
HANDS = {
    "torque": SPEC,
    "every part of a drive": replace(SPEC, drive=Drive.from_values(LATE, SPEC.n_joints)),
    "servos": load_spec("leap"),
    "servos that take their time": load_spec("qb_softhand"),
}


def played(sim: SimBackend, periods: int) -> list[bytes]:
    """All that is reported while commands change at random; those of servos take their time where they can."""
    draws, found, n = np.random.default_rng(periods), [], sim.spec.n_joints
    for k in range(periods):
        if "torque" in sim.spec.commands:
            sim.write(TorqueCommand(draws.uniform(-0.3, 0.3, n)))
        elif k % 5 == 2:  # What was commanded before goes on for a while.
            aim = sim.posture + draws.uniform(-0.3, 0.3, n)
            timed = "timed_position" in sim.spec.commands
            effort = draws.uniform(0.1, 0.3, n)
            sim.write(PositionCommand(aim, duration=0.03) if timed else PositionCommand(aim, effort=effort))
        state = sim.read()
        reported = state.position, state.velocity, state.torque
        found.append(pickle.dumps([state.t, state.tick, *map(np.asarray, reported)]))
    return found


def saved(sim: SimBackend) -> Any:
    return pickle.loads(pickle.dumps((sim.world.save(), sim.save())))


def go_on(sim: SimBackend, state: Any) -> None:
    sim.world.restore(state[0])
    sim.restore(state[1])


@pytest.mark.parametrize("spec", HANDS.values(), ids=HANDS.keys())
def test_a_saved_world_goes_on_to_the_bit_in_another_one_that_had_a_past(spec: HandSpec, make_sim: MakeSim) -> None:
    sim, other = make_sim(spec), make_sim(spec)
    for each, before in ((sim, 43), (other, 12)):
        each.reset()
        played(each, before)
    state = saved(sim)
    first = played(sim, 31)
    go_on(other, state)
    assert played(other, 31) == first


def test_a_saved_world_goes_on_in_one_that_has_not_begun_and_that_can_be_begun_anew(make_sim: MakeSim) -> None:
    sim, fresh = make_sim(SPEC), make_sim(SPEC)
    sim.reset()
    beginning = played(sim, 8)
    state = saved(sim)
    first = played(sim, 9)
    go_on(fresh, state)
    assert played(fresh, 9) == first
    fresh.reset()
    assert played(fresh, 8) == beginning


def test_what_went_wrong_before_a_world_was_saved_is_in_its_state(make_sim: MakeSim) -> None:
    sim, whole = make_sim(SPEC), make_sim(replace(SPEC, drive=Drive.from_values({}, SPEC.n_joints)))
    for each in (sim, whole):
        each.reset()
    sim.suffer("weak", 2, 0.3)
    sim.suffer("encoder_drift", 5, 0.02)
    played(sim, 6)
    state = saved(sim)
    first = played(sim, 9)
    go_on(whole, state)
    assert played(whole, 9) == first


def test_a_device_that_was_not_restored_with_its_world_says_so(make_sim: MakeSim) -> None:
    sim = make_sim(SPEC)
    sim.reset()
    sim.world.restore(sim.world.save())
    with pytest.raises(HandFault, match=f"the scene of {SPEC.name} was begun anew by another"):
        sim.read()
