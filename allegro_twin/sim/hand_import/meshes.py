"""Meshes of a URDF: found, and converted to OBJ where MuJoCo cannot read them (COLLADA, glTF, PLY, OFF)."""

from __future__ import annotations

import copy
import os
import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from allegro_twin.errors import ConfigError
from allegro_twin.types import Array

READABLE = (".obj", ".stl", ".msh")
"""Mesh formats that MuJoCo reads."""
CONVERTIBLE = (".dae", ".glb", ".gltf", ".ply", ".off")
"""Mesh formats that are converted to OBJ."""
INSTALL = "pip install 'allegro-twin[meshes]'"

_BROKEN = (ArithmeticError, AttributeError, LookupError, OSError, SyntaxError, TypeError, ValueError, struct.error)
# What the readers raise at a damaged file: each has its own, and none has one class for all.


class MeshError(ValueError):
    """A mesh that cannot be converted; the message says why, without the file's name."""


class MeshPiece(NamedTuple):
    """A part of a mesh in one colour."""

    vertices: Array
    """(n, 3), m before the URDF's `scale`, in the frame of the file."""
    faces: npt.NDArray[np.int64]
    """(m, 3), indices of vertices."""
    color: tuple[float, ...] | None
    """Red, green, blue, opacity in 0 … 1; None: the file does not say it."""


class UrdfMeshes:
    """The meshes that a URDF names: where they are, and those that MuJoCo cannot read as OBJ."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._converted: dict[tuple[Path, str], list[tuple[str, tuple[float, ...] | None]]] = {}
        self._files: list[str] = []
        self.assets: dict[str, bytes] = {}
        """What was converted: names and contents of OBJ files."""
        self.shown: set[str] = set()
        """Names of those for looking."""

    def find(self, robot: Element, notes: list[str]) -> None:
        """Name every mesh by its full path, or by its name in `assets`. Visual ones that cannot be had are left out.

        Raises ConfigError for one that touches and cannot be had.
        """
        left_out: dict[str, list[str]] = {}
        for link in robot.findall("link"):
            for kind in ("visual", "collision"):
                for element in link.findall(kind):
                    mesh = element.find("geometry/mesh")
                    if mesh is None:
                        continue
                    named = mesh.get("filename", "")
                    try:
                        self._place(link, element, mesh, self._file(named))
                    except MeshError as error:
                        if kind == "collision":
                            raise ConfigError(
                                f"{self._path}: link {link.get('name')}: collision mesh {named}: {error}"
                            ) from error
                        link.remove(element)
                        names = left_out.setdefault(str(error), [])
                        if named not in names:
                            names.append(named)
        if self._files:
            notes.append(f"meshes converted to OBJ, units and node transforms applied: {', '.join(self._files)}")
        for reason, names in left_out.items():
            notes.append(f"visual meshes left out: {', '.join(names)} ({reason})")

    def _place(self, link: Element, element: Element, mesh: Element, file: Path) -> None:
        """Let a visual or collision element name what MuJoCo reads: one for each piece of a converted mesh."""
        if file.suffix.lower() in READABLE:
            mesh.set("filename", str(file))
            return
        if file.suffix.lower() not in CONVERTIBLE:
            raise MeshError(f"no reader for {file.suffix or 'a file without a suffix'}; convert it to OBJ")
        place = list(link).index(element)
        parts = self._convert(file, element.tag)
        link.remove(element)
        for number, (name, color) in enumerate(parts):
            part = copy.deepcopy(element)
            part.find("geometry/mesh").set("filename", name)  # type: ignore[union-attr]  # It is `mesh`.
            if element.tag == "visual" and color is not None:  # As RViz: a mesh's own colour before the URDF's.
                for old in part.findall("material"):
                    part.remove(old)
                material = ElementTree.SubElement(part, "material", name=name)
                ElementTree.SubElement(material, "color", rgba=" ".join(f"{value:g}" for value in color))
            link.insert(place + number, part)

    def _convert(self, file: Path, kind: str) -> list[tuple[str, tuple[float, ...] | None]]:
        """Names in `assets` and colours of a mesh's pieces."""
        if (file, kind) not in self._converted:
            parts = read_parts(file)
            parts = parts_by_color(parts) if kind == "visual" else solid_parts(parts)
            names = []
            for number, piece in enumerate(parts):
                name = f"{file.stem}_{kind}_{number}.obj"
                while name in self.assets:
                    name = f"_{name}"
                self.assets[name] = obj_text(piece)
                names.append((name, piece.color))
            if kind == "visual":
                self.shown |= {name for name, _ in names}
            if file.name not in self._files:
                self._files.append(file.name)
            self._converted[file, kind] = names
        return self._converted[file, kind]

    def _file(self, name: str) -> Path:
        """A mesh beside the URDF, or, by `package://name/rest`, below a folder above it or in ROS_PACKAGE_PATH. Raises
        MeshError."""
        if not name.startswith("package://"):
            rest = Path(name.removeprefix("file://"))
            file = rest if rest.is_absolute() else self._path.resolve().parent / rest
            if not file.is_file():
                raise MeshError(f"no such file at {file.parent}; put it there, or correct its name")
            return file
        package, _, inner = name.removeprefix("package://").partition("/")
        above = list(self._path.resolve().parents)
        ros = [Path(each) for each in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if each]
        for folder in (*above, *ros):
            for candidate in (folder / package / inner, folder / inner):
                if candidate.is_file():
                    return candidate
        if any((folder / package).is_dir() or folder.name == package for folder in (*above, *ros)):
            raise MeshError(f"the package {package} has no {inner}; put it there, or correct its name")
        raise MeshError(f"no folder {package} above the URDF or in ROS_PACKAGE_PATH; put the URDF into its package")


