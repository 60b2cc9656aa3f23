"""The command that repairs a scan, and the picture of a repair beside what other commands write."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import options

if TYPE_CHECKING:
    from allegro_twin.sim.objects.clean_mesh import CleanMesh

_UNITS = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
_LARGEST = 0.05
"""m: tolerances and walls beyond that are mm taken for m."""


def parse_length(text: str) -> float:
    """A length such as `2mm` or `0.002`, m. Raises ConfigError."""
    found = re.fullmatch(r"\s*(\d*\.?\d+(?:e-?\d+)?)\s*(m|cm|mm)?\s*", text)
    value = float(found.group(1)) * _UNITS[found.group(2) or ""] if found else 0.0
    if not 0.0 < value <= _LARGEST:
        raise ConfigError(f"{text!r} is no length of 0 to 5 cm, such as 2mm or 0.002; its unit is one of m, cm, mm")
    return value


def mesh(
    file: Annotated[Path, typer.Argument(help="A scan: STL, OBJ, PLY, OFF, glTF, or points: PLY, PCD, XYZ, NPY.")],
    out: Annotated[
        Path | None,
        typer.Option(help="OBJ file to write, in m, and a .png and a .json beside it; default: FILE_clean.obj here."),
    ] = None,
    scale: Annotated[
        float | None, typer.Option(help="Unit of the file, m; default: as its size says.", callback=options.positive)
    ] = None,
    tolerance: Annotated[
        str, typer.Option(help="Largest distance between the surfaces before and after, 2mm for example.")
    ] = "1mm",
    wall: Annotated[
        str | None, typer.Option(help="Take an open surface as a wall of this thickness, 2mm for example.")
    ] = None,
) -> None:
    """Repair a scan: a closed OBJ in m, pictures, and a report.

    `plan`, `new`, `run` and scenarios do the same with a scan that they are given."""
    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.sim.objects.clean_mesh import ScanSettings, clean_mesh
    from allegro_twin.surfaces.cli import console

    target = out or Path(f"{file.stem}_clean.obj")
    if target.suffix.lower() != ".obj" or target.resolve() == file.resolve():
        raise ConfigError(f"--out {target}: the result is an .obj beside the scan, never in its place")
    check_sidecars(target)
    settings = ScanSettings(scale, parse_length(tolerance), None if wall is None else parse_length(wall))
    try:
        made = clean_mesh(file, settings)
    except KeyboardInterrupt:
        console.warn(f"interrupted: {file} was not repaired to the end: nothing is written")
        raise
    target.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(target) as temporary:
        lines = [f"# {made.report.line()}", "# units: m"]
        lines += ["v {:.9g} {:.9g} {:.9g}".format(*row) for row in made.vertices.tolist()]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in made.faces.tolist()]
        temporary.write_text("\n".join([*lines, ""]), encoding="utf-8")
    write_report(made, file, target)
    console.console.print(made.report.line(), soft_wrap=True, highlight=False)
    beside = f"{target.stem}.png and {target.stem}.json"
    console.say(f"Wrote {target}, {beside}; try it: allegro-twin new {shlex.quote(str(target))}")


def check_sidecars(target: Path) -> None:
    """Raise ConfigError where the picture and the report beside a target would replace what is none of ours, such as
    the texture of a mesh."""
    text, picture = target.with_suffix(".json"), target.with_suffix(".png")
    try:
        ours = json.loads(text.read_text(encoding="utf-8")).keys() >= {"file", "deviation", "largest_hole"}
    except (OSError, ValueError, AttributeError):
        ours = False
    for path in () if ours else (picture, text):
        if path.exists():
            raise ConfigError(f"--out {target}: {path.name} beside it is none of this command's: choose another name")


def show_repair(file: Path | None, scale: float | None, folder: Path, *, hull: bool = False) -> list[Path]:
    """The picture and the report of the repair of a mesh, in a folder: none for a mesh that was taken as it is."""
    from allegro_twin.sim.objects.clean_mesh import ScanSettings, clean_mesh
    from allegro_twin.sim.objects.meshes import mesh_report

    if file is None or hull or mesh_report(file, scale) is None:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    return write_report(clean_mesh(file, ScanSettings(scale)), file, folder / f"{file.stem}_mesh.obj")


def write_report(made: CleanMesh, file: Path, target: Path) -> list[Path]:
    """A picture and a JSON file beside a target, of its name."""
    from dataclasses import asdict

    import numpy as np

    from allegro_twin.files.atomic_write import atomic_file
    from allegro_twin.sim.objects.mesh_repair import Soup, compact
    from allegro_twin.sim.objects.remesh import surface_samples
    from allegro_twin.sim.objects.scan_files import read_scan
    from allegro_twin.viewing.scan_picture import Pane, draw_scan

    report, scan = made.report, read_scan(file)
    picture, text = target.with_suffix(".png"), target.with_suffix(".json")
    fine = float(np.linalg.norm(report.extents)) / 400
    after = Soup(made.vertices, made.faces)
    title = f"after: {len(after.faces):,} triangles, {1e6 * report.volume[1]:.4g} cm3"
    if len(scan.faces):
        before = compact(Soup(scan.points * report.scale, scan.faces))
        words = f"before: {len(scan.faces):,} triangles (red: seen from inside)"
        draw_scan(Pane(words, *surface_samples(before, fine)), Pane(title, *surface_samples(after, fine)), picture)
    else:
        words = f"before: {len(scan.points):,} points"
        draw_scan(Pane(words, scan.points * report.scale, None), Pane(title, *surface_samples(after, fine)), picture)
    volumes = [each if np.isfinite(each) else None for each in report.volume]
    said = {**asdict(report), "file": file.name, "volume": volumes}
    with atomic_file(text) as temporary:
        temporary.write_text(json.dumps(said, indent=1, allow_nan=False), encoding="utf-8")
    return [picture, text]
