"""Triangles and points from the files of scanners: STL, OBJ, PLY, OFF, glTF, PCD, XYZ and NumPy arrays."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError

Numbers: TypeAlias = NDArray[Any]
"""Places (float64), indices (int64) or masks (bool)."""
MESHES = (".obj", ".stl", ".ply", ".off", ".glb", ".gltf")
CLOUDS = (".pcd", ".xyz", ".pts", ".npy", ".npz")
"""Suffixes of files that hold points only. A .ply file without faces does too."""
INSTALL = "pip install 'allegro-twin[objects]'"
EXTRA = ("fast_simplification", "manifold3d", "platformdirs", "scipy", "skimage", "trimesh")
"""What repairs meshes."""

UNITS = {"m": 1.0, "mm": 0.001, "cm": 0.01, "inch": 0.0254, "dm": 0.1, "ft": 0.3048, "um": 1e-6}
"""Names of units, in m."""
_WORDS = {"mm": "mm", "millimeter": "mm", "millimetre": "mm", "cm": "cm", "centimeter": "cm", "centimetre": "cm",
          "inch": "inch", "inche": "inch", "m": "m", "meter": "m", "metre": "m"}  # fmt: skip
"""In a file or its name."""
_MORE = {"in": "inch", "dm": "dm", "decimeter": "dm", "decimetre": "dm", "ft": "ft", "foot": "ft", "feet": "ft",
         "um": "um", "µm": "um", "μm": "um", "micron": "um", "micrometer": "um", "micrometre": "um"}  # fmt: skip
"""In a file alone: a name may be that of a scan of a foot."""
_NO_UNIT = ("arbitrary", "default", "generic", "none", "undefined", "unitless", "unknown", "unspecified", "unset")
_STATED = (r"\bunits?(?:[ _]?(?:system|name|length))?\b\s*[:=]+\s*[\"']?(?:1(?:\.0*)?\s*)?([^\W_][^\s\"',;]*)",
           r"\bunits?\b\W{0,4}(?:(?:is|are)\b\W{0,2})?(?:in\b[ \t]{1,2}(?=[a-zµμ]))?([a-zµμ]+)\b")  # fmt: skip
"""How files state a unit: after a sign, where any word is meant as one, and in other ways."""
LARGEST, SMALLEST = 1.0, 0.002
"""m; an object beyond these is no object for a hand, and its file has another unit."""
LARGE = 0.6
"""m; one that is larger needs its unit said."""
_GUESSED = ("mm", "cm", "inch")
"""Units that files of things for a hand have without naming them."""
_USUAL, _CHOICES = (0.015, 0.3), (0.005, LARGE)
"""m: the longest edges of usual things for a hand, and of all: a unit goes without saying where it alone gives a usual
one, or, where none does, any."""
_HEAD, _FACE = 84, 50
"""Bytes of a binary .stl: 80 of anything and the number of its triangles, and for each of them."""
_POLYGON = 5
"""Corners from which on a polygon may be concave, and is triangulated as one."""
_BROKEN = (ArithmeticError, AttributeError, LookupError, OSError, SyntaxError, TypeError, ValueError, EOFError,
           BadZipFile, struct.error, zlib.error)  # fmt: skip
# What the readers raise at a damaged file: each has its own, and none has one class for all.


class Scan(NamedTuple):
    """A file as it is."""

    points: Numbers
    """(k, 3), in the file's unit and axes; NaN where it has none."""
    faces: Numbers
    """(m, 3), indices; empty for a cloud."""
    normals: Numbers | None
    """(k, 3), of a cloud that has them."""
    unit: str | None
    """One of UNITS where the file or its name says it."""
    notes: tuple[str, ...] = ()
    """What was odd about the file, in words."""


def missing_module() -> str | None:
    """Name of the first module for mesh repair that is not installed; None: all are."""
    return next((name for name in EXTRA if find_spec(name) is None), None)


