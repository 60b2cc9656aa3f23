"""The tree keeps its shape: imports point down, each library has one home, no file names a registry or a machine."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from allegro_twin import _lazy

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "allegro_twin"
# docs/design.md#layers. A module may import from lower layers and from its own folder.
LAYERS = [
    {"_lazy", "errors", "types", "version"},
    {"array_api", "spec"},
    {"backend", "controller", "plugin_faults"},
    {"device", "loop", "safety", "files"},
    {"sweep"},
    {"control", "kinematics"},
    {"hands"},
    {"plugins", "testing"},
    {"recording", "sim"},
    {"viewing", "drivers"},
    {"grasping"},
    {"learning", "cell"},
    {"pick"},
    {"app"},
    {"gym", "twin"},
    {"surfaces"},
]
HOMES = {
    "can": {"drivers/can"},
    "cyclonedds": {"surfaces/ros"},
    "dynamixel_sdk": {"drivers/dynamixel"},
    "serial": {"drivers"},
    "rospy": {"surfaces/ros"},
    "rosbags": {"recording", "surfaces/ros"},
    "mujoco": {"sim", "viewing", "cell/camera"},
    "mujoco_warp": {"sim/batch"},
    "warp": {"sim/batch"},
    "mink": {"sim/contact"},
    "daqp": {"grasping/metrics", "sim/contact"},
    "pinocchio": {"kinematics"},
    "pyarrow": {"recording", "sweep"},
    "ray": {"sweep"},
    "h5py": {"recording/exchange"},
    "rerun": {"viewing"},
    "yaml": {"files"},
    "ruamel": {"files"},
    "ruckig": {"control"},
    "gymnasium": {"gym", "learning", "pick"},
    "onnx": {"learning"},
    "onnxruntime": {"learning/policy"},
    "stable_baselines3": {"learning"},
    "rsl_rl": {"learning/training"},
    "tensordict": {"learning/training"},
    "torch": {"array_api", "sim/batch", "learning"},
    "av": {"viewing"},
    "coacd": {"sim/objects"},
    "fast_simplification": {"sim/objects"},
    "manifold3d": {"sim/objects"},
    "skimage": {"sim/objects"},
    "trimesh": {"sim/hand_import", "sim/objects"},
    "platformdirs": {"files"},
    "scipy": {"sim", "grasping", "twin/identify", "cell/perception"},
    "PIL": {"viewing", "surfaces/cli"},
    "viser": {"surfaces/panel"},
    "dex_retargeting": {"surfaces/teleop"},
    "mediapipe": {"surfaces/teleop"},
    "pyrealsense2": {"drivers/realsense"},
    "pylibfranka": {"drivers/franka"},
    "cv2": {"surfaces/teleop", "cell/calibration"},
    "rich": {"surfaces/cli"},
    "typer": {"surfaces/cli"},
}
"""Folders of the package, or its modules, that may import a library."""
FLOORS: dict[str, list[str | set[str]]] = {
    "cell": [
        "perception", "arm", "camera", "settings", "states", "motion", "checks", "assembly", "planning", "actions",
        "ground_truth", "run", "journal", "remote", "calibration",
    ],
    "drivers": ["base", "polled", "can", "dynamixel", "qb", "schunk", "realsense", "franka"],
    "drivers/can": ["codec", "config", "link", "driver", "virtual", "tools", "opening"],
    "drivers/dynamixel": ["codec", "config", "driver", "virtual", "opening"],
    "hands": ["description", "generate", "library", "settings", "limits"],
    "learning": ["policy", {"tasks", "environments"}, "mpc", "training"],
    "sim": [
        "renderer", "settings", "drivetrain", "objects", "hand_import", "model", "engine", "contact", "batch",
        "open_loop", "observer",
    ],
    "surfaces": ["worker_process", "hand", "ros", "panel", "teleop", "cli"],
    "twin": ["identify", "mirror", "branch", "rehearsal"],
    "twin/identify": ["motions", "fitting", "results", "pipeline", "report", {"record_excitation", "joint_ends"}],
}  # fmt: skip
"""Folders that have floors: a module may import from its own floor and from those before it."""
MODULES = sorted(PACKAGE.rglob("*.py"))
MOST = 14
"""Modules of a folder."""


def room(module: str) -> str:
    """The top-level folder or module below the package; the package itself stands above all."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