def read_parts(file: Path) -> list[MeshPiece]:
    """The nodes of a mesh file, each in the file's own frame.

    As RViz and MoveIt read COLLADA: `unit meter` counts, `up_axis` does not. Coordinates of glTF are taken as they are.
    Raises MeshError.
    """
    try:
        import trimesh
    except ImportError as error:
        raise MeshError(f"{INSTALL} reads {file.suffix}") from error
    try:
        scene = trimesh.load_scene(file)
        found = [piece for node in scene.graph.nodes_geometry if (piece := _node_piece(scene, node)) is not None]
        unit = _collada_unit(file) if file.suffix.lower() == ".dae" else 1.0
    except ImportError as error:
        raise MeshError(f"{INSTALL} reads {file.suffix}: {error}") from error
    except _BROKEN as error:
        raise MeshError(f"not readable: {' '.join(str(error).split())[:100] or type(error).__name__}") from error
    if not found:
        raise MeshError("not readable: no triangles in it")
    return [piece._replace(vertices=piece.vertices * unit) for piece in found]


def obj_text(piece: MeshPiece) -> bytes:
    """A piece as a Wavefront OBJ."""
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in piece.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in piece.faces + 1]
    return ("\n".join(lines) + "\n").encode()


def _node_piece(scene: Any, node: str) -> MeshPiece | None:
    """One node, with the transforms from the root to it; None for lines and points."""
    transform, name = scene.graph[node]
    geometry = scene.geometry[name]
    faces = np.asarray(getattr(geometry, "faces", ()), dtype=np.int64)
    if not len(faces):
        return None
    matrix = np.asarray(transform, dtype=float)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        faces = faces[:, ::-1]  # A mirror turns the faces inside out.
    vertices = np.asarray(geometry.vertices, dtype=float) @ matrix[:3, :3].T + matrix[:3, 3]
    if not np.isfinite(vertices).all():
        raise MeshError("not readable: a vertex is not finite")
    return MeshPiece(vertices, faces, _color(geometry.visual))


def _color(visual: Any) -> tuple[float, ...] | None:
    """The colour of a mesh's material, with a texture's mean; or the mean of its own colours."""
    if not visual.defined or visual.kind is None:
        return None
    owner = visual.material if visual.kind == "texture" else visual
    main = getattr(owner, "main_color", None)
    color = np.ones(4) if main is None else np.resize(np.append(np.asarray(main, dtype=float).ravel() / 255.0, 1.0), 4)
    image = getattr(owner, "baseColorTexture", None) or getattr(owner, "image", None)
    if image is not None:
        color[:3] = np.asarray(image.convert("RGB").resize((1, 1)), dtype=float).ravel() / 255.0
    elif main is None:
        return None
    if color[3] == 0.0:
        color[3] = 1.0  # Exporters of COLLADA disagree about what 0 means; a mesh that nobody sees is none.
    return tuple(color.round(4).tolist())


def parts_by_color(parts: list[MeshPiece]) -> list[MeshPiece]:
    """For looking: what has one colour is one piece."""
    groups: dict[tuple[float, ...] | None, list[MeshPiece]] = {}
    for piece in parts:
        groups.setdefault(piece.color, []).append(piece)
    return [_join(group) for group in groups.values()]


def solid_parts(parts: list[MeshPiece]) -> list[MeshPiece]:
    """For contacts: each node, whose hull MuJoCo takes; all in one where a node is flat. Raises MeshError."""
    if any(map(_is_flat, parts)):
        parts = [_join(parts)]
    if _is_flat(parts[0]):
        raise MeshError("flat: it has no inside that could touch")
    return parts


def _is_flat(piece: MeshPiece) -> bool:
    """Whether all vertices lie in one plane: MuJoCo makes no hull of them."""
    if len(piece.vertices) < 4:
        return True
    spread = np.linalg.svd(piece.vertices - piece.vertices.mean(axis=0), compute_uv=False)
    return bool(spread[2] < 1e-6 * spread[0])


def _join(parts: list[MeshPiece]) -> MeshPiece:
    starts = np.cumsum([0, *(len(piece.vertices) for piece in parts)])
    faces = [piece.faces + start for piece, start in zip(parts, starts[:-1], strict=True)]
    return MeshPiece(np.concatenate([piece.vertices for piece in parts]), np.concatenate(faces), parts[0].color)


def _collada_unit(file: Path) -> float:
    """How long a unit of the file is, m."""
    for _, element in ElementTree.iterparse(file):
        name = element.tag.rpartition("}")[2]
        if name == "unit":
            return float(element.get("meter", 1.0))
        if name == "asset":
            break
    return 1.0
