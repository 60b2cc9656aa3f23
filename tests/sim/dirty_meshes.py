"""Twenty scans as they come, made by code: a clean solid, damaged in one way or several, in a file of one format."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import manifold3d
import numpy as np

from allegro_twin.types import Array


class Solid(NamedTuple):
    """A clean closed surface, m."""

    vertices: Array
    faces: Array

    @property
    def volume(self) -> float:
        """m³."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@dataclass(frozen=True)
class Dirty:
    """One of the twenty."""

    name: str
    what: str
    """The damage, in words."""
    solid: Callable[[], Solid]
    """The truth."""
    write: Callable[[Path, Solid], Path]
    """Makes the file in a folder."""
    kept: bool = True
    """The damage leaves the surface where it was; else a part of it is missing."""


def _of(made: manifold3d.Manifold) -> Solid:
    mesh = made.to_mesh64()
    return Solid(np.asarray(mesh.vert_properties)[:, :3] / 1000, np.asarray(mesh.tri_verts).astype(np.int64))


def _turned(outline: list[tuple[float, float]], segments: int = 96) -> manifold3d.Manifold:
    return manifold3d.Manifold.revolve(manifold3d.CrossSection([outline]), segments)


def _box(x: float, y: float, z: float) -> manifold3d.Manifold:
    return manifold3d.Manifold.cube([x, y, z], True)


@cache
def mug() -> Solid:
    """82 mm wide, 95 high, walls of 4 mm, with a handle."""
    body = _turned([(0, 0), (41, 0), (41, 95), (37, 95), (37, 5), (0, 5)])
    ring = manifold3d.CrossSection.circle(6, 24).translate([26, 0])
    handle = manifold3d.Manifold.revolve(ring, 64).rotate([90, 0, 0]).translate([44, 0, 48])
    return _of(body + (handle - manifold3d.Manifold.cylinder(200, 39, 39, 96).translate([0, 0, -50])))


@cache
def bottle() -> Solid:
    """64 mm wide, 190 high, full."""
    return _of(_turned([(0, 0), (32, 0), (32, 120), (14, 155), (14, 190), (0, 190)]))


@cache
def bowl() -> Solid:
    """150 mm wide, with a wall of 2.5 mm."""
    turn = np.linspace(0, np.pi / 2, 40)
    outer = [(75 * np.sin(a), 55 - 55 * np.cos(a)) for a in turn]
    inner = [(72.5 * np.sin(a), 55 - 52.5 * np.cos(a)) for a in turn]
    return _of(_turned([*outer, *reversed(inner)], 128))


@cache
def bracket() -> Solid:
    """An L of two plates, 80 × 40 × 60 mm, 8 mm thick."""
    return _of(_box(80, 40, 8) + _box(8, 40, 60).translate([-36, 0, 26]))


@cache
def ball() -> Solid:
    """70 mm."""
    return _of(manifold3d.Manifold.sphere(35, 128))


@cache
def dome() -> Solid:
    """116 × 66 × 38 mm, the upper half of an ellipsoid: a computer mouse."""
    return _of(manifold3d.Manifold.sphere(1, 96).scale([58, 33, 38]) ^ _box(200, 200, 100).translate([0, 0, 50]))


@cache
def torus() -> Solid:
    """100 mm wide, 30 mm thick."""
    return _of(_turned([(35 + 15 * np.cos(a), 15 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 48, endpoint=False)]))


@cache
def cracker() -> Solid:
    """A box of 160 × 210 × 60 mm."""
    return _of(_box(160, 210, 60))


def _drill_parts() -> list[manifold3d.Manifold]:
    return [
        manifold3d.Manifold.cylinder(150, 28, 28, 64).rotate([0, 90, 0]).translate([-75, 0, 0]),
        manifold3d.Manifold.cylinder(40, 12, 8, 48).rotate([0, 90, 0]).translate([70, 0, 0]),
        _box(42, 34, 110).translate([-45, 0, -60]),
        _box(80, 60, 35).translate([-40, 0, -125]),
    ]


@cache
def drill() -> Solid:
    """A power drill of four solids."""
    return _of(manifold3d.Manifold.batch_boolean(_drill_parts(), manifold3d.OpType.Add))


