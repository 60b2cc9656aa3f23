"""Hands whose motors pull tendons: which joint goes first, what an obstacle changes, and that their cards are true."""

from __future__ import annotations

from itertools import combinations, product

import mujoco
import numpy as np
import pytest

from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.hand_import.explore import explore_hand
from allegro_twin.sim.model.joints import PostureMap
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, PositionCommand
from tests.conftest import MakeSim

CARDS = ("model_o", "qb_softhand", "sih")
OUTER, ALL = ("forward", "reverse"), ("forward", "reverse", "thumb")
"""The Model O's fingers: those that one motor spreads, and all."""


def closed(sim: SimBackend, spec: HandSpec, position: Array, seconds: float = 2.0) -> list[dict[str, float]]:
    """Where all hinges are, every period of an even motion to a position in a time, and of half as long at rest."""
    sim.reset()
    rows, count = [], round(seconds / sim.period)
    for k in range(count + count // 2):
        sim.write(PositionCommand(position * min(k / count, 1.0)))
        sim.read()
        rows.append({each.name: float(sim.data.joint(each.name).qpos[0]) for each in spec.followers})
    return rows


def _of(model: mujoco.MjModel, geom: int) -> str:
    """The finger that a shape is on, "palm" for the palm."""
    body: str = model.body(int(model.geom_bodyid[geom])).name
    return body.split("_")[0]


def hold(sim: SimBackend, joint: str, at: float) -> None:
    """Something in the way of a joint."""
    sim.model.jnt_range[sim.model.joint(joint).id, 1] = at


@pytest.mark.parametrize("name", CARDS)
def test_what_a_card_says_of_followers_is_what_they_do(name: str) -> None:
    spec = load_spec(name)
    found = explore_hand(data_root() / "models" / "mjcf" / f"{name}_right.xml").card
    true = {row["name"]: row["positions"] for row in found["followers"]}
    assert sorted(true) == sorted(each.name for each in spec.followers)
    for each in spec.followers:
        np.testing.assert_allclose(each.positions, true[each.name], atol=0.02, err_msg=each.name)
    assert [row["name"] for row in found["driven"]] == list(spec.joints)
    assert spec.actuation.stiffness is not None
    np.testing.assert_allclose(spec.actuation.stiffness, [row["stiffness"] for row in found["driven"]])


@pytest.mark.parametrize("finger", ["forward", "reverse", "thumb"])
def test_a_finger_of_the_model_o_bends_at_its_base_first(finger: str, make_sim: MakeSim) -> None:
    """At 0.8 of the proximal joint's way the distal one has gone less than 0.15 rad."""
    spec = load_spec("model_o")
    first, second = (f"{finger}_0", f"{finger}_1") if finger == "thumb" else (f"{finger}_1", f"{finger}_2")
    goal = np.zeros(4)
    goal[spec.joints.index(finger)] = 4.4
    rows = closed(make_sim(spec), spec, goal)
    distal_moves = next(k for k, row in enumerate(rows) if row[second] > 0.15)
    assert rows[distal_moves][first] >= 0.8 * 1.95
    assert rows[-1][second] > 1.2


def test_a_finger_of_the_model_o_that_is_held_at_its_base_closes_at_its_end(make_sim: MakeSim) -> None:
    spec = load_spec("model_o")
    sim = make_sim(spec)
    hold(sim, "forward_1", 0.5)
    last = closed(sim, spec, np.array([0.0, 3.0, 0.0, 0.0]))[-1]
    assert last["forward_1"] < 0.55
    assert last["forward_2"] > 1.2


def test_the_model_os_fingers_spread_to_either_side_with_one_motor(make_sim: MakeSim) -> None:
    spec = load_spec("model_o")
    sim = make_sim(spec)
    last = closed(sim, spec, np.array([1.0, 0.0, 0.0, 0.0]))[-1]
    assert last["reverse_0"] == pytest.approx(float(sim.data.joint("spread").qpos[0]), abs=0.02)
    forward, reverse = (sim.data.geom(f"{name}_end").xpos - sim.data.body(name).xpos for name in OUTER)
    across = sim.data.body("forward").xpos - sim.data.body("reverse").xpos
    assert forward @ across > 0.05 * np.linalg.norm(across)  # Each is led to its own side: apart.
    assert reverse @ across < -0.05 * np.linalg.norm(across)


def test_open_fingers_of_the_model_o_never_touch_each_other_however_they_are_spread() -> None:
    spec = load_spec("model_o")
    model = mujoco.MjModel.from_xml_path(str(data_root() / "models/mjcf/model_o_right.xml"))
    data, posed = mujoco.MjData(model), PostureMap(spec, model)
    shapes = {f: [g for g in range(model.ngeom) if model.geom_contype[g] and _of(model, g) == f] for f in ALL}
    for spread in np.linspace(spec.lower[0], spec.upper[0], 40):
        posed(np.array([spread, 0.0, 0.0, 0.0]), data.qpos)
        mujoco.mj_forward(model, data)
        for one, other in combinations(ALL, 2):
            apart = min(
                mujoco.mj_geomDistance(model, data, a, b, 1.0, None) for a, b in product(shapes[one], shapes[other])
            )
            assert apart > 0.02, (spread, one, other)


@pytest.mark.parametrize(("spread", "between"), [(0.0, 1.0), (0.5 * np.pi, -1.0)])
def test_the_model_os_pair_closes_side_by_side_on_the_thumb_or_a_quarter_of_a_turn_on_each_other(
    spread: float, between: float
) -> None:
    """openhand_node: the spread's ends are facing the thumb, and perpendicular to it, for a pinch of the two."""
    spec = load_spec("model_o")
    model = mujoco.MjModel.from_xml_path(str(data_root() / "models/mjcf/model_o_right.xml"))
    data, posed = mujoco.MjData(model), PostureMap(spec, model)
    first = next(each for each in spec.followers if each.name == "forward_1")
    upright = np.interp(0.5 * np.pi, first.positions, np.linspace(0.0, spec.upper[1], len(first.positions)))
    ends = []
    for motor in (upright, upright + 0.01):
        posed(np.array([spread, motor, motor, motor]), data.qpos)
        mujoco.mj_kinematics(model, data)
        ends.append(np.array([data.geom(f"{finger}_end").xpos for finger in ALL]))
    forward, reverse, thumb = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0], axis=1)[:, None]
    assert forward @ reverse == pytest.approx(between, abs=0.02)
    assert forward @ thumb == pytest.approx(-0.5 * (1.0 + between), abs=0.02)
    across = ends[0][1] - ends[0][0]
    assert forward @ across / np.linalg.norm(across) == pytest.approx(0.5 * (1.0 - between), abs=0.02)