def read_scan(path: Path) -> Scan:
    """The content of a file, nothing repaired. Raises ConfigError for what is not readable, in a line."""
    check_file(path)
    named = path.suffix.lower()
    if named not in (*MESHES, *CLOUDS):
        raise unread_kind(path)
    kind, notes = _true_kind(path) or named, []
    if kind != named:
        notes.append(f"read as {kind}, which it is, not {named}")
    if kind == ".stl" and (found := miscounted(path.read_bytes())) is not None:
        notes.append(f"header says {found[0]:,} triangles, the file holds {found[1]:,}: read all")
    try:
        points, faces, normals = _READERS[kind](path) if kind in _READERS else _by_trimesh(path, kind)
    except _BROKEN as error:
        text = str(error).strip().splitlines()
        raise ConfigError(f"{path}: not a readable mesh: {text[0] if text else type(error).__name__}") from error
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if not np.isfinite(points).all(axis=1).any():
        raise ConfigError(f"{path}: not a readable mesh: it holds no points")
    return Scan(points, faces, normals, "m" if kind == ".glb" else stated_unit(path), tuple(notes))


def check_file(path: Path) -> None:
    """Raises ConfigError, in a line that says what it is, for what is no file with a mesh."""
    if re.match(r"[a-z][a-z0-9+]+:/", str(path)):
        raise ConfigError(f"{path}: is an address: download it first, then name the file")
    if path.is_dir():
        raise ConfigError(f"{path}: is a folder: name a file in it")
    if not path.is_file():
        raise ConfigError(f"no mesh at {path}")
    try:
        with path.open("rb") as file:
            head = file.read(512).lstrip()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    if not head and not path.stat().st_size:
        raise ConfigError(f"{path}: is empty: copy or download it again")
    if head.startswith(b"version https://git-lfs"):
        raise ConfigError(f"{path}: is a Git LFS pointer, not the mesh: git lfs pull")
    if re.match(rb"(?i)(<!doctype html|<html|<head)", head):
        raise ConfigError(f"{path}: is a web page, not a mesh: download the file itself")
    if head.startswith(b"\x1f\x8b") or (head.startswith(b"PK\x03\x04") and path.suffix.lower() in MESHES):
        raise ConfigError(f"{path}: is an archive: unpack it first")


_SIGNS = {rb"ply\s": ".ply", rb"glTF": ".glb", rb"\x93NUMPY": ".npy", rb"(ST|C|N|4|n)*OFF\s": ".off",
          rb"(#\s*\.PCD|VERSION\s+0?\.\d|FIELDS\s+x)": ".pcd"}  # fmt: skip
"""How files of a kind begin."""


def _true_kind(path: Path) -> str | None:
    """The suffix of what a file holds; None where that is open."""
    content, named = path.read_bytes(), path.suffix.lower()
    if is_text_stl(content):
        return ".stl"
    if len(content) > _HEAD and len(content) == _HEAD + _FACE * _stated_count(content):
        return ".stl"
    found = next((kind for sign, kind in _SIGNS.items() if re.match(sign, content.lstrip()[:64])), None)
    if found is None and named != ".obj" and named in MESHES:
        obj = all(re.search(sign, content) for sign in (rb"(?m)^v[ \t]+[-+.\d]", rb"(?m)^f[ \t]+-?\d"))
        return ".obj" if obj else None
    return found


def unread_kind(path: Path) -> ConfigError:
    """What is said of a file that is neither a mesh nor points."""
    kinds = f"a mesh is {', '.join(MESHES)}; a cloud of points {', '.join(CLOUDS)} or .ply"
    return ConfigError(f"{path}: {kinds}; export it as STL")


def stated_unit(path: Path) -> str | None:
    """The unit in a file's comments, such as `units: mm`, or in its name, such as `mug_mm.stl`; after a number it is
    that of a size, as in `cube_5_cm.stl`. Raises ConfigError for a stated one that is not known."""
    if path.suffix.lower() in (".glb", ".gltf"):
        return "m"
    return _unit_inside(path) or _unit_in_name(path)


