"""A concave solid as the convex pieces that collide: CoACD (Wei et al., ACM Trans. Graphics 41(4), 2022).

MuJoCo collides a mesh as its convex hull, which fills every hole and cavity.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import cache_folder
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.sim.objects import mesh_repair as fix
from allegro_twin.sim.objects.meshes import Mesh, convex_hull
from allegro_twin.types import Array

T = TypeVar("T")
log = logging.getLogger(__name__)

CONVEX = 0.995
"""Of its hull's volume: a solid that fills so much is taken as convex."""
TOLERANCE = 0.001
"""m that pieces may stand out of the surface."""
THRESHOLDS, MOST = (0.03, 0.015, 0.01), 40
"""Concavity that is allowed in a piece, CoACD's measure, from coarse to fine until the tolerance is met; and pieces at
most."""
CUT = 2_000
"""Triangles that are cut: what more a scan has is mostly noise, and its cuts take minutes. What the pieces are off is
measured on all of them."""
_SAMPLES = 60_000
_SEED = 0


def convex_parts(mesh: Mesh, what: str) -> tuple[Mesh, ...]:
    """Convex pieces whose union is the solid, within TOLERANCE outside of it. Raises ConfigError where the extra is
    missing."""
    hull = convex_hull(mesh.vertices, what)
    if mesh.volume >= CONVEX * hull.volume:
        return (hull,)
    try:
        import coacd  # type: ignore[import-untyped]  # It has no types.
    except ImportError as error:
        raise ConfigError(
            f"{what} is concave: its hull has {100 * (hull.volume / mesh.volume - 1):.0f} % more volume. To collide "
            "as it is it needs pip install 'allegro-twin[objects]'; to collide as its hull say collision: hull"
        ) from error
    kept = cache_folder("pieces", f"how {what} is cut") / f"{_key(mesh)}.npz"
    if kept.is_file():
        return _load(kept)
    coacd.set_log_level("error")
    best: tuple[Mesh, ...] = (hull,)
    least, coarse = surface_excess(best, mesh), _coarse(mesh)
    for threshold in THRESHOLDS:
        cut = partial(
            coacd.run_coacd,
            coacd.Mesh(coarse.vertices, coarse.faces),
            threshold=threshold,
            preprocess_mode="off",  # The surface is closed, so it can be cut as it is.
            max_convex_hull=MOST,
            mcts_iterations=60,
            seed=_SEED,
        )
        found = _interruptible(cut)
        pieces = tuple(Mesh(np.asarray(v), np.asarray(f, dtype=np.int64)) for v, f in found)
        if (apart := surface_excess(pieces, mesh)) < least:
            best, least = pieces, apart
        if least <= TOLERANCE or len(pieces) >= MOST:  # Finer cuts would be as many.
            break
    if least > TOLERANCE:
        log.warning("%s: its %d pieces stand out of its surface by up to %.1f mm", what, len(best), least * 1000)
    _store(kept, best)
    return best


def _coarse(mesh: Mesh) -> Mesh:
    """The same surface with at most CUT triangles, where it stays closed."""
    if len(mesh.faces) <= CUT:
        return mesh
    fewer = fix.decimate_closed(fix.Soup(mesh.vertices, mesh.faces), CUT)
    return mesh if fewer is None else Mesh(fewer.vertices, fewer.faces)


def _interruptible(call: Callable[[], T]) -> T:
    """Its result. Meanwhile this thread hears signals: compiled code would not."""
    done: list[T] = []
    failed: list[Exception] = []

    def run() -> None:
        try:
            done.append(call())
        except Exception as error:  # noqa: BLE001  # Raised where the result is waited for.
            failed.append(error)

    thread = threading.Thread(target=run, name="cutting", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.2)
    if failed:
        raise failed[0]
    return done[0]


def surface_excess(pieces: tuple[Mesh, ...], mesh: Mesh) -> float:
    """How far the pieces stand out of the solid, m, from samples of both surfaces."""
    from scipy.spatial import cKDTree  # type: ignore[import-untyped]  # Its types are a package of their own.

    points, normals = _sampled(mesh, _SAMPLES)
    tree = cKDTree(points)
    worst = 0.0
    for piece in pieces:
        there, _ = _sampled(piece, _SAMPLES // len(pieces) + 200)
        distance, nearest = tree.query(there)
        outside = np.einsum("ij,ij->i", there - points[nearest], normals[nearest]) > 0.3 * distance
        worst = max(worst, float(distance[outside].max(initial=0.0)))
    return worst


def _sampled(mesh: Mesh, count: int) -> tuple[Array, Array]:
    """Points on a surface and its normals there, evenly by area."""
    rng = np.random.default_rng(_SEED)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    rows = rng.choice(len(area), size=count, p=area / area.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), size=count)
    points = np.einsum("ki,kij->kj", weights, np.stack([a, b, c], axis=1)[rows])
    return points, normal[rows] / area[rows, None]


def _key(mesh: Mesh) -> str:
    settings = (CONVEX, THRESHOLDS, MOST, TOLERANCE, CUT, _SAMPLES, _SEED, version("coacd"))
    return fingerprint(mesh.vertices, mesh.faces, settings, Path(__file__))


def _store(path: Path, pieces: tuple[Mesh, ...]) -> None:
    arrays = {f"{kind}{k}": array for k, piece in enumerate(pieces) for kind, array in zip("vf", piece, strict=True)}
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # Taken for its options.


def _load(path: Path) -> tuple[Mesh, ...]:
    with np.load(path) as kept:
        return tuple(Mesh(kept[f"v{k}"], kept[f"f{k}"]) for k in range(len(kept.files) // 2))
