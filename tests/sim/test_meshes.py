"""A user's mesh collides as what it is, weighs what it weighs, and says what is wrong with it."""

from __future__ import annotations

import signal
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from allegro_twin.app import assemble
from allegro_twin.errors import ConfigError
from allegro_twin.grasping.scenario import load_protocol
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.grasping.uncertainty import Perturbation
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.model.parts import body_parts
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.objects.catalogue import GraspObject, PlacedObject, add_object
from allegro_twin.sim.objects.convex_decomposition import CUT, MOST, _interruptible, convex_parts, surface_excess
from allegro_twin.sim.objects.meshes import TRIANGLES, Mesh, convex_hull, load_mesh, mesh_middle
from allegro_twin.surfaces.cli.start.jobs import RunOptions as Options
from allegro_twin.surfaces.cli.start.jobs import configs_of
from allegro_twin.types import Array
from tests.sim.test_scene import scenario

INNER, OUTER, HALF = 0.023, 0.043, 0.010
"""m: a ring with a hole of 46 mm."""


def ring(corners: int = 4) -> tuple[Array, list[tuple[int, int, int]]]:
    """A flat ring; the inscribed circles of its two polygons are INNER and OUTER."""
    n, turn = corners, np.linspace(0.0, 2 * np.pi, corners, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1) / np.cos(np.pi / n)
    low, high = np.full((n, 1), -HALF), np.full((n, 1), HALF)
    rows = [np.hstack([r * circle, z]) for r in (OUTER, INNER) for z in (low, high)]
    faces = []
    for k in range(n):
        m = (k + 1) % n
        faces += [
            (k, m, n + m),
            (k, n + m, n + k),
            (2 * n + m, 2 * n + k, 3 * n + k),
            (2 * n + m, 3 * n + k, 3 * n + m),
        ]
        faces += [
            (n + k, n + m, 3 * n + m),
            (n + k, 3 * n + m, 3 * n + k),
            (m, k, 2 * n + k),
            (m, 2 * n + k, 2 * n + m),
        ]
    return np.vstack(rows), faces


def written(path: Path, vertices: Array, faces: list[tuple[int, int, int]], unit: float = 1.0) -> Path:
    lines = [f"v {x / unit!r} {y / unit!r} {z / unit!r}" for x, y, z in vertices.tolist()]
    path.write_text("\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces)]))
    return path


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.slow
def test_a_ball_falls_through_the_hole_of_a_ring_untouched(tmp_path: Path) -> None:
    file = written(tmp_path / "ring.obj", *ring(), unit=0.001)
    spec = mujoco.MjSpec()
    add_object(
        spec,
        PlacedObject(GraspObject("ring", "mesh", (), 0.1, file, 0.001), (0, 0, 0), (1, 0, 0, 0)),
        (0.8, 0.01, 0.0005),
    )
    spec.delete(spec.joint("ring"))
    ball = spec.worldbody.add_body(name="ball", pos=[0.0, 0.0, 0.05])
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], mass=0.01)
    model = spec.compile()
    data = mujoco.MjData(model)
    touched = 0
    for _ in range(200):
        mujoco.mj_step(model, data)
        touched += data.ncon
    assert data.body("ball").xpos[2] < -0.05
    assert touched == 0


@pytest.mark.slow
def test_a_ring_stands_on_few_points_of_the_table_around_a_ball_that_it_does_not_touch(tmp_path: Path) -> None:
    file = written(tmp_path / "ring.obj", *ring(9))
    ring_ = PlacedObject(GraspObject("ring", "mesh", (), 0.1, file), (0, 0, HALF), (1, 0, 0, 0))
    ball = PlacedObject(GraspObject("ball", "sphere", (0.03,), 0.01), (0, 0, 0.015), (1, 0, 0, 0))
    far = Stage(np.array([0.0, 0.0, 0.5]), np.array([1.0, 0.0, 0.0, 0.0]), (ring_, ball), table=True)
    model = compile_scene(load_spec(), far)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    height = data.body("ring").xpos[2]
    assert HALF - 2e-4 < height < HALF + 1e-4
    met = sorted({tuple(sorted(model.body(model.geom_bodyid[g]).name for g in pair)) for pair in data.contact.geom})
    assert met == [("ball", "world"), ("ring", "world")]
    assert data.ncon <= 5
    mujoco.mj_step(model, data, 100)
    assert data.body("ring").xpos[2] == pytest.approx(height, abs=1e-9)
    # Fingers and balls still touch the pieces, and never the hull that stands.
    type_, with_, part = model.geom_contype, model.geom_conaffinity, body_parts(model, load_spec())[model.geom_bodyid]
    meet = (type_[:, None] & with_) | (type_ & with_[:, None])
    standing, piece, table = (model.geom(name).id for name in ("ring/standing", "ring/0", "table"))
    assert np.flatnonzero(meet[standing]).tolist() == [table]
    solid = np.flatnonzero((part >= 0) & (type_ > 0))
    assert meet[piece, solid].all()
    assert meet[table, solid].all()
    assert meet[piece, model.geom("ball").id]
    assert not meet[piece, table]