def _unit_inside(path: Path) -> str | None:
    """The unit in a file's comments. Raises ConfigError for a stated one that is not known."""
    with path.open("rb") as file:
        head = file.read(4096).decode("utf-8", "ignore").lower()
    known = _WORDS | _MORE
    for sure, pattern in zip((True, False), _STATED, strict=True):
        for found in re.finditer(pattern, head):
            word = found.group(1).rstrip(".)")
            name = known.get(word, known.get(word.rstrip("s")))
            if name is not None:
                return name
            if sure and word not in _NO_UNIT and word.isascii() and word.isprintable():
                raise ConfigError(
                    f"{path}: its unit, {word!r}, is none of {', '.join(UNITS)}: say it in m, --scale 0.001 for mm"
                )
    return None


def _unit_in_name(path: Path) -> str | None:
    """The unit in a file's name, but for one after a number."""
    words = re.findall(r"[a-z]+|\d+", path.stem.lower())
    for before, word in zip(["", *words], words, strict=False):
        word = word.rstrip("s")
        if len(word) > 1 and word in _WORDS and not before.isdigit():
            return _WORDS[word]
    return None


def _ends_in_unit(path: Path) -> bool:
    """Whether the last word of a file's name is a unit: it is said of the file, and of no part's size."""
    return re.findall(r"[a-z]+|\d+", path.stem.lower())[-1].rstrip("s") in _WORDS


Content = tuple[Numbers, Numbers, Numbers | None]
_NONE: Numbers = np.empty((0, 3), dtype=np.int64)


def is_text_stl(content: bytes) -> bool:
    """Whether an .stl file is of the format's ASCII kind. Both may begin with "solid"; only the size of a binary one
    follows from its number of triangles."""
    binary = len(content) == _HEAD + _FACE * _stated_count(content)
    return not binary and content.lstrip()[:5].lower() == b"solid" and b"facet" in content[:4096].lower()


def _stated_count(content: bytes) -> int:
    """Triangles that a binary .stl file says that it has."""
    return int.from_bytes(content[_HEAD - 4 : _HEAD], "little")


def miscounted(content: bytes) -> tuple[int, int] | None:
    """Triangle counts of a binary .stl file, by its header and by its content, where the content is whole and the
    header is wrong; None for others."""
    stated, (there, rest) = _stated_count(content), divmod(len(content) - _HEAD, _FACE)
    if there < 1 or stated == there or (stated > there and rest) or is_text_stl(content):
        return None
    corners = _rows(content, there)
    size = np.abs(corners[: 3 * stated]).max(initial=0.0)  # What follows may be no triangles, but colours.
    more = corners[3 * stated :]
    fits = np.isfinite(more).all() and (not size > 0 or not len(more) or np.abs(more).max() < 100 * size)
    return (stated, there) if fits else None


def _stl(path: Path) -> Content:
    content = path.read_bytes()
    corners = _text_corners(content) if is_text_stl(content) else _binary_corners(content)
    return corners, np.arange(len(corners)).reshape(-1, 3), None


def _binary_corners(content: bytes) -> Numbers:
    count = _stated_count(content)
    if (found := miscounted(content)) is not None:
        count = found[1]
    if count == 0 or len(content) < _HEAD + _FACE * count:
        if content[:5].lower() == b"solid" or content.isascii():
            raise ValueError("it is text, and not that of an .stl file: it has no facets")
        there = max(0, len(content) - _HEAD) // _FACE
        raise ValueError(f"the file is cut short: it has {there} of {count} triangles")
    return _rows(content, count)