def layer(name: str) -> int:
    return next((k for k, names in enumerate(LAYERS) if name in names), len(LAYERS))


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def statements(node: ast.AST, *, types: bool) -> Iterator[ast.AST]:
    """Every statement in another, and those in these; or all but what only types need."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        for each in getattr(node, part, ()):
            if types or not (
                isinstance(each, ast.If) and isinstance(each.test, ast.Name) and each.test.id == "TYPE_CHECKING"
            ):
                yield each
                yield from statements(each, types=types)


@cache
def imports(path: Path) -> list[str]:
    """Every module imported anywhere in a file, lazily or not; what only types need is left out."""
    found = []
    for node in statements(parsed(path), types=False):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom) and node.module:
            found += [node.module] if node.module != "allegro_twin" else [f"allegro_twin.{a.name}" for a in node.names]
    return found


def own_room(path: Path) -> str:
    relative = path.relative_to(PACKAGE).with_suffix("")
    return "" if relative.name.startswith("__") and len(relative.parts) == 1 else relative.parts[0]


def test_no_folder_has_more_rooms_than_one_sees_at_a_glance() -> None:
    folders = {path.parent for path in MODULES}
    counts = {
        str(folder.relative_to(PACKAGE)): sum(path.name != "__init__.py" for path in folder.glob("*.py"))
        for folder in folders
    }
    assert {folder: count for folder, count in counts.items() if count > MOST} == {}


def test_every_room_has_a_layer() -> None:
    homeless = {own_room(path) for path in MODULES} - {"", *(name for names in LAYERS for name in names)}
    assert not homeless, f"give {homeless} a layer in docs/design.md and here"


def test_imports_point_down_and_never_sideways() -> None:
    wrong = [f"{path.relative_to(PACKAGE)} imports {module}" for path in MODULES for module in not_from_below(path)]
    assert not wrong, f"from the side or above: {wrong}"


def not_from_below(path: Path) -> list[str]:
    """What a module imports of the package that is neither below it nor in its own room."""
    mine = own_room(path)
    found = []
    for module in imports(path) if mine else []:
        theirs = room(module) if module.split(".")[0] == "allegro_twin" else ""
        same = theirs == mine or layer(mine) == layer(theirs) == 0
        if not same and layer(mine) <= layer(theirs) < len(LAYERS):
            found.append(module)
    return found


@pytest.mark.parametrize("room_", FLOORS)
def test_within_a_room_imports_point_down_its_floors(room_: str) -> None:
    floors = [each if isinstance(each, set) else {each} for each in FLOORS[room_]]
    there = {path.stem for path in (PACKAGE / room_).iterdir() if path.name != "__pycache__"}
    assert there == set().union(*floors, {"__init__"})

    def floor(name: str) -> int:
        return next((k for k, names in enumerate(floors) if name in names), -1)

    for path in (PACKAGE / room_).rglob("*.py"):
        mine = floor(path.relative_to(PACKAGE / room_).parts[0].removesuffix(".py"))
        for module in imports(path) if mine >= 0 else []:
            parts, here = module.split("."), ["allegro_twin", *room_.split("/")]
            if parts[: len(here)] == here and len(parts) > len(here):
                assert floor(parts[len(here)]) <= mine, f"{path.name} imports {module} from a floor above"


def test_every_library_has_one_home() -> None:
    found = [(path, module, HOMES.get(module.split(".")[0])) for path in MODULES for module in imports(path)]
    wrong = [
        f"{path.relative_to(PACKAGE)} imports {module}, which lives in {homes}"
        for path, module, homes in found
        if homes is not None and not any(lives_in(path, home) for home in homes)
    ]
    assert not wrong, wrong


def lives_in(path: Path, home: str) -> bool:
    place = path.relative_to(PACKAGE).with_suffix("").as_posix()
    return place == home or place.startswith(f"{home}/")


def test_only_paced_sleeps_and_only_drivers_the_guard_ros_the_trainer_and_the_planner_ask_for_the_time() -> None:
    users = {p.relative_to(PACKAGE) for p in MODULES if "time" in imports(p) or "datetime" in imports(p)}
    dated = {
        "surfaces/cli/twin/identification.py",
    }  # Write into a file on which day it was measured.
    timed = ("drivers", "learning/mpc", "learning/training", "grasping/plan", "pick/imitation", "surfaces/ros")
    assert {str(p) for p in users if not str(p).startswith(timed)} == {"loop.py", "safety.py", *dated}
    assert {str(p.relative_to(PACKAGE)) for p in MODULES if "time.sleep(" in p.read_text()} == {"loop.py"}
    assert (PACKAGE / "loop.py").read_text().count("time.sleep(") == 1


def modules_after(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_importing_the_package_loads_only_itself() -> None:
    added = modules_after("import allegro_twin") - modules_after("import importlib, typing, __future__")
    assert added == {"allegro_twin"}


def test_what_needs_little_loads_nothing_heavier_than_numpy() -> None:
    loaded = modules_after("from allegro_twin import HandBackend, HandFault, HandSpec, HandState, run, until")
    assert "numpy" in loaded
    assert not loaded & {*HOMES, "pydantic", "scipy"}


def test_every_name_of_the_package_is_there_and_is_shown() -> None:
    import allegro_twin
    from allegro_twin import errors

    for name in allegro_twin.__all__:
        assert getattr(allegro_twin, name) is not None
    assert set(allegro_twin.__all__) <= set(dir(allegro_twin))
    raised = {name for name, value in vars(errors).items() if getattr(value, "__module__", "") == errors.__name__}
    assert raised - {"unknown"} <= set(allegro_twin.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Hnad'"):
        allegro_twin.Hnad  # noqa: B018  # Asking is what fails.


@pytest.mark.parametrize("role", _lazy.PROVIDERS)
def test_what_a_wing_needs_from_a_higher_one_is_there(role: str) -> None:
    assert callable(_lazy.provided(role))


def wings() -> list[str]:
    """Folders of the package that declare public names, dotted."""
    paths = [path for path in sorted(PACKAGE.rglob("*/__init__.py")) if "__all__ = " in path.read_text()]
    return [".".join(path.parent.relative_to(PACKAGE).parts) for path in paths]


@pytest.mark.parametrize("wing", wings())
def test_a_wing_has_at_most_twelve_public_names_each_with_a_docstring(wing: str) -> None:
    module = importlib.import_module(f"allegro_twin.{wing}")
    assert 0 < len(module.__all__) <= 12
    for name in module.__all__:
        value = getattr(module, name)
        assert value is not None
        path = PACKAGE.joinpath(*wing.split("."), f"{name}.py")
        assert inspect.ismodule(value) or not path.exists(), f"{wing}.{name} is a module, too, which hides it"
        if inspect.isclass(value) or inspect.isroutine(value):
            assert value.__doc__, f"{wing}.{name} has no docstring"


def test_replay_runs_without_mujoco(recording_path: Path) -> None:
    config = recording_path.with_name("replay.yaml")
    config.write_text(
        f"backend: {{kind: replay, file: {recording_path}}}\ntask: {{posture: home}}\ncontroller: {{kind: pd}}\n"
    )
    code = f"""
