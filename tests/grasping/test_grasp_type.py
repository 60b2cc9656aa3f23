"""The type of a grasp is read from the contacts that carry: all 33 of Feix et al. 2016, and what is none of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from allegro_twin.grasping.batch.batched_trials import run_trials
from allegro_twin.grasping.batch.trials import PERIOD, TrialCase, TrialRunner
from allegro_twin.grasping.grasp_type import GraspObservation, ObjectShape, SurfaceLoad, classify_grasp
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.hands.library.taxonomy import GRASP_TYPES, NONE, ObservedType

FINGERS = ("index", "middle", "ring", "little")
REACH = 0.1
BALL, LARGE_BALL = ObjectShape(0.03, 0.03, 0.03, np.pi / 6), ObjectShape(0.07, 0.07, 0.07, np.pi / 6)
DISK = ObjectShape(0.02, 0.08, 0.08, np.pi / 4)
PLATE = ObjectShape(0.005, 0.05, 0.08, 1.0)
BLOCK = ObjectShape(0.04, 0.05, 0.07, 1.0)
THIN_ROD, ROD, MUG = (
    ObjectShape(0.015, 0.015, 0.15, 0.79),
    ObjectShape(0.04, 0.04, 0.15, 0.79),
    ObjectShape(0.08, 0.08, 0.1, 0.79),
)
UP, DOWN = 70.0, 20.0  # Of the thumb out of the palm's plane, degrees.


def seen(
    shape: ObjectShape,
    thumb: float,
    *where: str,
    straight: bool = False,
    spread: bool = False,
    extra: dict[str, float] | None = None,
) -> GraspObservation:
    """Contacts `part surface` of a human-like hand, each with 1 N or what `extra` says. `spread`: fingers press from
    different sides, as around a ball."""
    rows = []
    for text in where:
        part, _, surface = text.partition(" ")
        across = (FINGERS.index(part) - 1.5) * 0.5 if spread and part in FINGERS else 0.0
        normal = (1.0, 0.0, 0.0) if part == "palm" else (0.0, across, -float(np.sqrt(1 - across**2)))
        rows.append(SurfaceLoad(part, surface or "palm", (extra or {}).get(text, 1.0), normal))
    return GraspObservation(
        rows, FINGERS, shape, "thumb", thumb, dict.fromkeys((*FINGERS, "thumb"), 1.0 if straight else 0.7), REACH
    )


WRAP = ("palm", "index pad", "middle pad", "ring pad", "little pad")
PADS = ("index pad", "middle pad", "ring pad", "little pad")
INNERS = tuple(f"{finger} inner" for finger in FINGERS)
# A row a type: the object, the thumb, what carries. Against figure 4 of the paper and its drawings.
TYPES = {
    1: seen(MUG, UP, *WRAP, "thumb pad"),
    2: seen(THIN_ROD, UP, *WRAP, "thumb pad"),
    3: seen(ROD, UP, *WRAP, "thumb pad"),
    4: seen(ROD, DOWN, *WRAP, "thumb pad"),
    5: seen(THIN_ROD, DOWN, *WRAP, "thumb pad"),
    6: seen(BLOCK, UP, *PADS, "thumb pad"),
    7: seen(BLOCK, UP, *PADS[:3], "thumb pad"),
    8: seen(BLOCK, UP, *PADS[:2], "thumb pad"),
    9: seen(PLATE, UP, "index pad", "thumb pad"),
    10: seen(DISK, UP, *WRAP, "thumb pad"),
    11: seen(LARGE_BALL, UP, *WRAP, "thumb pad"),
    12: seen(DISK, UP, *PADS, "thumb pad", spread=True),
    13: seen(LARGE_BALL, UP, *PADS, "thumb pad", spread=True),
    14: seen(BALL, UP, *PADS[:2], "thumb pad", spread=True),
    15: seen(THIN_ROD, DOWN, *INNERS),
    16: seen(PLATE, DOWN, "thumb pad", "index side"),
    17: seen(ROD, DOWN, "palm", "middle pad", "ring pad", "little pad", "thumb pad", "index pad", straight=True),
    18: seen(PLATE, UP, *INNERS[:3], "thumb pad", straight=True),
    19: seen(BLOCK, UP, *INNERS, "thumb inner"),
    20: seen(THIN_ROD, UP, "thumb pad", "index pad", "middle side"),
    21: seen(THIN_ROD, UP, "thumb pad", "index pad", "middle side", "ring side"),
    22: seen(PLATE, DOWN, *PADS, "thumb pad", straight=True),
    23: seen(THIN_ROD, UP, "index side", "middle side"),
    24: seen(PLATE, UP, "index tip", "thumb tip"),
    25: seen(THIN_ROD, DOWN, "thumb pad", "index pad", "middle side"),
    26: seen(LARGE_BALL, UP, *PADS[:3], *INNERS[:3], "thumb pad", spread=True),
    27: seen(BALL, UP, *PADS[:3], "thumb pad", spread=True),
    28: seen(LARGE_BALL, UP, *PADS[:2], *INNERS[:2], "thumb pad", spread=True),
    29: seen(THIN_ROD, DOWN, "thumb pad", "index side"),
    30: seen(PLATE, DOWN, *WRAP),
    31: seen(ROD, UP, "index pad", "index inner", "thumb pad"),
    32: seen(ROD, DOWN, "thumb pad", "index side", "middle inner", "ring inner", "little inner"),
    33: seen(BALL, UP, "index pad", "thumb pad"),
}
NOT_TYPES = {
    "nothing of the hand carries the object": seen(BALL, UP),
    "index alone carries": seen(BALL, UP, "index pad"),
    "the thumb alone carries": seen(BALL, UP, "thumb pad"),
    "index, middle, ring and little do not carry": seen(MUG, UP, "palm", "thumb pad"),
    "little does not carry": seen(MUG, UP, "palm", "index pad", "middle pad", "ring pad", "thumb pad"),
    "on its back: index": seen(BALL, UP, "index back", "thumb pad"),
    "neither thumb nor palm carries": seen(BALL, UP, "index pad", "ring pad"),
    "the thumb is abducted": seen(PLATE, UP, "thumb pad", "index side"),
    "the side of index and ring with middle": seen(MUG, UP, "thumb pad", "index side", "middle pad", "ring side"),
    "inner links hold what is no ball or disk": seen(BLOCK, UP, "index inner", "middle inner", "thumb pad"),
}


def test_the_table_is_figure_4_of_the_paper() -> None:
    """33 types in 17 cells, 13 of them of one type."""
    assert sorted(GRASP_TYPES) == list(range(1, 34))
    cells: dict[tuple[str, ...], list[int]] = {}
    for kind in GRASP_TYPES.values():
        cells.setdefault((kind.type, kind.opposition, kind.fingers, kind.thumb), []).append(kind.number)
    assert sorted(cells.values()) == [
        [1, 2, 3, 10, 11], [4, 5, 15, 30], [6, 12, 13], [7, 27], [8, 14], [9, 24, 33], [16, 29, 32], [17], [18, 26],
        [19], [20], [21], [22], [23], [25], [28], [31],
    ]  # fmt: skip


@pytest.mark.parametrize("number", TYPES)
def test_each_of_the_33_types_is_told_by_its_contacts(number: int) -> None:
    found = classify_grasp(TYPES[number])
    kind = GRASP_TYPES[number]
    assert (found.number, found.name, found.type, found.opposition) == (number, kind.name, kind.type, kind.opposition)


@pytest.mark.parametrize("why", NOT_TYPES)
def test_what_is_none_of_the_33_says_why(why: str) -> None:
    found = classify_grasp(NOT_TYPES[why])
    assert (found.number, found.name, found.why) == (None, NONE, why)


@pytest.mark.parametrize("number", TYPES)
def test_no_type_is_kept_without_the_fingers_that_it_names(number: int) -> None:
    """Every digit that carries is taken away in turn, then all at once."""
    scene = TYPES[number]
    digits = {row.part for row in scene.bearings} - {"palm", "thumb"}
    assert classify_grasp(replace(scene, bearings=[b for b in scene.bearings if b.part not in digits])).number is None
    counted = {d for d in digits if number not in (17, 32) or d not in ("index",) or number == 32}
    for digit in counted - ({"middle", "ring", "little"} if number == 32 else set()):
        rest = classify_grasp(replace(scene, bearings=[b for b in scene.bearings if b.part != digit]))
        assert rest.number != number, digit


def test_what_bears_less_than_a_twentieth_takes_no_part() -> None:
    light = seen(PLATE, UP, "index tip", "thumb tip", "middle tip", extra={"middle tip": 0.1})
    assert (classify_grasp(light).number, classify_grasp(light).virtual_fingers) == (24, "thumb against index")
    heavy = seen(PLATE, UP, "index tip", "thumb tip", "middle tip", extra={"middle tip": 0.12})
    assert classify_grasp(heavy).number == 8


def test_fingers_of_a_robot_are_counted_not_named() -> None:
    assert classify_grasp(seen(PLATE, UP, "ring tip", "thumb tip")).number == 24
    three = replace(TYPES[1], fingers=FINGERS[:3], bearings=[b for b in TYPES[1].bearings if b.part != "little"])
    assert classify_grasp(three).number == 1  # All that this hand has.
    assert classify_grasp(replace(three, bearings=[b for b in three.bearings if b.part != "ring"])).number is None


def test_digits_without_names_are_opposed_by_the_one_that_all_others_press_against() -> None:
    ways = {"a": (0.0, 0.0, 1.0), "b": (0.0, 0.1, -1.0), "c": (0.0, -0.1, -1.0)}
    rows = [SurfaceLoad(part, "pad", 2.0 if part == "a" else 1.0, way) for part, way in ways.items()]
    found = classify_grasp(GraspObservation(rows, tuple(ways), BLOCK, None))
    assert (found.number, found.virtual_fingers) == (8, "a against b and c")


SPEC = load_spec()


def shown(name: str, ghosts: tuple[str, ...] = (), hand: str | None = None) -> tuple[bool, ObservedType | None]:
    """Whether a scenario's trial held and the type that it showed, with the collisions of some fingers switched off."""
    scenario, path = load_scenario(name)
    spec = load_spec(scenario.hand)
    bench = TrialRunner(spec, period=PERIOD, threads=1)
    trial = bench.trial(TrialCase(scenario, load_grasp(scenario.grasp, spec), folder=path.parent))
    model = trial.backend.model
    for finger in ghosts:
        part = trial._surfaces.parts.index(finger)
        mine = trial._surfaces._part[model.geom_bodyid] == part
        model.geom_contype[mine] = model.geom_conaffinity[mine] = 0
    (verdict,) = run_trials([trial], [bench.controller(trial)], bench.limits, threads=1)
    return verdict.held, None if verdict.report is None else verdict.report.observed