def _rows(content: bytes, count: int) -> Numbers:
    """Three rows a triangle, (3 m, 3)."""
    rows = np.frombuffer(content, np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]), count, _HEAD)
    corners: Numbers = rows["v"].astype(np.float64).reshape(-1, 3)
    return corners


def _text_corners(content: bytes) -> Numbers:
    """Three rows a triangle, (3 m, 3)."""
    content = content.lower()
    if b"endsolid" not in content:
        raise ValueError("the file is cut short, for its `endsolid` is missing")
    content = re.sub(rb"(?m)^[ \t]*(end)?solid[^\r\n]*", b"", content)
    content = re.sub(rb"(#|;|//)[^\r\n]*", b"", content)
    count = content.count(b"endfacet")
    for word in (b"endfacet", b"endloop", b"facet", b"normal", b"outer", b"loop", b"vertex"):
        content = content.replace(word, b"")
    lines = content.split(b"\n")
    numbers = _numbers(lines, range(1, len(lines) + 1))
    if len(numbers) != 12 * count or not count:
        raise ValueError("its facets are not of three vertices each")
    corners: Numbers = numbers.reshape(-1, 4, 3)[:, 1:].reshape(-1, 3)
    return corners


def _numbers(lines: Sequence[bytes], at: Sequence[int]) -> Numbers:
    """All numbers of lines; `at`: where each is in the file. Raises ValueError that names the first that is none."""
    words = b"\n".join(lines).split()
    try:
        return np.array(words, dtype="S").astype(np.float64) if words else np.empty(0)
    except ValueError:
        for number, line in zip(at, lines, strict=True):
            for word in line.split():
                _check_number(word, number)
        raise


def _check_number(word: bytes, number: int) -> None:
    try:
        float(word)
    except ValueError:
        text = word.decode("utf-8", "replace")
        comma = "; decimals need a point" if re.fullmatch(r"[-+]?\d*,\d+(e[-+]?\d+)?", text.lower()) else ""
        raise ValueError(f"line {number}: {text[:40]!r} is no number{comma}") from None


def _table(lines: Sequence[bytes], at: Sequence[int]) -> Numbers:
    """Rows of as many numbers each. Raises ValueError that names the first line with another count."""
    widths = np.array([len(line.split()) for line in lines])
    usual = int(np.bincount(widths).argmax())
    if (odd := np.flatnonzero(widths != usual)).size:
        line = at[int(odd[0])]
        raise ValueError(f"line {line} has {widths[odd[0]]} numbers, most lines have {usual}: make them the same")
    return _numbers(lines, at).reshape(len(lines), -1)


def _obj(path: Path) -> Content:
    content = path.read_bytes().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    places, polygons, before = [], [], []
    lines: tuple[list[int], list[int]] = ([], [])
    for number, line in enumerate(content.splitlines(), 1):
        line = line.lstrip()
        if line.startswith((b"v ", b"v\t")):
            places.append(line[2:].partition(b"#")[0])
            lines[0].append(number)
        elif line.startswith((b"f ", b"f\t")):
            polygons.append(line[2:].partition(b"#")[0])
            lines[1].append(number)
            before.append(len(places))
    if not places:
        raise ValueError("it holds no vertices")
    numbers, width = _numbers(places, lines[0]), len(places[0].split())
    if len(numbers) == width * len(places) and width >= 3:
        points = numbers.reshape(-1, width)[:, :3]
    else:
        points = _table([b" ".join(line.split()[:3]) for line in places], lines[0])
    if points.shape[1] < 3:
        raise ValueError(f"line {lines[0][0]} has {points.shape[1]} numbers, a vertex has three")
    if any(b"/" in line for line in polygons):
        polygons = [re.sub(rb"/[^\s]*", b"", line) for line in polygons]
    counts = np.array([len(line.split()) for line in polygons], dtype=np.int64)
    indices = _numbers(polygons, lines[1]).astype(np.int64)
    indices = np.where(indices < 0, indices + np.repeat(np.array(before, dtype=np.int64), counts), indices - 1)
    return points, triangulate(points, indices, counts), None


