"""A scan becomes the solid that it shows, or is refused in a line with a way out; what was done is said."""

from __future__ import annotations

import logging
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.sim.objects import point_clouds
from allegro_twin.sim.objects.clean_mesh import (
    ScanSettings,
    checked,
    clean_mesh,
    make_clean,
    reduce_triangles,
)
from allegro_twin.sim.objects.mesh_repair import Repair, Soup, is_closed
from allegro_twin.sim.objects.meshes import load_hull, load_mesh, mesh_middle, mesh_report
from allegro_twin.sim.objects.scan_files import read_scan, stated_unit
from allegro_twin.types import Array
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
    dome,
    fine,
    merged,
    moved,
    mug,
    obj,
    pcd,
    ply,
    soup,
    stl,
    text_stl,
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


@pytest.mark.slow
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


def test_a_unit_after_a_number_in_a_name_is_that_of_a_size(tmp_path: Path) -> None:
    for name, unit in (("foam_cube_5_cm", None), ("ball_1_inch", None), ("die_25mm", None), ("mug_cm", "cm"),
                       ("mug2_inches", "inch"), ("scan3b_mm_1", "mm"), ("foot", None)):  # fmt: skip
        (tmp_path / name).write_bytes(b"v 0 0 0")
        assert stated_unit(tmp_path / name) == (None if name == "mug2_inches" else unit)


def test_a_unit_in_a_name_that_makes_no_usual_thing_is_asked_about_where_another_unit_does(tmp_path: Path) -> None:
    nut, tray = moved(bottle(), (0, 0, 0), 0.030 / 0.19), moved(bottle(), (0, 0, 0), 0.4 / 0.19)
    file = obj(tmp_path / "half_inch_nut.obj", nut.vertices, nut.faces.tolist(), 0.001)
    said = r"762 mm across in inch, which its name says, and 30 mm in mm \(--scale 0\.001\) or 300 mm in cm .*: say"
    with pytest.raises(ConfigError, match=said):
        make_clean(file)
    assert make_clean(file, ScanSettings(0.0254)).report.extents[2] == pytest.approx(0.762)
    large = obj(tmp_path / "tray_mm.obj", tray.vertices, tray.faces.tolist(), 0.001)  # In cm it is larger still.
    assert make_clean(large).report.unit == "mm, by its name"


def test_a_unit_at_the_end_of_a_name_is_taken_as_it_is_where_it_is_of_no_part(tmp_path: Path) -> None:
    bolt, rod = moved(bottle(), (0, 0, 0), 0.013 / 0.19), moved(bottle(), (0, 0, 0), 0.31 / 0.19)
    for name, solid, unit in (("bolt_mm", bolt, 0.001), ("rod-cm", rod, 0.01)):
        file = obj(tmp_path / f"{name}.obj", solid.vertices, solid.faces.tolist(), unit)
        assert make_clean(file).report.scale == unit
    inside = obj(tmp_path / "mm_bolt.obj", bolt.vertices, bolt.faces.tolist(), 0.001)
    with pytest.raises(ConfigError, match="13 mm across in mm, which its name says, and "):
        make_clean(inside)


def test_a_unit_that_a_file_states_is_known_or_refused_with_those_that_are(tmp_path: Path) -> None:
    file = tmp_path / "scan.obj"
    for text, unit in (("unit system: feet", "ft"), ("units: decimeters", "dm"), ("units: microns", "um"),
                       ("Units = µm", "um"), ("1 unit = 1 cm", "cm"), ("units: unknown", None), ("a unit cube", None),
                       ("comment units in metres", "m"), ("All units are in cm", "cm"), ("units are in inches", "inch"),
                       ("the unit is in.", "inch"), ("This unit is in good shape", None)):  # fmt: skip
        file.write_text(f"# {text}\nv 0 0 0\n", encoding="utf-8")
        assert stated_unit(file) == unit
    solid = bottle()
    assert make_clean(obj(file, solid.vertices, solid.faces.tolist(), 0.3048, "# units: feet")).report.extents[
        2
    ] == pytest.approx(0.19)
    obj(file, solid.vertices, solid.faces.tolist(), 0.3048, "# units: cubits")
    with pytest.raises(ConfigError, match=r"scan\.obj: its unit, 'cubits', is none of m, mm, cm, inch, .*--scale"):
        load_mesh(file)


