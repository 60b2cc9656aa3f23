"""A user's mesh: read, checked, measured, and repaired where it is no solid."""

from __future__ import annotations

import logging
from functools import lru_cache
from multiprocessing import parent_process
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.sim.objects.clean_mesh import Report, ScanSettings, clean_mesh, hull_points
from allegro_twin.sim.objects.mesh_repair import OVERLAP, Soup, is_flat, loose_parts, overlap
from allegro_twin.sim.objects.scan_files import (
    CLOUDS,
    INSTALL,
    LARGE,
    LARGEST,
    MESHES,
    SMALLEST,
    check_file,
    miscounted,
    missing_module,
    stated_unit,
)
from allegro_twin.types import Array, Vector

log = logging.getLogger(__name__)

TRIANGLES = 200_000
"""More than that is a scan: its detail is far below what a fingertip feels, and decomposing it takes hours."""
_HEAD, _FACE = 84, 50
"""Bytes of a binary .stl: 80 of anything and the number of its triangles, and for each of them."""
PLAIN = (".obj", ".stl")
"""What is read without the extra."""
SUFFIXES = (*MESHES, *CLOUDS)
"""What is a mesh, or points of one, where an object is named."""


class Mesh(NamedTuple):
    """Triangles of a closed surface, in m, about the middle of their bounding box."""

    vertices: Array
    """(k, 3), m."""
    faces: Array
    """(m, 3), indices, counter-clockwise seen from outside."""

    @property
    def extents(self) -> Array:
        """Edges of the bounding box, (3,), m."""
        extents: Array = np.ptp(self.vertices, axis=0)
        return extents

    @property
    def volume(self) -> float:
        """Enclosed, m³; negative where the faces look inwards: Σ v₀·(v₁ × v₂) / 6."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    def times(self, factor: float) -> Mesh:
        """Copy of the mesh, larger by a factor."""
        return self if factor == 1.0 else Mesh(self.vertices * factor, self.faces)

    def open_edges(self) -> int:
        """Edges that do not join exactly two faces which run along it in opposite directions."""
        edges = self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        ahead = {tuple(edge) for edge in edges.tolist()}
        return len(edges) - len(ahead) + sum((b, a) not in ahead for a, b in ahead)


def load_mesh(path: Path, scale: float | None = None) -> Mesh:
    """A mesh from a file: as it is, or, where it is no solid of a hand's size, repaired, which the log says. `scale`:
    the unit of the file, m; None: as the file or its size says. Raises ConfigError for what cannot be."""
    return _load(path, scale).mesh


def mesh_middle(path: Path, scale: float | None = None) -> Vector:
    """Where the origin of a loaded mesh, the middle of its bounding box, is in the axes of its file, (3,), m: poses
    that others give of an object are those of its file. Raises ConfigError for what is no mesh of a hand's size."""
    return _load(path, scale).middle


def mesh_report(path: Path, scale: float | None = None) -> Report | None:
    """What was done to a mesh; None for one that is taken as it is. Raises ConfigError."""
    return _load(path, scale).report


class _Loaded(NamedTuple):
    mesh: Mesh
    middle: Vector
    report: Report | None


@lru_cache(maxsize=32)
def _load(path: Path, scale: float | None) -> _Loaded:
    plain, wrong = None, None
    if path.suffix.lower() in PLAIN:
        try:
            model = _compiled(path, scale)
            plain = _of_model(model)
            vertices, _ = _as_in_file(model)
            wrong = _fault(path, plain, scale)
        except ConfigError as error:
            wrong = error
    ours = missing_module() is None
    if plain is not None and wrong is None and not (ours and _doubtful(plain)):
        return _Loaded(plain, _middle(vertices), None)
    if not ours:
        raise _unrepaired(path, wrong)
    made = clean_mesh(path, ScanSettings(scale))
    same = plain is not None and wrong is None and made.report.same
    middle = _middle(made.vertices)
    if parent_process() is None and (made.report.done or not same):
        log.warning("%s", made.report.line())
    if same and plain is not None:
        return _Loaded(plain, _middle(vertices), made.report if made.report.done else None)
    return _Loaded(Mesh(made.vertices - middle, made.faces), middle, made.report)