def triangulate(points: Numbers, indices: Numbers, counts: Numbers) -> Numbers:
    """Triangles (m, 3) of polygons that stand one after another in `indices`, with `counts` corners each."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64) if len(counts) else counts
    found = []
    for corners in np.unique(counts[counts >= 3]):
        rows = indices[starts[counts == corners][:, None] + np.arange(corners)]
        if corners < _POLYGON:
            found += [rows[:, [0, k, k + 1]] for k in range(1, corners - 1)]
        else:
            found += [fill_polygon(points, row) for row in rows]
    return np.concatenate(found) if found else _NONE


def fill_polygon(points: Numbers, row: Numbers) -> Numbers:
    """Triangles of one polygon, (n - 2, 3), seen from where its corners run counter-clockwise: by ears in the plane
    that fits it best, else as a fan."""
    fan = np.stack([np.full(len(row) - 2, row[0]), row[1:-1], row[2:]], axis=1)
    if len(row) <= 3 or not np.isfinite(points[row]).all():
        return fan
    around = points[row] - points[row].mean(axis=0)
    normal = np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)
    if not np.linalg.norm(normal) > 1e-12 * np.ptp(around, axis=0).max() ** 2:
        return fan
    normal /= np.linalg.norm(normal)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    try:
        import manifold3d
    except ImportError:
        return fan
    flat = np.stack([around @ first, around @ np.cross(normal, first)], axis=1)
    ears = np.asarray(manifold3d.triangulate([flat / np.abs(flat).max()], -1.0, True), dtype=np.int64)
    return row[ears] if len(ears) == len(row) - 2 else fan


def _by_trimesh(path: Path, kind: str) -> Content:
    """PLY, OFF and glTF."""
    try:
        import trimesh
    except ImportError as error:
        raise ConfigError(f"{path}: to read {path.suffix}: {INSTALL}") from error
    with path.open("rb") as file:
        source: Any = str(path) if kind == path.suffix.lower() else file
        scene = trimesh.load_scene(source, file_type=kind[1:], process=False, skip_materials=True)
    places, faces, normals, offset = [], [], [], 0
    for node in scene.graph.nodes_geometry:
        turn, name = scene.graph[node]
        shape = scene.geometry[name]
        there = np.asarray(shape.vertices, dtype=np.float64).reshape(-1, 3)
        places.append(there @ turn[:3, :3].T + turn[:3, 3])
        own = np.asarray(getattr(shape, "faces", _NONE), dtype=np.int64).reshape(-1, 3)
        faces.append((own if np.linalg.det(turn[:3, :3]) > 0 else own[:, ::-1]) + offset)
        normals.append(_ply_normals(shape.metadata))
        offset += len(there)
    if not places:
        raise ValueError("it holds no mesh")
    alone = len(normals) == 1 and normals[0] is not None and len(normals[0]) == offset
    return np.concatenate(places), np.concatenate(faces), normals[0] if alone else None


def _ply_normals(metadata: dict[str, Any]) -> Numbers | None:
    try:
        rows = metadata["_ply_raw"]["vertex"]["data"]
        found: Numbers = np.stack(
            [np.asarray(rows[name], dtype=np.float64).ravel() for name in ("nx", "ny", "nz")], axis=1
        )
    except (KeyError, ValueError, IndexError):
        return None
    return found


def _columns(table: Numbers) -> Content:
    """Points, and normals where three columns of length 1 follow."""
    if table.ndim != 2 or table.shape[1] < 3:
        raise ValueError(f"points are rows of three numbers or more, not an array of {table.shape}")
    points = table[:, :3].astype(np.float64)
    for at in (3, 6):
        rest = table[:, at : at + 3].astype(np.float64)
        if rest.shape[1] == 3 and np.abs(np.linalg.norm(rest[np.isfinite(rest).all(axis=1)], axis=1) - 1).mean() < 0.01:
            return points, _NONE, rest
    return points, _NONE, None


def _numpy(path: Path) -> Content:
    found = np.load(path, allow_pickle=False)
    if not isinstance(found, np.ndarray):
        arrays = {name.lower(): found[name] for name in found.files}
        points = next((arrays[name] for name in ("points", "xyz", "pts", "vertices") if name in arrays), None)
        points = next(iter(arrays.values())) if points is None else points
        faces, normals = arrays.get("faces", _NONE), arrays.get("normals")
        whole, _, own = _columns(points.reshape(-1, points.shape[-1]))
        return whole, faces, own if normals is None else normals.reshape(-1, 3).astype(np.float64)
    if found.dtype.names:
        found = np.stack([found[name] for name in found.dtype.names], axis=-1)
    return _columns(found.reshape(-1, found.shape[-1]) if found.ndim > 2 else found)


def _text_points(path: Path) -> Content:
    rows: list[bytes] = []
    at: list[int] = []
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        line = line.partition(b"#")[0].replace(b";", b" ").strip()
        if b"," in line:
            words = line.split()
            if len(words) >= 3 and all(re.fullmatch(rb"[-+]?\d*,\d+", word) for word in words[:3]):
                raise ValueError(f"line {number}: {words[0].decode()!r} is no number; decimals need a point")
            line = line.replace(b",", b" ").strip()
        if line and line[:1] in b"+-.0123456789n" and len(line.split()) >= 3:
            rows.append(line)
            at.append(number)
    if not rows:
        raise ValueError("it has no lines of three numbers")
    return _columns(_table(rows, at))


def _pcd(path: Path) -> Content:
    content = path.read_bytes()
    head, at = {}, 0
    while "data" not in head:
        end = content.index(b"\n", at)
        key, *values = content[at:end].decode("latin-1").split() or ["#"]
        head[key.lower()], at = values, end + 1
    counts = [int(each) for each in head.get("count", ["1"] * len(head["fields"]))]
    kinds = [f"<{kind.lower()}{size}" for kind, size in zip(head["type"], head["size"], strict=True)]
    names = [f"{name}{k}" if name == "_" else name for k, name in enumerate(head["fields"])]
    count, how = int(head["points"][0]), head["data"][0].lower()
    wanted: list[str] = [name for name in ["x", "y", "z", "normal_x", "normal_y", "normal_z"] if name in names]
    if how == "ascii":
        lines = content[at:].split(b"\n")
        first = content[:at].count(b"\n") + 1
        table = _numbers(lines, range(first, first + len(lines))).reshape(count, -1)
        starts = np.cumsum([0, *counts])
        columns = {name: table[:, starts[names.index(name)]] for name in wanted}
    elif how == "binary":
        rows = np.frombuffer(content, np.dtype([(n, k, (c,)) for n, k, c in zip(names, kinds, counts, strict=True)]),
                             count, at)  # fmt: skip
        columns = {name: rows[name][:, 0] for name in wanted}
    elif how == "binary_compressed":
        packed, size = (int.from_bytes(content[at + k : at + k + 4], "little") for k in (0, 4))
        plain, columns, start = _unpack_lzf(content[at + 8 : at + 8 + packed], size), {}, 0
        for name, kind, each in zip(names, kinds, counts, strict=True):
            columns[name] = np.frombuffer(plain, kind, count * each, start).reshape(count, each)[:, 0]
            start += count * each * np.dtype(kind).itemsize
    else:
        raise ValueError(f"DATA {how} is none of ascii, binary, binary_compressed")
    return _columns(np.stack([np.asarray(columns[name], dtype=np.float64) for name in wanted], axis=1))


def _unpack_lzf(data: bytes, size: int) -> bytes:
    """LZF: literal runs of up to 32 bytes, and references to what came before."""
    out, at = bytearray(), 0
    while at < len(data):
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at]
            at += 1
        start = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        length += 2
        while length > 0:  # A reference may overlap what it makes.
            part = out[start : start + length]
            out += part
            start, length = start + len(part), length - len(part)
    if len(out) != size:
        raise ValueError("its compressed data are cut short")
    return bytes(out)


_READERS = {".stl": _stl, ".obj": _obj, ".pcd": _pcd, ".xyz": _text_points, ".pts": _text_points, ".npy": _numpy,
            ".npz": _numpy}  # fmt: skip


def find_unit(path: Path, scan: Scan, scale: float | None, points: Numbers) -> tuple[str, float]:
    """How a file's numbers are understood, in words, and the unit, m: as `scale` says; None: as the file or its size
    says. Raises ConfigError for what could be several."""
    size = float(np.ptp(points, axis=0).max())
    in_metres = path.suffix.lower() in (".glb", ".gltf")
    if scale is not None:
        own = f"units of {scale:g} m"
        unit, name = scale, f"{next((name for name, each in UNITS.items() if each == scale), own)}, as said"
    elif scan.unit is not None and (scan.unit != "m" or in_metres or LARGE < size <= LARGEST):
        named = not in_metres and _unit_inside(path) is None
        if named and (scan.unit == "inch" or not _ends_in_unit(path)):
            _check_name(path, scan.unit, size)
        origin = "format" if in_metres else "name" if named else "file"
        unit, name = UNITS[scan.unit], f"{scan.unit}, by its {origin}"
    elif size <= LARGE:
        unit, name = 1.0, "m"
    else:
        name = _likely_unit(path, size)
        unit, name = UNITS[name], f"{name}, by its size"
    if not SMALLEST <= size * unit <= LARGEST:
        raise ConfigError(
            f"{path}: {size * unit:.3g} m across in {name}; a hand holds {SMALLEST:g} to {LARGEST:g} m: say its unit, "
            f"--scale 0.001 for mm (`scale: 0.001` in a scenario), 0.01 for cm, 0.0254 for inches"
        )
    return name, unit


def _check_name(path: Path, named: str, size: float) -> None:
    """Raise ConfigError for a unit in a file's name which makes of its numbers no usual thing for a hand, while another
    unit does: `half_inch_nut` is in mm."""
    low, high = _USUAL
    usual = [name for name in _GUESSED if low <= size * UNITS[name] <= high]
    if usual and not low <= size * UNITS[named] <= high:
        others = " or ".join(
            f"{1000 * size * UNITS[name]:.3g} mm in {name} (--scale {UNITS[name]:g})" for name in usual
        )
        raise ConfigError(
            f"{path}: {1000 * size * UNITS[named]:.3g} mm across in {named}, which its name says, and {others}: say "
            f"which, --scale {UNITS[named]:g} for {named} (`scale: {UNITS[named]:g}` in a scenario)"
        )


def _likely_unit(path: Path, size: float) -> str:
    """The only unit in which something so large, in a file's numbers, is for a hand."""
    usual, could = (
        [name for name in _GUESSED if low <= size * UNITS[name] <= high] for low, high in (_USUAL, _CHOICES)
    )
    possible = usual or could
    if len(possible) == 1 and size > LARGEST:  # What is smaller could be in m.
        return possible[0]
    possible = possible if len(possible) > 1 else could
    choices = " or ".join(f"{1000 * size * UNITS[name]:.{0 if size * UNITS[name] > 0.02 else 1}f} mm if it is in "
                          f"{name} (--scale {UNITS[name]:g})" for name in possible or ["mm"])  # fmt: skip
    metres = ", or write `# units: m` into it" if size <= LARGEST and path.suffix.lower() == ".obj" else ""
    raise ConfigError(
        f"{path}: {size:.3g} across, in a unit that it does not name: {choices}; `scale:` in a scenario{metres}"
    )
