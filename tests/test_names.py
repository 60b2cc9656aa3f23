"""Every name of code that docs and docstrings have in backticks exists: `module.name`, `Class.attribute`, `name(...)`.

`a.b.c` is read from left to right. `a` may be a module or folder of the package, a class, a key of a settings file, or
the usual name of an instance: `spec` stands for a class whose name ends in `Spec`. What begins with none of these, such
as `numpy.linspace`, belongs to another package and is not looked up, unless it begins with a capital.
"""

from __future__ import annotations

import ast
import builtins
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.test_architecture import parsed

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "allegro_twin"
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "plugins").glob("*/README.md")]
    + [page for page in (ROOT / "docs").rglob("*.md") if page.parent.name not in ("api", "results")]
)
"""The pages that people write: `api` is made of docstrings, and `results` has names of its date."""
DOTTED = re.compile(r"(?<!`)`(?:allegro_twin\.)?([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+)(?:\([^`]*\))?`(?!`)")
SNAKE = re.compile(r"(?<!`)`([a-z]+_[a-z_0-9]+)`(?!`)")
CALL = re.compile(r"(?<!`)`([A-Za-z_]\w*)\([^`]*\)`(?!`)")
SUFFIXES = {
    "arrow", "bag", "csv", "gz", "html", "json", "log", "mcap", "md", "mjcf", "npz", "onnx", "parquet", "py", "rrd",
    "sh", "so", "stl", "toml", "urdf", "xml", "yaml", "yml", "zip", "inc", "npy", "pdf", "webp", "png", "txt", "ipynb",
    "css",
}  # fmt: skip
"""Names of files."""
OTHERS = {
    # Keys of files, below a key that several classes or none describe.
    "backend.faults", "backend.scene.timestep", "backend.scene.truth", "controller.inverse_dynamics",
    "wire.encoder_offset", "wire.torque_constant",
    # Columns of data sets and tables, files, entry points.
    "observation.state", "position.index_0", "recording.temperature", "policy.mp4", "AllegroHandDrv.cpp",
    "allegro_twin.backends", "allegro_twin.controllers",
    # Of other programs: python-can, Gymnasium, ManiSkill, the packages of UPC, the model's own files.
    "can.Bus", "can.BusABC", "can.Message", "env.unwrapped.engine.task.card", "make_vec",
    "cartesian_impedance_example_controller", "get_state_dict", "change_motor_min", "menagerie_left",
    # Made at run time, or what the reader defines.
    "function", "rgb_side", "rgb_top", "joint_0_0", "joint_3_0",
}  # fmt: skip
"""Names in backticks that are none of ours."""


class Code(NamedTuple):
    """What the package defines."""

    modules: dict[str, set[str]]
    """Names at the top of modules and in folders, by the last part of the module's name; of several, all."""
    classes: dict[str, set[str]]
    """Members of classes, inherited ones too."""
    keys: dict[str, set[str]]
    """Fields below each field of a settings class."""
    callables: set[str]
    """Every function, method and class, and every name that is called."""


