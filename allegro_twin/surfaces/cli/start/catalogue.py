"""Tables for `list`: what ships with the package, and what is in the user's library."""

from __future__ import annotations

from collections.abc import Callable

from rich.table import Table

from allegro_twin.files.assets import data_root, read_yaml
from allegro_twin.hands.library.entries import GraspFile, TrajectoryFile
from allegro_twin.hands.library.library import Library


def objects() -> Table:
    from allegro_twin.sim.objects.catalogue import object_catalogue

    table = _table("objects", "name", "shape", "size mm", "mass g")
    for name, grasp_object in object_catalogue().items():
        table.add_row(
            name,
            grasp_object.shape,
            " x ".join(f"{s * 1000:g}" for s in grasp_object.size),
            f"{grasp_object.mass * 1000:g}",
        )
    return table


def postures() -> Table:
    table = _table("postures", "name", "description")
    for listed in Library().list("posture"):
        table.add_row(listed.name, listed.entry.description)
    return table


def grasps() -> Table:
    table = _table("grasps", "name", "type", "taxonomy", "description")
    for listed in Library().list("grasp"):
        assert isinstance(listed.entry, GraspFile)
        kind = listed.entry.kind_of_grasp
        said = str(kind) if listed.entry.observed is not None else f"{kind} (claimed)"
        table.add_row(listed.name, kind.type or "", said, listed.entry.description)
    return table


def trajectories() -> Table:
    table = _table("trajectories", "name", "s", "description")
    for listed in Library().list("trajectory"):
        assert isinstance(listed.entry, TrajectoryFile)
        table.add_row(listed.name, f"{listed.entry.times[-1] - listed.entry.times[0]:g}", listed.entry.description)
    return table


def scenarios() -> Table:
    return _described("scenarios", "scenarios")


def configs() -> Table:
    table = _table("configs", "name", "backend", "task", "controller")
    for path in sorted((data_root() / "conf").glob("*.yaml")):
        content = read_yaml(path)
        if "camera" in content:  # The config of a cell.
            names = ", ".join(each["name"] for each in content["objects"])
            table.add_row(f"conf/{path.name}", "lab", names, "state machine")
            continue
        task = ", ".join(f"{key} {value}" for key, value in content.get("task", {}).items())
        table.add_row(f"conf/{path.name}", content["backend"]["kind"], task, content["controller"]["kind"])
    return table


def policies() -> Table:
    table = _table("policies", "name", "what it does")
    for path in sorted((data_root() / "conf" / "policies").glob("*.onnx")):
        paragraph = path.with_suffix(".md").read_text(encoding="utf-8").split("\n\n")[1]
        text = " ".join(paragraph.split())
        table.add_row(path.stem, text.removesuffix(" Observations and actions: docs/reference/environments.md."))
    return table


def recipes() -> Table:
    table = _table("recipes", "name", "task", "actions")
    for path in sorted(path for name in ("training", "pick") for path in (data_root() / "conf" / name).glob("*.yaml")):
        content = read_yaml(path)
        table.add_row(path.stem, content["task"], f"{content['steps']:,}" if "steps" in content else "")
    return table


def protocols() -> Table:
    table = _table("protocols", "name", "phases")
    for path in sorted((data_root() / "conf" / "protocols").glob("*.yaml")):
        table.add_row(path.stem, ", ".join(phase["name"] for phase in read_yaml(path)["phases"]))
    return table


def gains() -> Table:
    table = _table("gains", "name", "hand")
    for path in sorted((data_root() / "conf" / "gains").glob("*.yaml")):
        for name in read_yaml(path):
            table.add_row(name, path.stem)
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
    "trajectories": trajectories,
    "scenarios": scenarios,
    "configs": configs,
    "hands": hands,
    "policies": policies,
    "recipes": recipes,
    "protocols": protocols,
    "gains": gains,
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