@pytest.mark.slow
@pytest.mark.parametrize("name", ["apple", "foam_brick", "power_sphere"])
def test_a_grasp_whose_fingers_are_ghosts_is_lost_or_of_another_type(name: str) -> None:
    held, found = shown(name)
    assert held
    assert found is not None
    taking_part = [f.name for f in SPEC.fingers if f.name in found.virtual_fingers]
    assert len(taking_part) >= 2
    without, other = shown(name, tuple(taking_part))
    assert not without
    for finger in taking_part:
        without, other = shown(name, (finger,))
        assert (
            not without
            or other is None
            or (other.number, other.virtual_fingers) != (found.number, found.virtual_fingers)
        )


@pytest.mark.slow
def test_the_mug_is_held_between_palm_and_thumb_and_says_so() -> None:
    """It was called Large Diameter, palm against index, middle, ring and thumb."""
    held, found = shown("mug")
    assert held
    assert found is not None
    assert (found.number, found.virtual_fingers) == (None, "palm against thumb")
    assert shown("mug", ("index", "middle", "ring"))[1] == found


@pytest.mark.parametrize(
    "name",
    [
        *(
            pytest.param(n, marks=pytest.mark.slow)
            for n in ("leap_potted_meat_can", "model_o_apple", "sih_lemon", "qb_softhand_tennis_ball")
        ),
    ],
)
def test_other_hands_have_a_type_or_none(name: str) -> None:
    _, found = shown(name)
    assert found is not None
    assert found.virtual_fingers
    assert (found.number is None) == bool(found.why)