def test_a_size_that_several_units_fit_is_never_taken_for_the_largest(tmp_path: Path) -> None:
    marble = moved(ball(), (0, 0, 0), 31 / 70)
    report = make_clean(stl(tmp_path / "marble.stl", soup(marble), 0.001)).report
    assert (report.unit, report.scale) == ("mm, by its size", 0.001)
    for size, said in (
        (0.0185, r"18\.5 mm if it is in mm .* or 185 mm if it is in cm"), (0.9, r"9\.0 mm .* or 23 mm"),
        (0.018, r"18\.0 mm if it is in mm .* or 180 mm if it is in cm"), (0.025, r"25 mm .* or 250 mm"),
        (0.008, r"80 mm if it is in cm .* or 203 mm if it is in inch"),
    ):  # fmt: skip
        file = stl(tmp_path / "scan.stl", soup(moved(ball(), (0, 0, 0), size / 0.07)), 1.0 if size > 0.5 else 0.001)
        with pytest.raises(ConfigError, match=rf"scan\.stl: .* across, in a unit that it does not name: {said}"):
            load_mesh(file)
    cup = make_clean(stl(tmp_path / "cup.stl", soup(moved(ball(), (0, 0, 0), 12 / 70)), 0.001)).report
    assert (cup.unit, cup.scale) == ("cm, by its size", 0.01)  # In mm it were a crumb, in inches a chair.
    solid = moved(ball(), (0, 0, 0), 10)
    file = obj(tmp_path / "said.obj", solid.vertices, solid.faces.tolist(), 1.0, "# units: m")
    assert load_mesh(file).extents.max() == pytest.approx(0.7)


def test_a_repair_that_moves_the_surface_by_more_than_a_millimetre_is_refused(tmp_path: Path) -> None:
    made = make_clean(stl(tmp_path / "scan.stl", soup(bottomless(bottle())), 0.001))
    for moved_by, wanted in ((0.0015, r"by 1\.5 mm, more than 1 mm: allow it, .* --tolerance 1\.5mm .*--hull"),
                             (0.05, r"by 50 mm, more than 1 mm: take its convex hull, --hull")):  # fmt: skip
        worse = replace(made, report=replace(made.report, deviation=moved_by))
        with pytest.raises(ConfigError, match=wanted):
            checked(tmp_path / "scan.stl", worse, ScanSettings())
        assert checked(tmp_path / "scan.stl", worse, ScanSettings(tolerance=0.06)) is worse


def test_an_open_surface_is_offered_a_wall_first_and_no_tolerance_that_is_large_beside_it(tmp_path: Path) -> None:
    made = make_clean(stl(tmp_path / "scan.stl", soup(bottomless(bottle())), 0.001))  # 64 mm wide.
    note = "if it is a thin wall, allegro-twin mesh --wall 2mm"
    wall = r"scan\.stl: repaired \(1 hole closed\), .*: it is open: .*, allegro-twin mesh scan\.stl --wall 2mm --out "
    for deviation, wanted in ((0.0063, wall + r".*, or allow it, .* --tolerance 6\.3mm .*, or .*--hull"),
                              (0.0066, wall + r"scan_clean\.obj, or take its convex hull, --hull")):  # fmt: skip
        worse = replace(made, report=replace(made.report, deviation=deviation, done=("1 hole closed", note)))
        with pytest.raises(ConfigError, match=wanted):
            checked(tmp_path / "scan.stl", worse, ScanSettings())
    closed = replace(made, report=replace(made.report, deviation=0.002))
    with pytest.raises(
        ConfigError, match=r": allow it, allegro-twin mesh scan\.stl --scale 0\.001 --tolerance 2\.0mm "
    ):
        checked(tmp_path / "scan.stl", closed, ScanSettings(0.001))


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


def part_of(solid: Solid, beyond: float) -> Array:
    """Corners of the triangles that are further along y, (m, 3, 3)."""
    corners = soup(solid)
    found: Array = corners[corners[:, :, 1].mean(axis=1) > beyond]
    return found


@pytest.mark.slow
def test_more_than_half_of_a_ball_becomes_the_ball_however_its_triangles_wind(tmp_path: Path) -> None:
    """Beyond the outline its surface looks away from the viewer."""
    corners = part_of(ball(), -0.003)
    wound = corners.copy()
    some = np.random.default_rng(0).random(len(wound)) < 0.4
    wound[some] = wound[some][:, ::-1]
    for triangles in (corners, wound):
        made = make_clean(stl(tmp_path / "part.stl", triangles, 0.001))
        assert "a view from one side" in made.report.line()
        np.testing.assert_allclose(np.linalg.norm(made.vertices, axis=1), 0.035, atol=0.0005)