@cache
def screwdriver() -> Solid:
    """215 mm long, a handle of 31 mm and a blade of 6 mm."""
    return _of(_turned([(0, 0), (13, 0), (15.5, 20), (12, 95), (3, 100), (3, 215), (0, 215)], 48))


# Files.


def soup(solid: Solid) -> Array:
    """Corners of its triangles, (m, 3, 3)."""
    return np.asarray(solid.vertices[solid.faces])


def stl(path: Path, corners: Array, unit: float, header: bytes = b"") -> Path:
    """A binary .stl of triangles (m, 3, 3), m."""
    rows = np.zeros(len(corners), np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]))
    rows["v"] = corners / unit
    path.write_bytes(header.ljust(80) + struct.pack("<I", len(rows)) + rows.tobytes())
    return path


def text_stl(path: Path, corners: Array, unit: float) -> Path:
    """An ASCII .stl."""
    lines = ["solid scan"]
    for face in (corners / unit).tolist():
        lines += ["facet normal 0 0 0", " outer loop", *(f"  vertex {x:.6e} {y:.6e} {z:.6e}" for x, y, z in face)]
        lines += [" endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid scan", ""]))
    return path


def obj(path: Path, vertices: Array, faces: list[list[int]], unit: float = 1.0, head: str = "", tail: str = "") -> Path:
    """An .obj of polygons; `tail` ends each corner, `/1/1` for example."""
    lines = [head, *("v {} {} {}".format(*row) for row in (vertices / unit).tolist())]
    path.write_text("\n".join([*lines, *("f " + " ".join(f"{k + 1}{tail}" for k in face) for face in faces), ""]))
    return path


def ply(path: Path, columns: dict[str, Array], faces: Array | None, order: str) -> Path:
    """A .ply with any columns of vertices; `order`: ascii, binary_little_endian or binary_big_endian."""
    names = {"f": "float", "d": "double", "u": "uchar", "i": "int"}
    ends = ">" if order.endswith("big_endian") else "<"
    kinds = [(name, ends + column.dtype.str[1:]) for name, column in columns.items()]
    rows = np.zeros(len(next(iter(columns.values()))), kinds)
    for name, column in columns.items():
        rows[name] = column
    head = ["ply", f"format {order} 1.0", "comment made by a scanner", f"element vertex {len(rows)}"]
    head += [f"property {names[column.dtype.kind]} {name}" for name, column in columns.items()]
    if faces is not None:
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "property float quality"]
    content = "\n".join([*head, "end_header", ""]).encode()
    if order == "ascii":
        lines = [" ".join(str(value) for value in row.tolist()) for row in rows]
        lines += [f"3 {a} {b} {c} 0.5" for a, b, c in (faces if faces is not None else np.empty((0, 3), int)).tolist()]
        path.write_bytes(content + "\n".join([*lines, ""]).encode())
    else:
        body = rows.tobytes()
        if faces is not None:
            triangles = np.zeros(len(faces), [("n", "u1"), ("v", f"{ends}i4", 3), ("q", f"{ends}f4")])
            triangles["n"], triangles["v"] = 3, faces
            body += triangles.tobytes()
        path.write_bytes(content + body)
    return path


def off(path: Path, solid: Solid) -> Path:
    """An .off file."""
    lines = ["OFF", f"{len(solid.vertices)} {len(solid.faces)} 0"]
    lines += ["{} {} {}".format(*row) for row in solid.vertices.tolist()]
    path.write_text("\n".join([*lines, *("3 {} {} {}".format(*row) for row in solid.faces.tolist()), ""]))
    return path


def pcd(path: Path, points: Array, normals: Array | None = None, data: str = "binary") -> Path:
    """A .pcd file of single floats, with a field that nobody needs."""
    names = ["x", "y", "z", "intensity"] + ([] if normals is None else ["normal_x", "normal_y", "normal_z"])
    table = np.hstack([points, np.ones((len(points), 1)), *([] if normals is None else [normals])]).astype("<f4")
    n = len(names)
    head = ["# .PCD v0.7", "VERSION 0.7", f"FIELDS {' '.join(names)}", "SIZE" + " 4" * n, "TYPE" + " F" * n,
            "COUNT" + " 1" * n, f"WIDTH {len(table)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(table)}",
            f"DATA {data}", ""]  # fmt: skip
    body = "\n".join(" ".join(map(str, row)) for row in table.tolist()).encode() if data == "ascii" else table.tobytes()
    path.write_bytes("\n".join(head).encode() + body)
    return path