def _fault(path: Path, mesh: Mesh, scale: float | None) -> ConfigError | None:
    """Why a mesh is no solid of a hand's size."""
    size, stated = float(mesh.extents.max()), stated_unit(path) if scale is None else "m"
    if not SMALLEST <= size <= (LARGEST if stated == "m" else LARGE):
        unit = 1.0 if scale is None else scale
        factor = f"its numbers look like millimetres: say scale: {unit / 1000:g}" if size > LARGEST else "say its scale"
        return ConfigError(f"{path}: {size:.3g} m across with scale {unit:g}; {factor}")
    if stated not in (None, "m"):
        return ConfigError(f"{path}: its unit is {stated}, as it says: say its scale")
    if is_flat(Soup(mesh.vertices, mesh.faces)):
        return ConfigError(f"{path}: is flat and encloses no volume; {INSTALL} makes a plate of it, mesh --wall 2mm")
    if (count := mesh.open_edges()) > 0:
        return ConfigError(
            f"{path}: not a closed surface: {count} edges do not join two faces; {INSTALL} closes it, or take its "
            "convex hull: `collision: hull` in a scenario, --hull of `plan` and `new`"
        )
    if mesh.volume < 0.0:
        return ConfigError(f"{path}: inside out: its faces look inwards; {INSTALL} turns them round")
    return None


def _unrepaired(path: Path, wrong: ConfigError | None) -> ConfigError:
    if wrong is None:
        return ConfigError(f"{path}: a mesh is {' or '.join(PLAIN)}; to read {path.suffix or 'it'}: {INSTALL}")
    return wrong if INSTALL in str(wrong) else ConfigError(f"{wrong}; {INSTALL} may repair it")


def _doubtful(mesh: Mesh) -> bool:
    """Whether a closed surface may enclose something twice: it is of several parts, or crosses itself."""
    soup = Soup(mesh.vertices, mesh.faces)
    return bool(loose_parts(soup).max() > 0 or overlap(soup) > OVERLAP)


def _middle(vertices: Array) -> Vector:
    middle: Vector = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    return middle


@lru_cache(maxsize=32)
def load_hull(path: Path, scale: float | None = None) -> Mesh:
    """The convex hull of a mesh or of points, whose surface need not be closed. Raises ConfigError."""
    if path.suffix.lower() in PLAIN:
        try:
            plain = _read(path, scale)
            small = SMALLEST <= plain.extents.max() <= LARGEST
            if small and not (missing_module() is None and loose_parts(Soup(plain.vertices, plain.faces)).max() > 0):
                return convex_hull(plain.vertices, str(path))
        except ConfigError:
            if missing_module() is not None:
                raise
    if missing_module() is not None:
        raise _unrepaired(path, None)
    points, said = hull_points(path, scale)
    if parent_process() is None:
        log.warning("%s", said)
    return convex_hull(points, str(path))


def convex_hull(points: Array, what: str) -> Mesh:
    """The convex hull of points (k, 3), m. Raises ConfigError for points in one plane."""
    spec = mujoco.MjSpec()
    spec.add_mesh(name="hull", uservert=np.asarray(points).ravel())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="hull")
    try:
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"{what}: no solid: {_first_line(error)}") from error
    return _oriented(_of_model(model))


def _read(path: Path, scale: float | None) -> Mesh:
    return _of_model(_compiled(path, scale))


