"""Tables of what ships with the package."""

from __future__ import annotations

from collections.abc import Callable

from rich.table import Table

from allegro_twin.files.assets import data_root, read_yaml


def objects() -> Table:
    from allegro_twin.sim.objects import catalogue

    table = _table("objects", "name", "shape", "size mm", "mass g")
    for name, thing in catalogue().items():
        table.add_row(name, thing.shape, " x ".join(f"{s * 1000:g}" for s in thing.size), f"{thing.mass * 1000:g}")
    return table


def postures() -> Table:
    return _described("postures", "conf/postures")


def grasps() -> Table:
    table = _table("grasps", "name", "type", "taxonomy", "what for")
    for path in sorted((data_root() / "conf" / "grasps").glob("*.yaml")):
        content = read_yaml(path)
        kind = content["taxonomy"]
        table.add_row(path.stem, kind["type"], f"{kind['number']} {kind['name']}", content.get("description", ""))
    return table


def scenarios() -> Table:
    return _described("scenarios", "scenarios")


def configs() -> Table:
    table = _table("configs", "name", "backend", "controller")
    for path in sorted((data_root() / "conf").glob("*.yaml")):
        content = read_yaml(path)
        table.add_row(f"conf/{path.name}", content["backend"]["kind"], content["controller"]["kind"])
    return table


def hands() -> Table:
    table = _table("hands", "name", "model")
    for path in sorted((data_root() / "conf" / "hands").glob("*.yaml")):
        table.add_row(path.stem, read_yaml(path).get("mjcf", "models/mjcf"))
    return table


KINDS: dict[str, Callable[[], Table]] = {
    "objects": objects,
    "postures": postures,
    "grasps": grasps,
    "scenarios": scenarios,
    "configs": configs,
    "hands": hands,
}


def _described(title: str, folder: str) -> Table:
    table = _table(title, "name", "description")
    for path in sorted((data_root() / folder).rglob("*.yaml")):
        table.add_row(path.stem, read_yaml(path).get("description", ""))
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for column in columns:
        table.add_column(column)
    return table