def test_a_surface_that_lies_beside_its_points_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A band of normals that look inwards lifts the surface off all its copies."""
    whole = point_clouds._facing

    def turned(cloud: point_clouds.Oriented) -> point_clouds.Oriented:
        found = whole(cloud)
        inward = np.where(found.points[:, 1] < 0.0, -1.0, 1.0)[:, None]
        return found._replace(normals=inward * found.normals)

    monkeypatch.setattr(point_clouds, "_facing", turned)
    file = stl(tmp_path / "part.stl", part_of(ball(), -0.003), 0.001)
    vertices, faces = np.unique(part_of(ball(), -0.003).reshape(-1, 3), axis=0, return_inverse=True)
    with pytest.raises(ConfigError, match=r"part\.stl: the surface of its points lies up to \d\.\d mm beside them"):
        point_clouds.complete_surface(file, Soup(vertices, faces.reshape(-1, 3)), Repair())


def standing(solid: Solid, count: int = 12_000) -> tuple[Array, Array]:
    """Points of all that is seen of it while it stands on a table, and normals."""
    points, normals = cloud(solid, count, 0.0002)
    seen = points[:, 2] > solid.vertices[:, 2].min() + 0.001
    return points[seen], normals[seen]


@pytest.mark.slow
@pytest.mark.parametrize("known", [False, True])
def test_what_was_scanned_all_around_on_a_table_is_closed_flat_where_it_stood(known: bool, tmp_path: Path) -> None:
    """A computer mouse: no walls go up from its bottom, and it is no body of revolution."""
    truth = dome()
    points, normals = standing(truth)
    np.savetxt(tmp_path / "scan.xyz", 1000 * (np.hstack([points, normals / 1000]) if known else points), fmt="%.4f")
    made = make_clean(tmp_path / "scan.xyz")
    assert "1 end closed flat" in made.report.line()
    assert "assumed" not in made.report.line()
    assert made.report.volume[1] == pytest.approx(truth.volume, rel=0.07)
    assert made.vertices[:, 2].min() > -0.001
    assert made.report.triangles[1] <= 8000


def table(width: float, step: float) -> Solid:
    """A sheet about the origin, m."""
    at = np.arange(-width / 2, width / 2 + step / 2, step)
    x, y = (each.ravel() for each in np.meshgrid(at, at))
    count = len(at)
    corner = (np.arange(count - 1) * count + np.arange(count - 1)[:, None]).ravel()
    faces = [[corner, corner + 1, corner + count], [corner + 1, corner + count + 1, corner + count]]
    return Solid(np.stack([x, y, 0 * x], axis=1), np.concatenate([np.stack(each, axis=1) for each in faces]))


def test_a_table_that_was_scanned_with_a_thing_is_refused_and_named(tmp_path: Path) -> None:
    sheet, there = table(0.24, 0.01), np.random.default_rng(1).uniform(-0.12, 0.12, (12_000, 2))
    points = np.vstack([standing(dome())[0], np.column_stack([there, 0 * there[:, 0]])])
    points += np.random.default_rng(2).normal(0, 0.0002, points.shape)
    np.savetxt(tmp_path / "scan.xyz", 1000 * points, fmt="%.3f")
    stl(tmp_path / "open.stl", soup(merged(bottomless(dome()), sheet)), 0.001)
    slab = Solid(cracker().vertices * [2.5, 2, 0.05], cracker().faces)
    stl(tmp_path / "slab.stl", soup(merged(moved(dome(), (0, 0, 0.0015)), slab)), 0.001)
    for name, size in (("scan.xyz", "23. × 23."), ("open.stl", "2.. × 2.."), ("slab.stl", "4.. × 4..")):
        wanted = rf"a plane of some {size} mm, wider than the thing on it, is the table .*: crop it off"
        with pytest.raises(ConfigError, match=wanted):
            make_clean(tmp_path / name)


@pytest.mark.slow
def test_a_plate_with_a_knob_is_no_table_and_is_said_to_be_taken_as_a_part(tmp_path: Path) -> None:
    plate = Solid(cracker().vertices * [1, 0.8, 0.025], cracker().faces)
    both = merged(plate, moved(ball(), (0, 0, 0.016), 0.5))
    report = make_clean(stl(tmp_path / "lid.stl", soup(both), 0.001)).report
    assert report.extents[0] == pytest.approx(0.16)
    (said,) = (each for each in report.done if "plate" in each)
    wanted = (
        r"a flat plate of some 1[67]. × 1[56]. mm, 64 % of the volume, is taken as a part of it: .*table, crop it off"
    )
    assert re.match(wanted, said)
    slab = Solid(cracker().vertices * [1.25, 0.8, 0.02], cracker().faces)
    table = merged(slab, moved(mug(), (0, 0, 0.0006)))  # Most of its triangles are slivers.
    (said,) = (
        each for each in make_clean(stl(tmp_path / "mug.stl", soup(table), 0.001)).report.done if "plate" in each
    )
    assert "a flat plate of some 20" in said or "a flat plate of some 19" in said


@pytest.mark.slow
def test_parts_that_a_decimation_makes_touch_leave_a_closed_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    box = Solid(cracker().vertices, cracker().faces)
    both = merged(box, moved(box, tuple(np.ptp(box.vertices, axis=0) * [1, 1, 0])))
    _, first, place = np.unique(np.round(both.vertices, 6), axis=0, return_index=True, return_inverse=True)
    touching = Soup(both.vertices[first], place.ravel()[both.faces])
    assert not is_closed(touching)
    monkeypatch.setattr("allegro_twin.sim.objects.mesh_repair.decimate", lambda soup, count: touching)
    dense = fine(ball(), 0.0012)
    made = reduce_triangles(Soup(dense.vertices, dense.faces))
    assert is_closed(made)
    assert len(made.faces) == 24


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


@pytest.mark.parametrize("count", [0, 400, 5000, 2**32 - 1])
def test_a_binary_stl_whose_header_miscounts_is_read_to_its_end_and_says_so(count: int, tmp_path: Path) -> None:
    file = stl(tmp_path / "scan.stl", soup(bottle()), 0.001)
    content, there = file.read_bytes(), len(bottle().faces)
    file.write_bytes(content[:80] + struct.pack("<I", count) + content[84:])
    assert load_mesh(file).volume == pytest.approx(bottle().volume)
    report = mesh_report(file)
    assert report is not None
    assert f"header says {count:,} triangles, the file holds {there:,}: read all" in report.line()
    file = tmp_path / "cut.stl"
    file.write_bytes(content[:80] + struct.pack("<I", 5000) + content[84:-20])
    with pytest.raises(ConfigError, match=f"cut short: it has {there - 1} of 5000 triangles"):
        load_mesh(file)


def test_what_follows_the_triangles_of_a_binary_stl_is_none_of_them(tmp_path: Path) -> None:
    file = stl(tmp_path / "scan.stl", soup(bottle()), 0.001)
    for tail in (b"COLOR" * 7, b"COLOR" * 10):
        file.write_bytes(stl(file, soup(bottle()), 0.001).read_bytes() + tail)
        assert len(read_scan(file).faces) == len(bottle().faces)


@pytest.mark.slow
def test_a_surface_that_encloses_nothing_is_refused_with_a_wall_as_way_out(tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [80, 0, 0], [80, 60, 0], [0, 60, 0]]) / 1000
    flat = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]])
    for faces in (flat, flat[:2]):
        file = stl(tmp_path / "flat.stl", corners[faces], 0.001)
        with pytest.raises(ConfigError, match=r"flat\.stl: is flat and encloses no volume: .*--wall 2mm"):
            load_mesh(file)
    assert make_clean(file, ScanSettings(wall=0.002)).report.volume[1] > 8e-6


@pytest.mark.slow
def test_a_surface_of_one_side_has_no_inside(tmp_path: Path) -> None:
    turn, across = (each.ravel() for each in np.meshgrid(np.linspace(0, 2 * np.pi, 121), np.linspace(-12, 12, 5)))
    far = 40 + across * np.cos(turn / 2)
    places = np.stack([far * np.cos(turn), far * np.sin(turn), across * np.sin(turn / 2)], axis=1) / 1000
    at = np.arange(605).reshape(5, 121)
    a, b, c, d = (each.ravel() for each in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    with pytest.raises(ConfigError, match=r"moebius\.stl: its faces have no inside.*--wall 2mm"):
        load_mesh(stl(tmp_path / "moebius.stl", places[faces], 0.001))


def test_comments_and_blank_lines_are_none_of_the_numbers(tmp_path: Path) -> None:
    solid = bottle()
    text = text_stl(tmp_path / "scan.stl", soup(solid), 0.001).read_text()
    (tmp_path / "scan.stl").write_text(
        text.replace("outer loop", "outer loop // 12").replace(" endloop", "# of 12\n\n; 1 2\n endloop")
    )
    text = obj(tmp_path / "scan.obj", solid.vertices, solid.faces.tolist()).read_text()
    (tmp_path / "scan.obj").write_text(text.replace("\nf", " # 12\nf"))
    for name in ("scan.stl", "scan.obj"):
        assert load_mesh(tmp_path / name).volume == pytest.approx(solid.volume, rel=1e-3)


def test_a_line_that_is_odd_is_named_and_not_in_the_words_of_python(tmp_path: Path) -> None:
    rows = [" ".join(f"{number:.3f}" for number in row) for row in cloud(bracket(), 300)[0].tolist()]
    stl_text = text_stl(tmp_path / "comma.stl", soup(bottle()), 0.001).read_text()
    for name, content, said in (
        ("comma.stl", stl_text.replace(".", ","), r"line 4: '.*,.*' is no number; decimals need a point"),
        ("comma.xyz", "\n".join(rows).replace(".", ","), r"line 1: '.*,.*' is no number; decimals need a point"),
        ("odd.xyz", "\n".join([*rows[:6], rows[6] + " 7", *rows[7:]]), "line 7 has 4 numbers, most lines have 3"),
        ("odd.obj", "v 0 0 0\nv 1 0 0\nv 0 one 0\nf 1 2 3\n", "line 3: 'one' is no number"),
        ("face.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "line 4: 'x' is no number"),
    ):
        (tmp_path / name).write_text(content)
        with pytest.raises(ConfigError, match=rf"{name[:-4]}\.{name[-3:]}: not a readable mesh: {said}"):
            load_mesh(tmp_path / name)


def test_a_file_that_is_something_else_says_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "folder.stl").mkdir()
    for name, content, said in (
        ("page.stl", b"\n<!DOCTYPE html><html>404</html>", "is a web page, not a mesh"),
        ("page.obj", b"<HTML>", "is a web page, not a mesh"),
        ("lfs.stl", b"version https://git-lfs.github.com/spec/v1\n", "is a Git LFS pointer, .*git lfs pull"),
        ("empty.glb", b"", "is empty"), ("empty.npy", b"", "is empty"), ("empty.obj", b"", "is empty"),
        ("packed.stl", b"\x1f\x8b\x08", "is an archive: unpack it"), ("folder.stl", None, "is a folder"),
        ("https://host/mug.stl", None, "is an address: download it first"),
    ):  # fmt: skip
        path = Path(name) if "://" in name else tmp_path / name
        if content is not None:
            path.write_bytes(content)
        for load in (load_mesh, clean_mesh):
            with pytest.raises(ConfigError, match=said):
                load(path)


def test_a_mesh_under_the_name_of_another_kind_is_read_as_what_it_is(tmp_path: Path) -> None:
    text = text_stl(tmp_path / "a.stl", soup(bottle()), 0.001).read_bytes()
    binary = stl(tmp_path / "b.stl", soup(bottle()), 0.001).read_bytes()
    plain = obj(tmp_path / "c.obj", bottle().vertices, bottle().faces.tolist()).read_bytes()
    columns = {name: bottle().vertices[:, k].astype("f4") for k, name in enumerate("xyz")}
    polygons = ply(tmp_path / "d.ply", columns, bottle().faces, "binary_little_endian").read_bytes()
    for name, content, kind in (("e.obj", text, "stl"), ("f.ply", binary, "stl"), ("g.stl", plain, "obj"),
                                ("h.stl", polygons, "ply"), ("i.obj", polygons, "ply")):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        assert load_mesh(tmp_path / name).volume == pytest.approx(bottle().volume, rel=1e-3)
        report = mesh_report(tmp_path / name)
        assert report is not None
        assert f"read as .{kind}, which it is, not {name[1:]}" in report.line()


@pytest.mark.slow
def test_two_things_in_one_file_are_said_to_be_taken_as_one(tmp_path: Path) -> None:
    both = merged(ball(), moved(torus(), (0.135, 0.0, 0.0)))
    report = make_clean(stl(tmp_path / "scan.stl", soup(both), 0.001)).report
    assert "2 separate things, 50 mm apart, all taken as one" in report.line()


def test_a_wall_is_refused_for_what_is_closed_already(tmp_path: Path) -> None:
    file = obj(tmp_path / "box.obj", cracker().vertices, cracker().faces.tolist())
    with pytest.raises(ConfigError, match=r"box\.obj: --wall 2mm is for an open surface, and this one is closed"):
        make_clean(file, ScanSettings(wall=0.002))


def test_a_scale_of_one_is_metres_whatever_the_size_says(tmp_path: Path) -> None:
    file = obj(tmp_path / "box.obj", cracker().vertices, cracker().faces.tolist(), 0.001)
    assert load_mesh(file).extents.max() < 0.3
    with pytest.raises(ConfigError, match=r"m across in m, as said"):
        load_mesh(file, 1.0)
    with pytest.raises(ConfigError, match=r"\.obj: 105 m across in units of 0\.5 m, as said; a hand holds"):
        load_mesh(file, 0.5)