def glb(path: Path, solid: Solid, unit: float) -> Path:
    """A .glb whose node brings the numbers to m."""
    import trimesh

    scene = trimesh.Scene()
    mesh = trimesh.Trimesh(solid.vertices / unit, solid.faces, process=False)
    scene.add_geometry(mesh, transform=np.diag([unit, unit, unit, 1.0]))
    path.write_bytes(scene.export(file_type="glb"))
    return path


# Damage.


def fine(solid: Solid, edge: float) -> Solid:
    """With edges of at most so many m."""
    mesh = manifold3d.Mesh64(np.ascontiguousarray(solid.vertices), np.ascontiguousarray(solid.faces.astype(np.uint64)))
    made = manifold3d.Manifold(mesh).refine_to_length(edge).to_mesh64()
    return Solid(np.asarray(made.vert_properties)[:, :3].copy(), np.asarray(made.tri_verts).astype(np.int64))


def noisy(solid: Solid, sigma: float, seed: int = 0) -> Solid:
    """Each vertex moved at random, m."""
    rng = np.random.default_rng(seed)
    return Solid(solid.vertices + rng.normal(0, sigma / np.sqrt(3), solid.vertices.shape), solid.faces)


def centers(solid: Solid) -> Array:
    """Of its triangles, (m, 3), m."""
    return np.asarray(soup(solid).mean(axis=1))


def pierced(solid: Solid, count: int, radius: float, seed: int = 0) -> Solid:
    """With holes around faces chosen at random, m."""
    rng, at = np.random.default_rng(seed), centers(solid)
    gone = np.zeros(len(at), dtype=bool)
    for k in rng.choice(len(at), count, replace=False):
        gone |= np.linalg.norm(at - at[k], axis=1) < radius
    return Solid(solid.vertices, solid.faces[~gone])


def bottomless(solid: Solid) -> Solid:
    """Without the faces on which it stands."""
    low = solid.vertices[:, 2].min()
    return Solid(solid.vertices, solid.faces[~(soup(solid)[:, :, 2] < low + 1e-6).all(axis=1)])


def some_flipped(solid: Solid, share: float = 0.3) -> Solid:
    """With so many faces inside out."""
    turned = np.random.default_rng(1).random(len(solid.faces)) < share
    return Solid(solid.vertices, np.where(turned[:, None], solid.faces[:, ::-1], solid.faces))


def merged(*solids: Solid) -> Solid:
    """Side by side in one file."""
    offset = np.cumsum([0, *(len(each.vertices) for each in solids)])
    return Solid(
        np.concatenate([each.vertices for each in solids]),
        np.concatenate([each.faces + k for each, k in zip(solids, offset, strict=False)]),
    )


def moved(solid: Solid, by: tuple[float, float, float], times: float = 1.0) -> Solid:
    """Larger and elsewhere, m."""
    return Solid(solid.vertices * times + np.array(by), solid.faces)


def flecks(solid: Solid, count: int = 12) -> Solid:
    """With loose scraps of one to five triangles around it."""
    rng, parts = np.random.default_rng(2), []
    low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
    for k in range(count):
        corners = rng.uniform(low - 0.05, high + 0.05) + rng.normal(0, 0.001, (2 + k % 5, 3))
        rows = np.array([(0, j, j + 1) for j in range(1, len(corners) - 1)]).reshape(-1, 3)
        parts.append(Solid(corners, rows))
    return merged(solid, *(part for part in parts if len(part.faces)))


def cloud(solid: Solid, count: int, sigma: float = 0.0, seed: int = 3) -> tuple[Array, Array]:
    """Points on it and its normals there."""
    rng, corners = np.random.default_rng(seed), soup(solid)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    rows = rng.choice(len(area), count, p=area / area.sum())
    points = np.einsum("ki,kij->kj", rng.dirichlet((1, 1, 1), count), corners[rows])
    return points + rng.normal(0, sigma / np.sqrt(3), points.shape), normal[rows] / area[rows, None]


