"""A concave solid as the convex pieces that collide: CoACD (Wei et al., ACM Trans. Graphics 41(4), 2022).

MuJoCo collides a mesh as its convex hull, which fills every hole and cavity.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import cache_folder
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.sim.objects import mesh_repair as fix
from allegro_twin.sim.objects.meshes import Mesh, convex_hull
from allegro_twin.sim.objects.remesh import Surface, sample

if TYPE_CHECKING:
    import manifold3d

T = TypeVar("T")
log = logging.getLogger(__name__)

CONVEX = 0.995
"""Share of its hull's volume from which a solid is taken as convex."""
TOLERANCE = 0.001
"""m that pieces may stand out of the surface."""
THRESHOLDS, MOST = (0.03, 0.015, 0.01), 40
"""Concavity that is allowed in a piece, CoACD's measure, from coarse to fine until the tolerance is met; and pieces at
most."""
CUT = 2_000
"""Triangles that are cut: what more a scan has is mostly noise, and its cuts take minutes. What the pieces are off is
measured on all of them."""
_SAMPLES, _FINEST = 30_000, 4e-4
"""Points at which a surface is measured, about, and m between them at least."""
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
        parts = tuple(Mesh(np.asarray(v), np.asarray(f, dtype=np.int64)) for v, f in found)
        if (apart := surface_excess(parts, mesh)) < least:
            best, least = parts, apart
        if least <= TOLERANCE or len(parts) >= MOST:  # Finer cuts would be as many.
            break
    if least > TOLERANCE:
        log.warning("%s: its %d pieces stand out of its surface by up to %.1f mm", what, len(best), least * 1000)
    _store(kept, best)
    return best


def _coarse(mesh: Mesh) -> Mesh:
    """Simplify a surface to at most CUT triangles, where it stays closed."""
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


def surface_excess(parts: Sequence[Mesh], mesh: Mesh) -> float:
    """How far the pieces stand out of the solid, m: the largest distance from its surface of what each has beyond it.

    What that is, boolean operations tell; of a surface that Manifold takes for no solid, a grid: then what is within
    its step of the surface, a millimetre or so, counts as outside."""
    soup = fix.Soup(mesh.vertices, mesh.faces)
    solid = fix.manifold_of(soup)
    excess = [_beyond(fix.Soup(piece.vertices, piece.faces), solid) for piece in parts]
    begin = np.cumsum([0, *(len(part.vertices) for part in excess)])
    faces = [part.faces + first for part, first in zip(excess, begin[:-1], strict=True)]
    beyond = fix.Soup(np.concatenate([part.vertices for part in excess]), np.concatenate(faces))
    if not len(beyond.faces):
        return 0.0
    there = np.concatenate([beyond.vertices, sample(beyond, _spacing(beyond))[1]])
    if solid is None:
        there = there[~fix.Filled(soup).holds(there)]
    return float(Surface(soup, _spacing(soup)).distance(there)[0].max(initial=0.0))


def _beyond(piece: fix.Soup, solid: manifold3d.Manifold | None) -> fix.Soup:
    """What a convex piece has beyond a solid; all of it where that is not known."""
    convex = fix.manifold_of(piece)
    return piece if solid is None or convex is None else fix.soup_of(convex - solid)


def _spacing(soup: fix.Soup) -> float:
    return max(_FINEST, float(np.sqrt(fix.areas(soup).sum() / _SAMPLES)))


def _key(mesh: Mesh) -> str:
    settings = (CONVEX, THRESHOLDS, MOST, TOLERANCE, CUT, _SAMPLES, _FINEST, _SEED, version("coacd"))
    return fingerprint(mesh.vertices, mesh.faces, settings, Path(__file__))


def _store(path: Path, parts: tuple[Mesh, ...]) -> None:
    arrays = {f"{kind}{k}": array for k, piece in enumerate(parts) for kind, array in zip("vf", piece, strict=True)}
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # Taken for its options.


def _load(path: Path) -> tuple[Mesh, ...]:
    with np.load(path) as kept:
        return tuple(Mesh(kept[f"v{k}"], kept[f"f{k}"]) for k in range(len(kept.files) // 2))
