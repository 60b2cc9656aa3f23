"""Every grasp that ships can be tried in the open: the hand gets to its pre-shape, and on from there."""

from __future__ import annotations

from functools import cache

import pytest

from allegro_twin.app.config import RunConfig
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entry_files import read_shipped_entry, shipped_entries
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.sim.contact.collision_free_paths import CollisionFreePaths
from allegro_twin.sim.contact.interlock import Interlock
from allegro_twin.surfaces.hand import Hand

GRASPS = sorted((read_shipped_entry(name).entry.hand, name) for name in shipped_entries("grasp"))
MENDED = ("leap_pudding_box", "leap_tuna_fish_can", "model_o_apple", "model_o_tomato_soup_can")
"""Their pre-shapes had been found with fingers that pressed against each other, and were refused."""


@cache
def ways_of(hand: str) -> CollisionFreePaths:
    return CollisionFreePaths(load_spec(hand, "right"))


@pytest.mark.parametrize(("hand", "name"), GRASPS)
def test_no_grasp_is_refused_in_the_open(hand: str, name: str) -> None:
    spec = load_spec(hand, "right")
    grasp = load_grasp(name, spec)
    legs = ways_of(hand).legs(spec.rest, grasp.waypoint("preshape"), (spec.lower, spec.upper), name)
    assert (legs[-1].posture == grasp.preshape).all()
    if spec.apart:
        guard, start = Interlock(spec), grasp.preshape
        for goal in (grasp.close, grasp.squeeze):
            guard(start, goal)
            start = goal


@pytest.mark.parametrize("name", MENDED)
def test_a_hand_performs_it_around_nothing(name: str) -> None:
    hand = read_shipped_entry(name).entry.hand
    config = {"hand": {"model": hand}, "backend": {"kind": "sim"}, "controller": {"kind": "position"}}
    with Hand.open(RunConfig.model_validate(config)) as opened:
        assert opened.grasp(name).name == name