def view(solid: Solid, toward: tuple[float, float, float], pixel: float, sigma: float = 0.0) -> Array:
    """What a depth camera far away in a direction sees, a point a pixel (m)."""
    ahead = np.array(toward, dtype=float) / np.linalg.norm(toward)
    first = np.cross(ahead, [0.0, 0.0, 1.0] if abs(ahead[2]) < 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    frame = np.stack([first, np.cross(ahead, first), ahead], axis=1)
    points, _ = cloud(solid, 1_500_000)
    own = points @ frame
    cell = np.floor(own[:, :2] / pixel).astype(np.int64)
    order = np.lexsort((-own[:, 2], cell[:, 1], cell[:, 0]))
    cell, own = cell[order], own[order]
    seen = own[np.r_[True, (np.diff(cell, axis=0) != 0).any(axis=1)]]
    seen[:, 2] += np.random.default_rng(4).normal(0, sigma, len(seen))
    return np.asarray(seen @ frame.T)


def _columns(points: Array, normals: Array | None = None, dtype: str = "f4", colour: bool = True) -> dict[str, Array]:
    found = {name: points[:, k].astype(dtype) for k, name in enumerate("xyz")}
    if normals is not None:
        found |= {f"n{name}": normals[:, k].astype(dtype) for k, name in enumerate("xyz")}
    if colour:
        found |= {name: np.full(len(points), 200, "u1") for name in ("red", "green", "blue")}
    return found


def _two_million(folder: Path, solid: Solid) -> Path:
    dense = fine(solid, 0.00014)
    return stl(folder / "scan.stl", soup(noisy(dense, 0.0003)), 0.001, b"solid exported by a scanner")


def _finned(folder: Path, solid: Solid) -> Path:
    """A third face at an edge, and one face three times."""
    a, b, _ = solid.faces[0].tolist()
    vertices = np.vstack([solid.vertices, solid.vertices[[a, b]].mean(axis=0) + 0.004])
    return obj(
        folder / "scan.obj", vertices, [*solid.faces.tolist(), [a, b, len(vertices) - 1], *solid.faces[:2].tolist()]
    )


def _polygons(folder: Path, solid: Solid) -> Path:
    """In inches, quads and an n-gon, with texture coordinates and materials that are not there."""
    x, y, z = np.ptp(solid.vertices, axis=0) / 2
    plan = np.array([(-x, -y), (0, -y), (x, -y), (x, y), (0, y), (-x, y)])
    vertices = np.vstack([np.column_stack([plan, np.full(6, h)]) for h in (-z, z)])
    faces = [[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *([k, (k + 1) % 6, 6 + (k + 1) % 6, 6 + k] for k in range(6))]
    head = "mtllib lost.mtl\no box\nusemtl paper\nvt 0 0\nvn 0 0 1"
    return obj(folder / "scan_inch.obj", vertices, faces, 0.0254, head, "/1/1")


def _t_junctions(folder: Path, solid: Solid) -> Path:
    """Every third face cut in two at the middle of an edge that its neighbour does not cut."""
    vertices, faces = solid.vertices.tolist(), []
    for number, (a, b, c) in enumerate(solid.faces.tolist()):
        if number % 3:
            faces.append([a, b, c])
            continue
        vertices.append(((solid.vertices[a] + solid.vertices[b]) / 2).tolist())
        faces += [[a, len(vertices) - 1, c], [len(vertices) - 1, b, c]]
    return obj(folder / "scan.obj", np.array(vertices), faces)


def _broken(folder: Path, solid: Solid) -> Path:
    """Slivers, faces of a vertex that is NaN, vertices that nobody uses."""
    count = len(solid.vertices)
    vertices = np.vstack([solid.vertices, [[np.nan] * 3], [[0.7, 0.7, 0.7]], solid.vertices[:50] + 1e-9])
    faces = solid.faces.tolist()
    faces += [[0, 1, count], [5, 5, 9], *([k, k, count + 2 + k] for k in range(50))]
    return obj(folder / "scan.obj", vertices, faces)


def _drill_shells(folder: Path, _: Solid) -> Path:
    whole = merged(*(_of(part) for part in _drill_parts()))
    return obj(folder / "scan.obj", whole.vertices, whole.faces.tolist(), 0.001, "# units: mm")


def _double(folder: Path, solid: Solid) -> Path:
    """Each face from both sides."""
    return obj(folder / "scan.obj", solid.vertices, [*solid.faces.tolist(), *solid.faces[:, ::-1].tolist()])


def _cloud_ply(folder: Path, solid: Solid) -> Path:
    points, normals = cloud(solid, 60_000, 0.0003)
    return ply(folder / "scan.ply", _columns(points, normals), None, "binary_little_endian")


def _cloud_xyz(folder: Path, solid: Solid) -> Path:
    points, _ = cloud(solid, 60_000, 0.0003)
    np.savetxt(folder / "scan.xyz", points * 1000, fmt="%.4f")
    return folder / "scan.xyz"


def _cloud_npy(folder: Path, solid: Solid) -> Path:
    np.save(folder / "scan.npy", np.hstack(cloud(solid, 150_000)))
    return folder / "scan.npy"


def _mesh_ply(order: str, change: Callable[[Solid], Solid], unit: float = 1.0) -> Callable[[Path, Solid], Path]:
    def write(folder: Path, solid: Solid) -> Path:
        made = change(solid)
        return ply(folder / "scan.ply", _columns(made.vertices / unit), made.faces, order)

    return write


DIRTY = (
    Dirty("mug", "ASCII STL, mm", mug, lambda at, it: text_stl(at / "scan.stl", soup(it), 0.001)),
    Dirty("torus", "all faces inside out", torus,
          lambda at, it: obj(at / "scan.obj", it.vertices, it.faces[:, ::-1].tolist())),
    Dirty("bottle", "a third of the faces inside out, PLY with colours, mm", bottle,
          _mesh_ply("binary_little_endian", some_flipped, 0.001)),
    Dirty("bottle", "the whole bottom missing, binary STL, mm", bottle,
          lambda at, it: stl(at / "scan.stl", soup(bottomless(it)), 0.001), kept=False),
    Dirty("bowl", "six holes, noise, PLY of the other byte order", bowl,
          _mesh_ply("binary_big_endian", lambda it: pierced(noisy(fine(it, 0.003), 0.0003), 6, 0.006))),
    Dirty("ball", "two million triangles, noise, binary STL that begins with “solid”", ball, _two_million),
    Dirty("bracket", "three faces at an edge, faces repeated", bracket, _finned),
    Dirty("cracker box", "each face from both sides", cracker, _double),
    Dirty("drill", "four shells that overlap, unit in a comment", drill, _drill_shells),
    Dirty("ball", "a shell inside, OFF", ball,
          lambda at, it: off(at / "scan.off", merged(it, moved(it, (0.004, 0.0, 0.0), 0.6)))),
    Dirty("mug", "twelve loose flecks, ASCII PLY", mug, _mesh_ply("ascii", flecks)),
    Dirty("cracker box", "quads and n-gons in inches, as its name says, materials missing", cracker, _polygons),
    Dirty("screwdriver", "cm, holes", screwdriver,
          lambda at, it: stl(at / "scan_cm.stl", soup(pierced(fine(it, 0.004), 5, 0.004)), 0.01)),
    Dirty("bracket", "T-junctions", bracket, _t_junctions),
    Dirty("torus", "slivers, NaN, unused vertices", torus, _broken),
    Dirty("mug", "GLB with a scaled node", mug, lambda at, it: glb(at / "scan.glb", it, 0.001)),
    Dirty("bottle", "cloud with normals, noise, PLY", bottle, _cloud_ply),
    Dirty("torus", "cloud without normals, noise, XYZ in mm", torus, _cloud_xyz),
    Dirty("bottle", "view from one side, PCD", bottle,
          lambda at, it: pcd(at / "scan.pcd", view(it, (1, 0.2, 0), 0.0012, 0.0002)), kept=False),
    Dirty("bowl", "cloud of both sides of the wall, with normals, NPY", bowl, _cloud_npy),
)  # fmt: skip
"""The twenty."""


def distances(truth: Solid, vertices: Array, faces: Array) -> tuple[float, float]:
    """Largest distance from the truth to a surface and back, m, from samples."""
    from allegro_twin.sim.objects.mesh_repair import Soup
    from allegro_twin.sim.objects.remesh import Surface

    one, two = Surface(Soup(truth.vertices, truth.faces), 8e-4), Surface(Soup(vertices, faces), 8e-4)
    return float(two.distance(one.points)[0].max()), float(one.distance(two.points)[0].max())