def _compiled(path: Path, scale: float | None) -> mujoco.MjModel:
    check_file(path)
    if path.suffix.lower() == ".stl" and (found := miscounted(path.read_bytes())) is not None:
        raise ConfigError(
            f"{path}: not a readable mesh: header says {found[0]} triangles, it holds {found[1]}: {INSTALL} reads all"
        )
    _refuse_scan(path, _triangles(path))  # Before MuJoCo reads it, which takes its time.
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="it", scale=[1.0 if scale is None else scale] * 3)
    if _is_text(path):
        mesh.uservert = _corners(path).ravel()
        mesh.userface = np.arange(len(mesh.uservert) // 3)
    else:
        mesh.file = str(path.resolve())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # Of anything, also of what is not closed.
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="it", contype=0, conaffinity=0)
    try:
        model = spec.compile()
    except ValueError as error:
        raise ConfigError(f"{path}: not a readable mesh: {_first_line(error)}") from error
    _refuse_scan(path, int(model.mesh_facenum[0]))
    return model


def _triangles(path: Path) -> int:
    """How many a file says that it has, at least."""
    content = path.read_bytes()
    if path.suffix.lower() == ".obj":
        return content.count(b"\nf ")
    if _is_text(path):
        return content.lower().count(b"endfacet")
    stated = int.from_bytes(content[_HEAD - 4 : _HEAD], "little")
    return stated if len(content) == _HEAD + _FACE * stated else 0


def _is_text(path: Path) -> bool:
    """Whether an .stl file is of the format's ASCII kind. Both may begin with "solid"; only the size of a binary one
    follows from its number of triangles."""
    if path.suffix.lower() != ".stl":
        return False
    content = path.read_bytes()
    binary = len(content) == _HEAD + _FACE * int.from_bytes(content[_HEAD - 4 : _HEAD], "little")
    return not binary and content.lstrip()[:5].lower() == b"solid" and b"facet" in content.lower()


def _corners(path: Path) -> Array:
    """Corners of an ASCII .stl file: three rows a triangle, (3 m, 3), in the file's unit. Raises ConfigError."""
    words = path.read_bytes().lower().split()
    if b"endsolid" not in words:
        raise ConfigError(f"{path}: not a readable mesh: the file is cut short, for its `endsolid` is missing")
    at = [number for number, word in enumerate(words) if word == b"vertex"]
    try:
        found = np.array([[float(word) for word in words[k + 1 : k + 4]] for k in at])
    except ValueError as error:
        raise ConfigError(f"{path}: not a readable mesh: {error}") from error
    if not len(found) or len(found) != 3 * words.count(b"endfacet") or not np.isfinite(found).all():
        raise ConfigError(f"{path}: not a readable mesh: its facets are not of three finite vertices each")
    return found


def _refuse_scan(path: Path, triangles: int) -> None:
    if triangles > TRIANGLES:
        raise ConfigError(f"{path}: {triangles} triangles; at most {TRIANGLES}: decimate it, or {INSTALL} does")


def _of_model(model: mujoco.MjModel) -> Mesh:
    return _welded(*_as_in_file(model))


def _as_in_file(model: mujoco.MjModel) -> tuple[Array, Array]:
    """The only mesh of a compiled model, in the axes of its file, which MuJoCo turns into those of its inertia."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[0])
    vertices = model.mesh_vert.astype(np.float64) @ turn.reshape(3, 3).T + model.mesh_pos[0]
    return vertices, model.mesh_face.astype(np.int64)


def _welded(vertices: Array, faces: Array) -> Mesh:
    """Vertices at one place as one, faces without area left out, the middle of the bounding box at the origin."""
    size = float(np.ptp(vertices, axis=0).max()) or 1.0
    _, first, place = np.unique(np.round(vertices / size, 6), axis=0, return_index=True, return_inverse=True)
    faces = place.ravel()[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    kept = vertices[first]
    return Mesh(kept - (kept.min(axis=0) + kept.max(axis=0)) / 2.0, faces)


def _oriented(mesh: Mesh) -> Mesh:
    return mesh if mesh.volume >= 0.0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