def test_a_finger_of_the_softhand_that_is_held_stops_and_the_others_go_on(make_sim: MakeSim) -> None:
    """At least 0.9 of where they would be free: no linkage could do that."""
    spec = load_spec("qb_softhand")
    goal = np.array([0.5])
    free = closed(make_sim(spec), spec, goal)[-1]
    sim = make_sim(spec)
    for place in range(1, 7):
        hold(sim, f"index_{place}", 0.05)
    held = closed(sim, spec, goal)[-1]
    bent = {f: sum(held[f"{f}_{place}"] for place in range(1, 7)) for f in ("index", "middle", "ring", "little")}
    would = {f: sum(free[f"{f}_{place}"] for place in range(1, 7)) for f in bent}
    assert bent["index"] < 0.2 * would["index"]
    for finger in ("middle", "ring", "little"):
        assert bent[finger] >= 0.9 * would[finger]


def test_the_softhands_free_posture_is_the_published_one() -> None:
    """S z: 0.785 a rolling hinge, spreads of 0.2 and 0.4, and 2.542 at the thumb's foot, which stops at 1.571."""
    spec, z = load_spec("qb_softhand"), 0.5
    free = dict(zip([each.name for each in spec.followers], spec.coupled_positions(np.array([z])), strict=True))
    for finger in ("index", "middle", "ring", "little"):
        assert sum(free[f"{finger}_{place}"] for place in range(1, 7)) == pytest.approx(6 * 0.785 * z, rel=0.03)
    assert free["little_0"] == pytest.approx(-0.4 * z, abs=0.01)
    assert free["thumb_0"] == pytest.approx(2.542 * z, abs=0.02)
    assert spec.coupled_positions(np.array([1.0]))[[each.name for each in spec.followers].index("thumb_0")] < 1.58