import sys
sys.modules["mujoco"] = None
from allegro_twin.app import assemble
from allegro_twin.app.config import load_config
from allegro_twin.loop import run, to_the_end
rig = assemble(load_config({str(config)!r}))
print(sum(1 for _ in to_the_end(run(rig.backend, rig.controller))))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "251"


def committed() -> list[Path]:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    names = listed.stdout.split() if listed.returncode == 0 else []
    return [ROOT / name for name in names if (ROOT / name).is_file()]


def test_no_file_names_a_package_registry_or_a_machine() -> None:
    words = [
        "pypi" + ".org",
        "python" + "hosted",
        "registry.npm" + "js",
        "deb.deb" + "ian",
        "/wo" + "rk/",
        "/ro" + "ot/",
    ]
    for path in committed():
        if path.suffix in {".png", ".mp4", ".rrd"}:
            continue
        text = path.read_text(errors="replace")
        assert not [word for word in words if word in text], path


def test_every_module_says_its_idea_and_stays_one_idea() -> None:
    for path in MODULES:
        tree = parsed(path)
        assert ast.get_docstring(tree), f"{path} has no docstring"


def test_no_import_goes_round_in_a_circle_not_even_for_types() -> None:
    circles = sorted(" → ".join(circle) for circle in round_trips(references()))
    assert not circles, circles


def references() -> dict[str, set[str]]:
    """For each module of the package those that it names in an import: at its top, in a function, or for types."""
    names = {dotted(path): path for path in MODULES}
    return {name: referred(name, path, set(names)) - {name} for name, path in names.items()}


def dotted(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def referred(name: str, path: Path, known: set[str]) -> set[str]:
    found = set()
    for node in statements(parsed(path), types=True):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {each if each in known else node.module for each in inner}
    return found & known


def round_trips(graph: dict[str, set[str]]) -> set[tuple[str, ...]]:
    """A circle through each pair of modules that refer to each other, directly or by way of others."""
    found: set[tuple[str, ...]] = set()
    done: set[str] = set()

    def follow(name: str, way: list[str]) -> None:
        if name in way:
            circle = way[way.index(name) :]
            least = circle.index(min(circle))
            found.add((*circle[least:], *circle[:least], circle[least]))
        elif name not in done:
            for other in sorted(graph[name]):
                follow(other, [*way, name])
            done.add(name)

    for name in sorted(graph):
        follow(name, [])
    return found


def test_no_module_knows_another_hand_by_its_name() -> None:
    """Whose a file is, and what is to be done with it, is asked of the spec: a new hand changes no line of code."""
    hands = {path.stem for folder in ("models", "models/tendons") for path in (ROOT / folder).glob("*.yaml")} - {
        "allegro"
    }
    assert {"leap", "model_o", "qb_softhand"} <= hands
    hands |= {path.stem for path in (ROOT / "models" / "arms").glob("*.yaml")}
    for path in MODULES:
        tree = parsed(path)
        docstrings = {
            id(node.body[0].value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
                named = [hand for hand in hands if hand in node.value.lower().replace("-", "_").split()]
                assert not named, f"{path}:{node.lineno} names {named[0]}"