def members(node: ast.ClassDef) -> set[str]:
    found = set()
    for each in ast.walk(node):
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef):
            found.add(each.name)
        elif isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name):
            found.add(each.target.id)
        elif isinstance(each, ast.Attribute) and isinstance(each.value, ast.Name) and each.value.id in ("self", "cls"):
            found.add(each.attr)
        elif isinstance(each, ast.Assign):
            found |= {name.id for target in each.targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    return found


def top(tree: ast.Module) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= {(alias.asname or alias.name).split(".")[-1] for alias in node.names}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    return found


@cache
def code() -> Code:
    modules: dict[str, set[str]] = defaultdict(set)
    own: dict[str, set[str]] = defaultdict(set)
    bases: dict[str, set[str]] = defaultdict(set)
    types: dict[str, set[str]] = defaultdict(set)
    callables = set(dir(builtins))
    for path in sorted(
        [*PACKAGE.rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py"), *(ROOT / "studies").rglob("*.py")]
    ):
        tree = parsed(path)
        modules[path.parent.name if path.name == "__init__.py" else path.stem] |= top(tree)
        modules[path.parent.name].add(path.stem)
        if path.parent.parent != ROOT:  # The name of a clone's folder is anybody's.
            modules[path.parent.parent.name].add(path.parent.name)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                callables.add(node.name)
            if isinstance(node, ast.Call):
                callables.add(ast.unparse(node.func).split(".")[-1])
            if isinstance(node, ast.ClassDef):
                own[node.name] |= members(node)
                bases[node.name] |= {ast.unparse(base).split("[")[0].split(".")[-1] for base in node.bases}
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                types[node.target.id] |= set(re.findall(r"\w+", ast.unparse(node.annotation)))

    def inherited(name: str) -> set[str]:
        return own[name].union(*(inherited(base) for base in bases[name] if base in own and base != name))

    classes = {name: inherited(name) for name in list(own)}
    keys = {name: set().union(*(classes[each] for each in found if each in classes)) for name, found in types.items()}
    return Code(modules, classes, keys, callables)


def snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


@cache
def instances(name: str) -> frozenset[str]:
    """Members of every class of which `name` may be an instance."""
    made = code()
    found = [made.classes[each] for each in made.classes if f"_{snake(each)}".endswith(f"_{name}")]
    return frozenset().union(*found)


def exists(name: str) -> bool:
    """Whether `a.b.c` leads somewhere, or begins with what is not ours."""
    made, parts = code(), name.split(".")
    if parts[-1] in SUFFIXES:
        return True
    for here, there in pairwise(parts):
        known = [table[here] for table in (made.modules, made.classes, made.keys) if here in table]
        if known or instances(here):
            if not any(there in each for each in known) and there not in instances(here):
                return False
        elif here == parts[0]:
            return not here[0].isupper()
    return True


def code_words(tree: ast.Module) -> Iterator[str]:
    """The names and strings of code, without docstrings and comments."""
    texts: set[int] = set()
    for node in ast.walk(tree):  # Parents before children.
        if isinstance(node, ast.Expr):
            texts.add(id(node.value))
        elif id(node) not in texts:
            for value in vars(node).values():
                if isinstance(value, str):
                    yield value
                elif isinstance(value, list):
                    yield from (each for each in value if isinstance(each, str))


@cache
def written() -> set[str]:
    """Every word of code, configs and models, without the docstrings."""
    found: set[str] = set()
    for folder in (
        "allegro_twin",
        "benchmarks",
        "conf",
        "examples",
        "models",
        "plugins",
        "ros",
        "scenarios",
        "studies",
        "tests",
    ):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix not in (".py", ".yaml", ".xml", ".toml", ".msg", ".sh") or path == Path(__file__):
                continue
            text = path.read_text()
            if path.suffix == ".py":
                text = " ".join(code_words(ast.parse(text)))
            found |= set(re.findall(r"\w+", text))
    return found


def texts() -> Iterator[tuple[str, str]]:
    """Every page, and every docstring, field's docstring and comment of the package, with its place."""
    for page in PAGES:
        for number, line in enumerate(page.read_text().splitlines(), 1):
            yield f"{page.relative_to(ROOT)}:{number}", line
    for path in sorted(PACKAGE.rglob("*.py")):
        place = path.relative_to(ROOT)
        for node in ast.walk(parsed(path)):
            if (
                isinstance(node, ast.Expr)
                and isinstance(node.value, ast.Constant)
                and isinstance(node.value.value, str)
            ):
                yield f"{place}:{node.lineno}", node.value.value
        for number, line in enumerate(path.read_text().splitlines(), 1):
            if "#" in line:
                yield f"{place}:{number}", line.split("#", 1)[1]


def missing(text: str) -> list[str]:
    """The names in backticks of a text that lead nowhere."""
    wrong = [name for name in DOTTED.findall(text) if not exists(name)]
    wrong += [name for name in CALL.findall(text) if name not in code().callables]
    wrong += [name for name in SNAKE.findall(text) if name not in written()]
    return [name for name in wrong if name not in OTHERS]


def test_every_name_in_backticks_exists() -> None:
    wrong = [f"{place}: {name}" for place, text in texts() for name in missing(text)]
    assert wrong == [], "rename them in the text, or, if they are not ours, add them to OTHERS"


@pytest.mark.parametrize(
    "name", ["array_api.fetched", "Bounds.admit", "HandSpec.mirrored", "loop.together", "sim.meshes.middle_of"]
)
def test_a_name_that_was_renamed_is_found(name: str) -> None:
    assert missing(f"as `{name}(x)` does") == [name]


def test_names_of_the_package_its_files_and_other_packages_pass() -> None:
    text = "`HandSpec.mirror_posture(q)`, `loop.interleave`, `spec.coupled_positions`, `numpy.linspace`, `hand.yaml`"
    assert missing(text) == []


def test_every_exception_is_needed() -> None:
    found = {name for _, text in texts() for pattern in (DOTTED, CALL, SNAKE) for name in pattern.findall(text)}
    assert {name.removeprefix("allegro_twin.") for name in OTHERS} <= {n.removeprefix("allegro_twin.") for n in found}