def test_opening_and_closing_go_different_ways(make_sim: MakeSim) -> None:
    """Dry friction at the hinges: at the same tension a finger that opens is more bent than one that closes."""
    spec = load_spec("model_o")
    sim = make_sim(spec)
    sim.reset()
    bent: dict[str, float] = {}
    for way, goals in (("closing", np.linspace(0.0, 2.0, 60)), ("opening", np.linspace(3.6, 2.0, 60))):
        for goal in goals:
            sim.write(PositionCommand(np.array([0.0, goal, 0.0, 0.0])))
            for _ in range(20):
                sim.read()
        for _ in range(1000):
            state = sim.read()
        bent[way] = float(state.torque[1])
    assert bent["closing"] > bent["opening"] > 0.0


def test_the_softhands_motor_pulls_harder_to_close_than_it_gives_to_open(make_sim: MakeSim) -> None:
    """Its tendon rubs: between the two ways at one place lies twice that, 2 x 0.0127 N·m, and nothing of the spring."""
    spec = load_spec("qb_softhand")
    sim = make_sim(spec)
    sim.reset()
    gives: dict[str, tuple[float, float]] = {}
    for way, goals in (("closing", np.linspace(0.0, 0.4, 200)), ("opening", np.linspace(0.5, 0.4, 100))):
        for goal in goals:
            sim.write(PositionCommand(np.array([goal])))
            state = sim.read()
        for _ in range(300):
            state = sim.read()
        gives[way] = (float(state.position[0]), float(state.torque[0]))
    (low, pulls), (high, lets) = gives["closing"], gives["opening"]
    spring = (pulls + lets) / (low + high)  # N·m: what a whole closure would take.
    assert (pulls - spring * low) - (lets - spring * high) == pytest.approx(2 * 0.0127, rel=0.1)


def test_a_free_softhand_costs_its_engine_no_constraint_at_all(make_sim: MakeSim) -> None:
    """Half of what a step cost before was dry friction, a row a hinge, and what could meet what."""
    spec = load_spec("qb_softhand")
    sim = make_sim(spec)
    sim.reset()
    sim.write(PositionCommand(np.array([0.4])))  # Below it the thumb's weight keeps one of its joints at its stop.
    for _ in range(400):
        sim.read()
    assert sim.data.nefc == 0
    names = [sim.model.geom(g).name for g in range(sim.model.ngeom)]
    meets = {name for g, name in enumerate(names) if name and sim.model.geom_contype[g]}
    assert {"index_6", "index_end", "thumb_4", "palm_0"} <= meets
    assert "index_1" not in meets


def test_links_that_meet_nothing_are_covered_by_the_ends_of_their_neighbours() -> None:
    chains = read_yaml(data_root() / "models/tendons/qb_softhand.yaml")["chains"]
    hidden = [
        (chain[at - 1], row, chain[at + 1])
        for chain in chains.values()
        for at, row in enumerate(chain)
        if "hides" in row
    ]
    assert len(hidden) == 5
    for before, row, after in hidden:
        assert before["thick"] + after["thick"] > row["long"]


def test_the_softhands_thumb_meets_its_fingers_and_these_pass_each_other() -> None:
    model = mujoco.MjModel.from_xml_path(str(data_root() / "models/mjcf/qb_softhand_right.xml"))

    def meet(one: str, other: str) -> bool:
        a, b = model.geom(one).id, model.geom(other).id
        kinds, likes = model.geom_contype, model.geom_conaffinity
        return bool(kinds[a] & likes[b] or kinds[b] & likes[a])

    assert meet("thumb_4", "index_6")
    assert meet("index_6", "palm_0")
    assert not meet("index_6", "middle_6")


def test_a_timed_command_takes_its_time(make_sim: MakeSim) -> None:
    spec = load_spec("qb_softhand")
    sim = make_sim(spec)
    ways = {}
    for seconds in (None, 1.5):
        sim.reset()
        sim.write(PositionCommand(np.array([0.6]), duration=seconds))
        rows = [sim.read().position[0] for _ in range(700)]
        ways[seconds] = next(k for k, row in enumerate(rows) if row > 0.5) * sim.period
    assert ways[1.5] == pytest.approx(1.25, abs=0.15)
    assert ways[None] < 0.5


def test_a_stop_is_a_timed_command_to_where_the_hand_is(make_sim: MakeSim) -> None:
    spec = load_spec("qb_softhand")
    sim = make_sim(spec)
    sim.reset()
    sim.write(PositionCommand(np.array([0.9]), duration=3.0))
    for _ in range(300):
        state = sim.read()
    sim.write(PositionCommand(state.position, duration=0.0))
    for _ in range(300):
        after = sim.read()
    assert after.position[0] == pytest.approx(state.position[0], abs=0.05)
