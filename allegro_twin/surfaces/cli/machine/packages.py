"""Checks of Python, of the required packages and of the extras."""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec

from allegro_twin.surfaces.cli.machine.finding import Diagnosis

_REQUIREMENT = re.compile(r"([A-Za-z0-9_.-]+)(?:\[[^]]*\])?\s*([^;]*)(?:;\s*(.*))?")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)['\"]")
_BEFORE = re.compile(r"python_version\s*<\s*['\"]3\.(\d+)['\"]")
_BOUND = re.compile(r"(>=|<)\s*([0-9.]+)")
_MODULES = {
    "pin": "pinocchio",
    "pyserial": "serial",
    "python-can": "can",
    "pyyaml": "yaml",
    "ruamel-yaml": "ruamel.yaml",
}
"""Modules that are not named as their packages."""
_IMPORT = """
import importlib, json, os, sys
told = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # What libraries print is no answer.
for name in sys.argv[1:]:
    print(json.dumps([name, None]), file=told, flush=True)
    try:
        importlib.import_module(name)
        said = ""
    except BaseException as error:
        said = (str(error).strip() or type(error).__name__).splitlines()[0]
    print(json.dumps([name, said]), file=told, flush=True)
"""
"""Says of each module, before, that it is tried, and then why it cannot be imported; empty where it can."""
_SECONDS = 120.0
Version = Callable[[str], str]
Imports = Callable[[Sequence[str]], Mapping[str, str]]
"""Why modules cannot be imported, by the name of each that cannot."""


def python() -> Iterator[Diagnosis]:
    """The Python version."""
    found = f"Python {platform.python_version()}, {platform.system()} {platform.release()}, {platform.machine()}"
    fine = sys.version_info >= (3, 11)
    yield Diagnosis("Python", "works" if fine else "broken", found, "" if fine else "install Python 3.11 or newer")


def import_errors(modules: Sequence[str]) -> dict[str, str]:
    """Why modules cannot be imported, by the name of each that cannot; in separate processes, which a broken library
    may end. MuJoCo is imported without a way to render."""
    wrong: dict[str, str] = {}
    left = list(modules)
    while left:
        command = [sys.executable, "-c", _IMPORT, *left]
        try:
            done = subprocess.run(
                command, env=os.environ | {"MUJOCO_GL": "off"}, capture_output=True, text=True, timeout=_SECONDS
            )
            shown, how = done.stdout, f"its import ends Python with {done.returncode}"
        except subprocess.TimeoutExpired as error:
            shown = error.stdout.decode() if isinstance(error.stdout, bytes) else error.stdout or ""
            how = f"its import takes more than {_SECONDS:g} s"
        said: dict[str, str | None] = dict(json.loads(line) for line in shown.splitlines())
        wrong |= {name: how if why is None else why for name, why in said.items() if why != ""}
        if not said:
            return wrong | dict.fromkeys(left, how)
        left = left[len(said) :]
    return wrong


def packages(
    given: list[str] | None = None,
    its: Version = version,
    minor: int = sys.version_info[1],
    imports: Imports = import_errors,
) -> Iterator[Diagnosis]:
    """The required packages, which are imported, and each extra. `given`: requirements as in the metadata; `minor`:
    minor version of Python 3."""
    given = requires("allegro-twin") or [] if given is None else given
    core, extras = parse_requirements(given)
    wrong = list(_wrong(core, its))
    mends = ["pip install --upgrade allegro-twin"] if wrong else []
    normal = {name: re.sub(r"[-_.]+", "-", name).lower() for name in core if _installed(name, its)}
    modules = {name: _MODULES.get(each, each.replace("-", "_")) for name, each in normal.items()}
    errors = imports(list(modules.values()))
    for name, module in modules.items():
        if module in errors:
            wrong.append(f"{module} cannot be imported: {errors[module]}")
            mends.append(f"pip install --force-reinstall '{name}{core[name].strip()}'")
    yield Diagnosis(
        "packages", "broken" if wrong else "works", "; ".join(wrong) or f"{len(core)} needed, all can be imported",
        "; ".join(mends),
    )  # fmt: skip
    for extra, needed in extras.items():
        wrong = list(_wrong(needed, its))
        says = "; ".join(wrong) or ", ".join(f"{name} {its(name)}" for name in needed)
        mend = f"pip install 'allegro-twin[{extra}]'" if wrong else ""
        end = _ends(given, extra)
        if wrong and end <= minor:  # pip would silently install nothing.
            says, mend = f"{says}; not for Python 3.{end} and later", f"use Python 3.{end - 1}, and {mend}"
        yield Diagnosis(f"extra {extra}", "absent" if wrong else "works", says, mend)


def rospy(found: bool | None = None) -> Iterator[Diagnosis]:
    """rospy, the library of ROS 1; no extra installs it. `found`: whether it is installed."""
    there = find_spec("rospy") is not None if found is None else found
    yield Diagnosis("rospy", "works" if there else "absent", "ROS 1 works" if there else "no `allegro-twin ros1`",
                  "" if there else "apt-get install python3-rospy; docs/how-to/use_ros.md")  # fmt: skip


def _ends(given: list[str], extra: str) -> int:
    """First minor version of Python 3 that an extra excludes; 999 if it excludes none."""
    markers = [line.partition(";")[2] for line in given]
    mine = [marker for marker in markers if (name := _EXTRA.search(marker)) and name[1] == extra]
    return min((int(found[1]) for marker in mine if (found := _BEFORE.search(marker))), default=999)


def parse_requirements(given: list[str]) -> tuple[dict[str, str], dict[str, dict[str, str]]]:
    """Requirements by name with their bounds: the required ones, and those of each extra but `dev`."""
    core: dict[str, str] = {}
    extras: dict[str, dict[str, str]] = {}
    for line in given:
        match = _REQUIREMENT.match(line)
        assert match is not None
        name, bounds, marker = match.groups()
        extra = _EXTRA.search(marker or "")
        if extra is None:
            core[name] = bounds
        elif extra[1] != "dev":
            extras.setdefault(extra[1], {})[name] = bounds
    return core, dict(sorted(extras.items()))


def _installed(name: str, its: Version) -> bool:
    try:
        return bool(its(name))
    except PackageNotFoundError:
        return False


def _wrong(needed: dict[str, str], its: Version) -> Iterator[str]:
    for name, bounds in needed.items():
        try:
            found = its(name)
        except PackageNotFoundError:
            yield f"{name} is not installed"
            continue
        for sign, bound in _BOUND.findall(bounds):
            if (_number(found) < _number(bound)) == (sign == ">="):
                yield f"{name} is {found}; {bounds.strip()} is needed"


def _number(text: str) -> tuple[int, ...]:
    """The numbers of a release, without suffixes."""
    return tuple(int(part) for part in re.findall(r"\d+", re.split(r"[a-z+]", text)[0]))