@pytest.mark.slow
def test_it_has_the_inertia_of_the_solid_and_not_of_its_hull(tmp_path: Path) -> None:
    file = written(tmp_path / "ring.obj", *ring())
    spec = mujoco.MjSpec()
    add_object(
        spec, PlacedObject(GraspObject("ring", "mesh", (), 0.1, file), (0, 0, 0), (1, 0, 0, 0)), (0.8, 0.01, 0.0005)
    )
    model = spec.compile()
    assert model.body("ring").mass[0] == pytest.approx(0.1)
    a, b = 2 * OUTER, 2 * INNER
    about_z = 0.1 / 6 * (a**4 - b**4) / (a**2 - b**2)
    assert model.body("ring").inertia.max() == pytest.approx(about_z, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("corners", [4, 9])
def test_pieces_stand_out_of_the_surface_by_a_millimetre_at_most_and_are_kept(
    corners: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = load_mesh(written(tmp_path / "ring.obj", *ring(corners)))
    pieces = convex_parts(mesh, "ring")
    assert 2 <= len(pieces) <= 40
    assert surface_excess(pieces, mesh) <= 0.001
    assert sum(piece.volume for piece in pieces) == pytest.approx(mesh.volume, rel=0.05)
    monkeypatch.setattr("coacd.run_coacd", None)
    for again, piece in zip(convex_parts(mesh, "ring"), pieces, strict=True):
        np.testing.assert_array_equal(again.vertices, piece.vertices)


def prism(corners: Array, middle: int) -> Mesh:
    """A prism over a polygon (k, 2), m, all of which one corner sees, and as high as 2 HALF."""
    k = len(corners)
    vertices = np.concatenate([np.hstack([corners, np.full((k, 1), z)]) for z in (-HALF, HALF)])
    faces: list[tuple[int, int, int]] = []
    for i in range(k):
        j = (i + 1) % k
        faces += [(i, j, k + j), (i, k + j, k + i)]
        if middle not in (i, j):
            faces += [(middle, j, i), (k + middle, k + i, k + j)]
    return Mesh(vertices, np.array(faces))


GROOVED = 0.001 * np.array([(-20, -20), (20, -20), (20, -2), (-5, 0), (20, 2), (20, 20), (-20, 20)])


@pytest.mark.parametrize("solid", [True, False])
def test_pieces_that_make_up_a_solid_with_a_narrow_groove_do_not_stand_out_of_it(
    *, solid: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    tip, k = 3, len(GROOVED)
    turns = [(tip, i, (i + 1) % k) for i in range(k) if tip not in (i, (i + 1) % k)]
    pieces = [prism(GROOVED[list(turn)], 0) for turn in turns]
    whole = prism(GROOVED, tip)
    assert sum(piece.volume for piece in pieces) == pytest.approx(whole.volume)
    if not solid:
        monkeypatch.setattr("allegro_twin.sim.objects.mesh_repair.manifold_of", lambda soup: None)
    assert surface_excess(pieces, whole) < (1e-9 if solid else 4e-4)


def test_how_far_a_piece_stands_out_is_measured_to_a_micrometre() -> None:
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    more = prism(0.02 * square + [0.003, 0.0], 0)
    assert surface_excess([more], prism(0.02 * square, 0)) == pytest.approx(0.003, abs=1e-6)
    assert surface_excess([prism(0.01 * square, 0)], prism(0.02 * square, 0)) == 0.0


@pytest.mark.slow
def test_a_larger_one_is_cut_as_the_mesh_itself_and_not_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each draw of a size would cost half a minute otherwise."""
    thing = GraspObject("ring", "mesh", (), 0.1, written(tmp_path / "ring.obj", *ring()))
    pieces = thing.convex_parts()
    monkeypatch.setattr("coacd.run_coacd", None)
    case = Perturbation(size=1.05, mass=1.2)
    around = Stage(
        np.zeros(3), np.array([1.0, 0, 0, 0]), (PlacedObject(thing, (0, 0, HALF), (1, 0, 0, 0)),), table=True
    )
    (larger,) = case.on(around).objects
    for piece, one in zip(larger.grasp_object.convex_parts(), pieces, strict=True):
        np.testing.assert_allclose(piece.vertices, 1.05 * one.vertices, rtol=1e-12)
    np.testing.assert_allclose(larger.grasp_object.half_extents(), 1.05 * thing.half_extents())
    assert larger.position[2] == pytest.approx(1.05 * HALF)
    model = compile_scene(load_spec(), replace(around, objects=(larger,)))
    assert model.geom("ring/standing").dataid[0] == model.geom("ring").dataid[0]
    first = int(model.mesh("ring").vertadr[0])
    extents = np.ptp(model.mesh_vert[first : first + int(model.mesh("ring").vertnum[0])], axis=0)
    np.testing.assert_allclose(np.sort(extents), np.sort(2.1 * thing.half_extents()), rtol=1e-5)


@pytest.mark.slow
def test_a_fine_scan_is_cut_with_fewer_triangles(monkeypatch: pytest.MonkeyPatch) -> None:
    torus = trimesh.creation.torus(0.05, 0.015, major_sections=64, minor_sections=32)
    hull = torus.convex_hull  # It fills the hole, and stands out.
    cut: list[int] = []
    threads: list[threading.Thread] = []

    def run(mesh: Any, **_: object) -> list[tuple[Array, Array]]:
        cut.append(len(mesh.indices))
        threads.append(threading.current_thread())
        return [(np.array(hull.vertices), np.array(hull.faces))] * MOST

    monkeypatch.setattr("coacd.run_coacd", run)
    convex_parts(Mesh(np.array(torus.vertices), np.array(torus.faces)), "torus")
    assert len(torus.faces) == 4096
    assert cut == [CUT], "once, for finer cuts would be as many"
    assert threads != [threading.main_thread()], "which hears signals meanwhile"


def test_cutting_can_be_interrupted() -> None:
    threading.Timer(0.3, lambda: signal.raise_signal(signal.SIGINT)).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        _interruptible(lambda: time.sleep(60.0))
    assert time.monotonic() - began < 30.0


def test_what_is_convex_is_one_piece_and_needs_no_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "coacd", None)
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.02
    hull = convex_hull(corners, "cube")
    assert len(convex_parts(hull, "cube")) == 1
    with pytest.raises(
        ConfigError, match=r"ring is concave: its hull has 4\d % more volume.*pip install 'allegro-twin\["
    ):
        vertices, faces = ring()
        convex_parts(Mesh(vertices, np.array(faces)), "ring")


def test_without_the_extra_a_mesh_that_is_no_solid_says_why_and_what_repairs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("allegro_twin.sim.objects.meshes.missing_module", lambda: "trimesh")
    vertices, faces = ring()
    turned = [(a, c, b) for a, b, c in faces]
    for name, content, unit, message in (
        ("mm.obj", faces, 0.001, r"122 m across with scale 1; its numbers look like millimetres: say scale: 0\.001"),
        ("open.obj", faces[1:], 1.0, "not a closed surface: 3 edges do not join two faces"),
        ("turned.obj", turned, 1.0, "inside out: its faces look inwards"),
    ):
        with pytest.raises(ConfigError, match=message) as caught:
            load_mesh(written(tmp_path / name, vertices, content, unit))
        assert name in str(caught.value)
        assert "pip install 'allegro-twin[objects]'" in str(caught.value)
        assert "\n" not in str(caught.value)
    (tmp_path / "no.stl").write_text("solid nothing")
    with pytest.raises(ConfigError, match=r"no\.stl: not a readable mesh"):
        load_mesh(tmp_path / "no.stl")
    with pytest.raises(ConfigError, match=r"a\.ply: a mesh is \.obj or \.stl; to read \.ply: pip install"):
        load_mesh(tmp_path / "a.ply")


def test_a_mesh_stands_on_the_table_and_weighs_by_its_volume_where_nobody_says(tmp_path: Path) -> None:
    file = written(tmp_path / "ring.obj", *ring())
    own = {"name": "ring", "shape": "mesh", "file": str(file)}
    (placed,) = make_stage(scenario(objects=[own]), load_protocol("table_pick"), "right", tmp_path).objects
    assert placed.position[2] == pytest.approx(HALF, abs=2e-4)
    volume = 2 * HALF * 4 * (OUTER**2 - INNER**2)
    assert placed.grasp_object.mass == pytest.approx(500.0 * volume, rel=1e-6)
    hole = {**own, "collision": "hull"}
    (placed,) = make_stage(scenario(objects=[hole]), load_protocol("table_pick"), "right", tmp_path).objects
    assert placed.grasp_object.mesh().volume == pytest.approx(2 * HALF * 4 * OUTER**2, rel=1e-6)


@pytest.mark.slow
def test_a_mesh_takes_the_place_of_a_scenarios_object_by_its_path(tmp_path: Path) -> None:
    file = written(tmp_path / "ring.obj", *ring())
    (job,) = configs_of(["grasp_3"], Options(object=str(file)))
    rig = assemble(job.config)
    assert rig.trial is not None
    (placed,) = rig.trial.objects
    assert (placed.grasp_object.name, placed.grasp_object.shape) == ("ring", "mesh")
    assert job.name == "ring"
    (job,) = configs_of(["grasp_3"], Options(object=str(tmp_path / "no.obj")))
    with pytest.raises(ConfigError, match=r"object no: no file at .*no\.obj"):
        assemble(job.config)


def test_the_middle_of_a_mesh_is_where_its_own_file_has_it(tmp_path: Path) -> None:
    vertices, faces = ring()
    off = np.array([0.01, -0.02, 0.3])
    path = written(tmp_path / "ring.obj", vertices + off, faces, unit=0.001)
    np.testing.assert_allclose(mesh_middle(path, 0.001), off, atol=1e-6)
    mesh = load_mesh(path, 0.001)
    np.testing.assert_allclose(
        mesh.vertices.min(axis=0) + mesh_middle(path, 0.001), (vertices + off).min(axis=0), atol=1e-6
    )


@pytest.mark.parametrize("suffix", [".obj", ".stl"])
def test_without_the_extra_a_scan_is_refused_by_its_count_before_it_is_read(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("allegro_twin.sim.objects.meshes.missing_module", lambda: "trimesh")
    path, count = tmp_path / f"scan{suffix}", TRIANGLES + 1
    if suffix == ".obj":
        path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0" + "\nf 1 2 3" * count)
    else:
        path.write_bytes(bytes(80) + count.to_bytes(4, "little") + bytes(50 * count))
    with pytest.raises(ConfigError, match=f"{count} triangles; at most {TRIANGLES}: decimate it"):
        load_mesh(path)


def as_text(path: Path, mesh: Mesh, name: str = "thing") -> Path:
    """An ASCII .stl file as CAD programs write it."""
    lines = [f"solid {name}"]
    for face in mesh.faces:
        corners = [f"      vertex {x:e} {y:e} {z:e}" for x, y, z in mesh.vertices[face].tolist()]
        lines += ["  facet normal 0 0 0", "    outer loop", *corners, "    endloop", "  endfacet"]
    path.write_text("\n".join([*lines, f"endsolid {name}", ""]))
    return path


@pytest.mark.parametrize("name", ["thing", ""])
def test_an_ascii_stl_is_the_same_solid_as_the_mesh_it_was_written_from(tmp_path: Path, name: str) -> None:
    vertices, faces = ring(24)
    mesh = load_mesh(written(tmp_path / "ring.obj", vertices, faces))
    text = as_text(tmp_path / "ring.STL", mesh, name)
    found = load_mesh(text)
    assert len(found.faces) == len(mesh.faces)
    assert found.volume == pytest.approx(mesh.volume, rel=1e-5)
    np.testing.assert_allclose(found.extents, mesh.extents, rtol=1e-6)
    np.testing.assert_allclose(load_mesh(text, 0.5).extents, mesh.extents / 2, rtol=1e-6)
    np.testing.assert_allclose(mesh_middle(text), 0.0, atol=1e-6)


def test_an_ascii_stl_that_is_cut_short_or_holds_no_numbers_is_refused_in_one_line(tmp_path: Path) -> None:
    vertices, faces = ring()
    path = as_text(tmp_path / "ring.stl", Mesh(vertices, np.array(faces)))
    whole = path.read_text()
    for number, (text, said) in enumerate(
        [
            (whole[: len(whole) // 2], "cut short"),
            (whole.replace("vertex", "vertex x", 1), "is no number"),
            (whole.replace("vertex", "point", 1), "is no number"),
            ("solid nothing\nfacet\nendsolid nothing\n", "three vertices"),
        ]
    ):
        bad = tmp_path / f"{number}.stl"
        bad.write_text(text)
        with pytest.raises(ConfigError, match=rf"{number}\.stl: not a readable mesh: .*{said}"):
            load_mesh(bad)


def test_a_binary_stl_that_begins_with_solid_is_binary(tmp_path: Path) -> None:
    vertices, faces = ring()
    corners = vertices[np.array(faces)].astype("<f4")
    body = b"".join(np.zeros(3, "<f4").tobytes() + each.tobytes() + b"\0\0" for each in corners)
    path = tmp_path / "ring.stl"
    path.write_bytes(b"solid facet".ljust(80) + len(faces).to_bytes(4, "little") + body)
    assert len(load_mesh(path).faces) == len(faces)
