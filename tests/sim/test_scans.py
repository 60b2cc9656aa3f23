"""A scan becomes the solid that it shows, or is refused in a line with a way out; what was done is said."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.sim.objects.clean_mesh import ScanSettings, checked, clean_mesh, make_clean
from allegro_twin.sim.objects.meshes import load_hull, load_mesh, mesh_middle, mesh_report
from allegro_twin.sim.objects.scan_files import read_scan, stated_unit
from tests.sim.dirty_meshes import (
    DIRTY,
    Dirty,
    Solid,
    ball,
    bottle,
    bottomless,
    bowl,
    bracket,
    cloud,
    cracker,
    distances,
    moved,
    obj,
    pcd,
    soup,
    stl,
    torus,
    view,
)

QUICK = (0, 1, 2, 3, 6, 7, 10, 11, 13, 14, 15)
"""Those of the twenty that take less than a second."""


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.parametrize("number", QUICK)
def test_a_dirty_mesh_becomes_the_solid_that_it_was(number: int, tmp_path: Path) -> None:
    dirty = DIRTY[number]
    mesh = load_mesh(dirty.write(tmp_path, dirty.solid()))
    assert mesh.open_edges() == 0
    assert mesh.volume == pytest.approx(dirty.solid().volume, rel=0.001)


@pytest.mark.slow
@pytest.mark.parametrize("number", sorted({*range(len(DIRTY))} - {5}))
def test_its_surface_is_where_it_was_too(number: int, tmp_path: Path) -> None:
    check(DIRTY[number], tmp_path)


@pytest.mark.long
def test_so_do_two_million_triangles(tmp_path: Path) -> None:
    check(DIRTY[5], tmp_path)


def check(dirty: Dirty, folder: Path) -> None:
    """Volume within 3 %, surface within a millimetre; of a view from one side the volume within a tenth."""
    truth = dirty.solid()
    mesh = load_mesh(dirty.write(folder, truth))
    assert mesh.open_edges() == 0
    one_sided = "view" in dirty.what
    assert mesh.volume == pytest.approx(truth.volume, rel=0.1 if one_sided else 0.03)
    if not one_sided:
        middle = (truth.vertices.min(axis=0) + truth.vertices.max(axis=0)) / 2
        here = Solid(truth.vertices - middle, truth.faces)
        assert max(distances(here, mesh.vertices, mesh.faces)) < 0.001


def test_a_clean_mesh_is_taken_as_it_is_and_nothing_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    solid = torus()
    file = obj(tmp_path / "torus.obj", solid.vertices, solid.faces.tolist())
    with caplog.at_level(logging.INFO):
        mesh = load_mesh(file)
    assert (mesh_report(file), caplog.messages) == (None, [])
    assert len(mesh.faces) == len(solid.faces)


def test_what_was_done_is_said_in_one_line_and_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = stl(tmp_path / "scan.stl", soup(bottomless(bottle())), 0.001)
    load_mesh(file)
    load_mesh(file)
    (said,) = caplog.messages
    assert said.startswith(
        "scan.stl: 64 × 64 × 190 mm (mm, by its size); 1 hole closed 64 mm wide; 672 → 766 triangles"
    )
    assert said.endswith("volume 468.4 cm³; largest deviation 0 mm")


def test_a_repaired_mesh_is_kept_by_its_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = clean_mesh(stl(tmp_path / "a.stl", soup(bottomless(bottle())), 0.001))
    (tmp_path / "b.stl").write_bytes((tmp_path / "a.stl").read_bytes())
    monkeypatch.setattr("allegro_twin.sim.objects.clean_mesh.make_clean", None)
    again = clean_mesh(tmp_path / "b.stl")
    np.testing.assert_array_equal(again.vertices, first.vertices)
    np.testing.assert_array_equal(again.faces, first.faces)
    assert again.report.line().replace("b.stl", "a.stl") == first.report.line()
    with pytest.raises(TypeError):
        clean_mesh(tmp_path / "b.stl", ScanSettings(0.0011))


def test_a_unit_is_that_of_the_file_or_of_the_only_size_that_a_hand_holds(tmp_path: Path) -> None:
    solid = bottomless(bottle())
    for unit, name in ((0.001, "mm"), (1.0, "m"), (0.0254, "inch"), (0.01, "cm")):
        report = make_clean(obj(tmp_path / f"{name}_.obj", solid.vertices, solid.faces.tolist(), unit)).report
        assert report.scale == unit
    odd = moved(solid, (0, 0, 0), 0.3137 / 0.19 * 0.19)
    file = obj(tmp_path / "odd.obj", odd.vertices, odd.faces.tolist(), 0.01)
    with pytest.raises(
        ConfigError, match=r"odd\.obj: 5\.96 across, in a unit .*60 mm if it is in cm \(--scale 0\.01\) or 151"
    ):
        make_clean(file)
    assert make_clean(file, ScanSettings(0.0254)).report.extents[2] == pytest.approx(0.1514, rel=1e-3)
    (tmp_path / "said.obj").write_bytes(b"# Units: centimeters\n" + file.read_bytes())
    assert stated_unit(tmp_path / "said.obj") == "cm"


def test_a_repair_that_moves_the_surface_by_more_than_a_millimetre_is_refused(tmp_path: Path) -> None:
    made = make_clean(stl(tmp_path / "scan.stl", soup(bottomless(bottle())), 0.001))
    for moved_by, wanted in ((0.0015, r"by 1\.5 mm, more than 1 mm: allow it, .* --tolerance 1\.5mm .*--hull"),
                             (0.05, r"by 50 mm, more than 1 mm: take its convex hull, --hull")):  # fmt: skip
        worse = replace(made, report=replace(made.report, deviation=moved_by))
        with pytest.raises(ConfigError, match=wanted):
            checked(tmp_path / "scan.stl", worse, ScanSettings())
        assert checked(tmp_path / "scan.stl", worse, ScanSettings(tolerance=0.06)) is worse


@pytest.mark.slow
def test_a_repair_that_moves_the_surface_is_refused_with_a_way_out_that_works(tmp_path: Path) -> None:
    """A bowl of one sheet, taken as a wall, is rounded at its rim."""
    faces = ball().faces[3000:].tolist()
    file = obj(tmp_path / "scan.obj", ball().vertices, faces)
    with pytest.raises(
        ConfigError, match=r"more than 0\.01 mm: .*--tolerance (\d.*)mm --out scan_clean\.obj.*--hull"
    ) as said:
        make_clean(file, ScanSettings(1.0, 1e-5, 0.002))
    allowed = float(str(said.value).split("--tolerance ")[1].split("mm")[0]) / 1000
    assert make_clean(file, ScanSettings(1.0, allowed, 0.002)).report.deviation > 1e-5
    assert load_hull(file).volume == pytest.approx(ball().volume, rel=0.1)


@pytest.mark.slow
def test_a_surface_without_thickness_that_is_seen_from_both_sides_is_a_wall(tmp_path: Path) -> None:
    """The outer face of a bowl, as ShapeNet has them."""
    solid = bowl()
    at = soup(solid).mean(axis=1)
    outer = solid.faces[np.hypot(np.hypot(at[:, 0], at[:, 1]) / 0.0750, (at[:, 2] - 0.055) / 0.055) > 0.985]
    faces = [*outer.tolist(), *outer[:, ::-1].tolist()]
    made = make_clean(obj(tmp_path / "bowl.obj", solid.vertices, faces))
    assert "wall of 2 mm" in made.report.line()
    assert made.report.volume[1] < 1.3 * solid.volume


@pytest.mark.slow
def test_a_view_from_one_side_says_what_is_assumed(tmp_path: Path) -> None:
    for name, solid, toward, said in (
        ("ball", ball(), (1.0, 0.3, 0.2), "turned about an axis"),
        ("box", moved(cracker(), (0, 0, 0), 0.5), (1.0, 0.8, 0.9), "turned about the middle of its outline"),
    ):
        made = make_clean(pcd(tmp_path / f"{name}.pcd", view(solid, toward, 0.0012)))
        assert "a view from one side: the far side is assumed, " in made.report.line()
        assert said in made.report.line()
        assert made.report.volume[1] == pytest.approx(solid.volume, rel=0.1)
    flat = view(moved(cracker(), (0, 0, 0), 0.5), (0.0, 1.0, 0.0), 0.0012)
    with pytest.raises(ConfigError, match="without depth: scan it from a second side"):
        make_clean(pcd(tmp_path / "flat.pcd", flat))


def test_the_middle_of_a_repaired_mesh_is_where_its_own_file_has_it(tmp_path: Path) -> None:
    solid = moved(bottomless(bottle()), (0.1, -0.2, 0.3))
    file = stl(tmp_path / "scan.stl", soup(solid), 0.001)
    np.testing.assert_allclose(mesh_middle(file), [0.1, -0.2, 0.395], atol=1e-6)
    np.testing.assert_allclose(load_mesh(file).vertices.min(axis=0), [-0.032, -0.032, -0.095], atol=1e-6)


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_a_cloud_is_read_with_its_normals(data: str, tmp_path: Path) -> None:
    points, normals = cloud(bracket(), 500)
    scan = read_scan(pcd(tmp_path / "a.pcd", points, normals, data))
    assert scan.normals is not None
    np.testing.assert_allclose(scan.points, points, atol=1e-6)
    np.testing.assert_allclose(scan.normals, normals, atol=1e-6)


def test_what_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    for name, content in (
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n"), ("b.glb", b"glTF"), ("c.pcd", b"DATA ascii\n"),
        ("d.xyz", b"nothing\n"), ("e.npy", b"\x93NUMPY"), ("f.off", b"OFF\n"), ("g.obj", b"f 1 2 3\n"), ("h.stl", b""),
        ("i.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"), ("j.xyz", b"0 0 0\n1 1 1\n"),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ConfigError, match=rf"{name[0]}\.{name[2:]}: ") as caught:
            load_mesh(tmp_path / name)
        assert "\n" not in str(caught.value)
