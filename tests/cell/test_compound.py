"""What touches is one body or several: a picture tells which is likelier, a lift tells which it is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import manifold3d
import mujoco
import numpy as np
import pytest

from allegro_twin.cell.actions.cell_pictures import without_tray
from allegro_twin.cell.checks.camera_check import lifted_part
from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.perception.touching import (
    background_share,
    forms_one_body,
    make_compound,
    see_through_share,
)
from allegro_twin.cell.planning.adaptation import AdaptationSearch, GraspAdapter, compound_object, detected_scenario
from allegro_twin.cell.planning.object_selection import ObjectSelector, SelectedObject
from allegro_twin.cell.planning.stored_grasps import (
    extent_mismatch,
    own_parts,
    stored_grasps,
    table_object,
    yaw_rotation,
)
from allegro_twin.cell.run import perform
from allegro_twin.cell.settings import GraspPlanningSettings, TraySettings
from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.grasping.plan.proposals.propose import Proposer
from allegro_twin.grasping.scenario import load_protocol
from allegro_twin.grasping.timeline import make_stage, place_object
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.contact.grasp_scene import GraspScene
from tests.cell.test_clearing import looked
from tests.cell.test_run import cell_of
from tests.sim.dirty_meshes import obj

LONG, SHORT, THICK, HIGH = 0.11, 0.07, 0.035, 0.06
"""m, of an L: two legs, their width, and its height."""
TURNED = 0.4


LEG_AND_FOOT = [
    {"name": "leg", "shape": "box", "size": [LONG, THICK, HIGH], "mass": 0.12, "at": [0.02, -0.0175]},
    {"name": "foot", "shape": "box", "size": [THICK, 0.05, HIGH], "mass": 0.08, "at": [-0.0175, 0.026]},
]
"""Two boxes that look like an L."""


def box(x: float, y: float, edges: tuple[float, float, float], turn: float = TURNED) -> Solid:
    """A box on the table, its middle at a place of a frame turned by `turn`, rad."""
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Solid("box", axes @ np.array([x, y, edges[2] / 2.0]), axes, edges, 0.001)


def bowl(path: Path) -> Path:
    """137 mm wide, 55 mm high, its wall 4 mm."""
    angles = np.linspace(0.0, np.pi / 2.0, 24)
    outside = [(0.0685 * np.sin(a), 0.055 * (1.0 - np.cos(a))) for a in angles]
    inside = [(0.0645 * np.sin(a), 0.055 - 0.051 * np.cos(a)) for a in angles[::-1]]
    made = manifold3d.Manifold.revolve(manifold3d.CrossSection([outside + inside]), 48).to_mesh()
    return obj(path, np.asarray(made.vert_properties)[:, :3], np.asarray(made.tri_verts).tolist())


@pytest.mark.slow
def test_a_solid_through_which_the_camera_sees_the_table_is_not_there(tmp_path: Path) -> None:
    """Of all solids an egg of 300 mm fits best to the inside of a bowl."""
    thing = {"name": "bowl", "shape": "mesh", "file": bowl(tmp_path / "bowl.obj"), "mass": 0.2, "at": [0.0, 0.03]}
    (found,) = looked(cell_of(objects=[thing]))[2]
    assert isinstance(found, PerceptionRefusal), found
    assert found.reason == "unclear"
    assert "is no ball, egg, cylinder or box: the camera sees the table through the best, of" in str(found)


def test_what_is_in_a_hollow_of_a_solid_is_not_seen_behind_it() -> None:
    """The inside of a mug of 80 mm, and the table beyond it; a mug of 200 mm hides more."""
    eye = np.array([-0.4, 0.0, 0.4])
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-0.02, 0.02, 20), np.linspace(-0.02, 0.02, 20)))
    floor, table = np.stack([x, y, np.full(400, 0.01)], 1), np.stack([x + 0.2, y, np.zeros(400)], 1)
    seen = np.vstack([floor, table])
    for height, share in ((0.08, 0.0), (0.2, 1.0)):
        mug = Solid("cylinder", np.array([0.0, 0.0, height / 2.0]), np.eye(3), (height, 0.08, 0.08), 0.001)
        assert see_through_share(mug, seen, eye, 0.006) > 0.8
        assert background_share(mug, seen, eye, 0.006) == pytest.approx(share, abs=0.05)


LEG = box(0.0, -(SHORT - THICK) / 2.0, (LONG, THICK, HIGH))
FOOT = box(-(LONG - THICK) / 2.0, THICK / 2.0, (THICK, SHORT - THICK, HIGH))
"""An L, its middle in the middle of the frame."""


def angle_iron(folder: Path, yaw: float = 40.0) -> dict[str, Any]:
    """An L of 1000 kg/m³ as an object of a cell."""
    legs = [(LONG, THICK, 0.0, -(SHORT - THICK) / 2.0), (THICK, SHORT - THICK, -(LONG - THICK) / 2.0, THICK / 2.0)]
    geoms = "".join(
        f'<geom type="box" size="{length / 2} {width / 2} {HIGH / 2}" pos="{x} {y} 0"/>' for length, width, x, y in legs
    )
    path = folder / "angle.xml"
    path.write_text(f'<mujoco><worldbody><body name="angle">{geoms}</body></worldbody></mujoco>')
    return {"name": "angle", "shape": "mjcf", "file": path, "at": [0.02, 0.0, HIGH / 2 + 1e-4], "yaw": yaw}


def test_boxes_that_are_level_and_parallel_and_meet_along_a_face_are_one_body() -> None:
    assert forms_one_body([LEG, FOOT])
    low = box(-(LONG - THICK) / 2.0, THICK / 2.0, (THICK, SHORT - THICK, HIGH - 0.01))
    askew = box(-(LONG - THICK) / 2.0, THICK / 2.0, (THICK, SHORT - THICK, HIGH), TURNED + 0.2)
    at_a_corner = box(-LONG / 2.0 - 0.01, THICK / 2.0 + 0.001, (THICK, SHORT - THICK, HIGH))
    away = box(-(LONG - THICK) / 2.0, THICK / 2.0 + 0.01, (THICK, SHORT - THICK, HIGH))
    ball = Solid("sphere", FOOT.position, np.eye(3), (HIGH, HIGH, HIGH), 0.001)
    for other in (low, askew, at_a_corner, away, ball):
        assert not forms_one_body([LEG, other])
    head = box((LONG - THICK) / 2.0, THICK / 2.0, (THICK, SHORT - THICK, HIGH))
    assert forms_one_body([FOOT, head, LEG])  # A U, whichever comes first.
    assert not forms_one_body([FOOT, head])


def test_a_compound_lies_in_the_box_around_its_parts() -> None:
    found = make_compound([LEG, FOOT])
    assert found.parts == (LEG, FOOT)
    np.testing.assert_allclose(found.size, (LONG, SHORT, HIGH))
    np.testing.assert_allclose(found.position, [0.0, 0.0, HIGH / 2.0], atol=1e-12)
    np.testing.assert_allclose(found.axes.T @ found.axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(found.axes) == pytest.approx(1.0)
    tall = make_compound([box(0.0, 0.0, (0.03, 0.02, 0.1)), box(0.025, 0.0, (0.02, 0.02, 0.1))])
    assert tall.size == pytest.approx((0.1, 0.05, 0.02))
    assert abs(tall.axes[2, 0]) == pytest.approx(1.0)
    for edges in ((0.1, 0.05, 0.07), (0.05, 0.1, 0.07), (0.05, 0.07, 0.1), (0.07, 0.05, 0.1)):
        assert np.linalg.det(make_compound([box(0.0, 0.0, edges)]).axes) == pytest.approx(1.0)


def test_a_body_with_a_notch_is_seen_as_a_compound_and_as_its_parts_besides(tmp_path: Path) -> None:
    cell = cell_of(objects=[angle_iron(tmp_path)])
    (found,) = looked(cell)[2]
    cell.close()
    assert isinstance(found, Detection)
    assert found.solid.shape == "compound"
    np.testing.assert_allclose(found.solid.size, (LONG, SHORT, HIGH), atol=0.004)
    np.testing.assert_allclose(found.solid.position, [0.02, 0.0, HIGH / 2.0], atol=0.003)
    assert [one.solid for one in found.instead] == list(found.solid.parts)
    assert sum(len(one.points) for one in found.instead) == len(found.points)


def test_things_that_touch_are_seen_apart_and_as_one_body_besides() -> None:
    objects = [{"name": "foam_brick", "at": [0.0, 0.0]}, {"name": "rubiks_cube", "at": [0.067, 0.01]}]
    cell = cell_of(objects=objects, tray=TraySettings().model_dump())
    selector, (_, _, seen) = ObjectSelector(cell), looked(cell)
    assert len(seen) == 2
    assert all(isinstance(one, Detection) and len(one.instead) == 1 for one in seen)
    readings = selector._readings(seen)
    shapes = [(one.detection.solid.shape, len(one.beside)) for one in readings]  # type: ignore[union-attr]
    assert shapes == [("box", 1), ("box", 1), ("compound", 0)]
    cell.close()


def test_a_compound_is_read_as_several_things_after_it_is_read_as_one(tmp_path: Path) -> None:
    cell = cell_of(objects=[angle_iron(tmp_path)])
    selector, (_, _, seen) = ObjectSelector(cell), looked(cell)
    cell.close()
    readings = [each for each in selector._readings(seen) if not isinstance(each, PerceptionRefusal)]
    assert [each.detection.solid.shape for each in readings] == ["compound", "box", "box"]
    assert [len(each.beside) for each in readings] == [0, 1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("lifted", ["nothing", "leg", "foot"])
def test_the_part_of_a_compound_that_is_gone_alone_was_an_object_of_its_own(lifted: str) -> None:
    cell = cell_of(objects=LEG_AND_FOOT, tray=TraySettings().model_dump())
    (before,) = looked(cell)[2]
    assert isinstance(before, Detection)
    assert before.solid.shape == "compound"
    if lifted != "nothing":
        place = int(cell.robot.world.model.joint(lifted).qposadr[0])
        cell.robot.world.data.qpos[place + 1] += 2.0
        mujoco.mj_forward(cell.robot.world.model, cell.robot.world.data)
    frame = cell.camera.capture(cell.robot.world.data)
    cloud = without_tray(frame.cloud, frame, cell)
    same = (cell.security, cell.security)
    part = lifted_part(frame, cloud, before, np.empty((0, 3)), same, 0.15, cell.settings.perception)
    cell.close()
    assert (part is not None) == (lifted != "nothing")
    if part is not None:
        at = {"leg": (0.02, -0.0175), "foot": (-0.0175, 0.026)}[lifted]
        assert np.linalg.norm(part.found.solid.position[:2] - at) < 0.025
        assert part.sight.gone


def test_a_compound_in_physics_is_one_body_with_the_mass_and_the_middle_of_the_union(tmp_path: Path) -> None:
    spec, body = load_spec("allegro"), table_object(make_compound([LEG, FOOT]))
    scenario = detected_scenario(body, spec, 500.0, tmp_path)
    bench = GraspScene(spec, make_stage(scenario, load_protocol("lift"), "right", tmp_path))
    volumes = np.array([LONG * THICK, THICK * (SHORT - THICK)]) * HIGH
    assert bench.mass == pytest.approx(500.0 * volumes.sum(), rel=1e-6)
    bench.place(np.array([0.0, 0.0, 1.0]), np.eye(3), spec.rest)
    middles = np.array([part.position for part in own_parts(body)])
    np.testing.assert_allclose(bench.centre - bench.placed.position, volumes @ middles / volumes.sum(), atol=1e-6)
    geoms = bench.model.geom_bodyid == bench.body
    assert geoms.sum() == 2
    assert (bench.model.geom_friction[geoms, 0] == 0.8).all()
    larger = compound_object(body, "seen", 500.0, tmp_path, 1.1, 2.0)
    model = mujoco.MjModel.from_xml_path(str(larger.file))
    assert model.body_mass[1] == pytest.approx(2.0 * 500.0 * volumes.sum(), rel=1e-5)
    lowest = (model.geom_pos[:, 2] - model.geom_size[:, 2]).min()
    assert lowest == pytest.approx(-HIGH / 2.0, abs=1e-6)  # It grows upwards from the table.
    assert place_object(larger).position[2] == pytest.approx(HIGH / 2.0 + 1e-4)


def test_compounds_are_alike_only_with_their_parts_in_the_same_places() -> None:
    one = table_object(make_compound([LEG, FOOT]))
    other_end = box((LONG - THICK) / 2.0, THICK / 2.0, (THICK, SHORT - THICK, HIGH))
    assert extent_mismatch(one, one) == 0.0
    assert extent_mismatch(one, table_object(make_compound([LEG, other_end]))) == np.inf
    assert extent_mismatch(one, table_object(box(0.0, 0.0, (LONG, SHORT, HIGH)))) == np.inf
    leg = box(0.1, 0.1 - (SHORT - THICK) / 2.0, (LONG, THICK, HIGH), 1.0)
    foot = box(0.1 - (LONG - THICK) / 2.0, 0.1 + THICK / 2.0, (THICK, SHORT - THICK, HIGH), 1.0)
    moved = make_compound([leg, foot])
    assert extent_mismatch(one, table_object(moved)) < 1e-9


def test_grasps_of_a_compound_are_sought_on_each_of_its_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    adapter = GraspAdapter(load_spec("allegro"), GraspPlanningSettings(rounds=1, closed=2))
    body = table_object(make_compound([LEG, FOOT]))
    search = AdaptationSearch(adapter, body, (), 700.0, tmp_path)
    sought = list[Candidate]()

    def near(_: Proposer, seeds: Sequence[Candidate], *__: object) -> list[Candidate]:
        sought.extend(seeds)
        return []

    monkeypatch.setattr(Proposer, "near", near)
    monkeypatch.setattr(Proposer, "grow", near)
    search.round(lambda card: False)
    cards = {card.name: card for card in stored_grasps("allegro")}
    for target in own_parts(body):
        own = np.array(target.extents) / 2.0
        for turn in (0.0, np.pi):  # A box is as it was.
            back = yaw_rotation(-target.yaw - turn)
            found = 0
            for seed in sought:
                stored = cards[seed.template]
                at, far = stored.palm.position, np.array(stored.body.extents) / 2.0
                wanted = at + np.sign(at) * (own - far) * np.minimum(np.abs(at) / far, 1.0)
                found += np.allclose(back @ (seed.position - search._bench.placed.position - target.position), wanted)
            assert found >= 6


def test_both_parts_of_a_compound_are_in_the_way_and_what_is_taken_away_is_not() -> None:
    cell = cell_of()
    palm = cell.robot.palm(cell.robot.arm.reset()).position
    here = Solid("box", palm - np.array([0.0, 0.0, 0.12]), np.eye(3), (0.1, 0.1, 0.1), 0.0)
    far = Solid("box", palm + np.array([0.0, 0.9, -0.12]), np.eye(3), (0.1, 0.1, 0.1), 0.0)
    for parts in ((here, far), (far, here)):
        body = table_object(make_compound(parts))
        cell.clearance.see(body)
        assert cell.clearance._near(cell.posture, cell.open)
        cell.clearance.see(table_object(far))
        assert not cell.clearance._near(cell.posture, cell.open)
    cell.clearance.clear_table()
    cell.clearance.set_obstacles([table_object(make_compound((far, here)))])
    assert any(pair[1] == "another object" for pair in cell.clearance._near(cell.posture, cell.open))
    cell.close()


@pytest.mark.slow
def test_a_body_with_a_notch_is_held_as_a_whole(tmp_path: Path) -> None:
    cell = cell_of(objects=[angle_iron(tmp_path)])
    report = perform(cell)
    cell.close()
    assert (str(report.end), report.is_lifted) == ("held", True)
    assert report.solid is not None
    assert report.solid.shape == "compound"


@pytest.mark.slow
def test_boxes_side_by_side_that_look_like_one_body_are_cleared_one_after_the_other() -> None:
    """What the first lift tells."""
    cell = cell_of(
        tray=TraySettings().model_dump(),
        objects=LEG_AND_FOOT,
    )
    report = perform(cell)
    cell.close()
    assert set(report.in_tray) == {"leg", "foot"}, (str(report.end), report.end.sentence)
    assert str(report.end) == "cleared"


@pytest.mark.slow
def test_a_part_of_a_selected_compound_is_none_of_the_others(tmp_path: Path) -> None:
    cell = cell_of(objects=[angle_iron(tmp_path)])
    selector, (frame, alone, seen) = ObjectSelector(cell), looked(cell)
    chosen = selector.first(seen, frame, alone)
    cell.close()
    assert isinstance(chosen, SelectedObject)
    assert chosen.found.solid.shape == "compound"
    assert chosen.others == ()
