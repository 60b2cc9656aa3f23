"""A world belongs to the devices in it: who is let go of takes no part, and the last one takes the world along."""

from __future__ import annotations

import gc
import weakref
from typing import Any

from allegro_twin.grasping.scenario import load_protocol, load_scenario
from allegro_twin.grasping.trial import Trial
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.sim.engine.world import World
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
