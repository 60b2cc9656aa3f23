"""Names that are imported when they are first asked for: a wing's public names, and what it needs from a higher one."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint
    from types import ModuleType

PROVIDERS = {"link tree": "allegro_twin.sim.model.link_tree:read_link_tree"}
"""What a wing needs from a higher one, which it does not import: for each role `package.module:name`."""


def exports(
    package: str, homes: Mapping[str, tuple[str, ...]], root: str | None = None
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package whose public names live in modules below it.

    `homes`: for each module, relative to the package, its public names. A module must not have the name of a
    public name, which it would hide once it is imported. `root`: the package that they are relative to, for a
    single module with public names.
    """
    module_of = {name: module for module, names in homes.items() for name in names}

    def getattribute(name: str) -> object:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{root or package}.{module_of[name]}"), name)

    return getattribute, lambda: sorted({*module_of, *vars(sys.modules[package])})


def provided(role: str) -> Any:
    """What `PROVIDERS` names for a role."""
    module, _, name = PROVIDERS[role].partition(":")
    return getattr(import_module(module), name)


def import_user_module(name: str) -> ModuleType:
    """A module that a user names, from the current folder too, where a console script does not look by itself.
    `sys.path` is as before afterwards. Raises ImportError, also for what is no name of a module."""
    if not all(part.isidentifier() for part in name.split(".")):
        raise ImportError(f"{name!r} is no name of a module")
    here = os.getcwd()
    sys.path.insert(0, here)
    try:
        return import_module(name)
    finally:
        sys.path.remove(here)


@cache
def entry_points_of(group: str) -> Mapping[str, EntryPoint]:
    """What installed packages add to a group, by name."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=group)}
