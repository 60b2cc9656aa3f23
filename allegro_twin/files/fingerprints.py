"""Fingerprints: hashes of what results are made of. Contents that differ in a byte have different fingerprints.

`fingerprint` is of values (settings, arrays, files), `source_fingerprint` of the code that a function can reach.
"""

from __future__ import annotations

import ast
import hashlib
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel

from allegro_twin._lazy import PROVIDERS
from allegro_twin.errors import ConfigError

DIGITS = 16
"""Digits of a SHA-256 that are kept: 64 bits."""
_OWN = __name__.partition(".")[0]


def fingerprint(*content: object) -> str:
    """The first 16 digits of a SHA-256 of plain values, arrays, settings and dataclasses, and, of a Path, of the bytes
    of that file: where it lies does not count. Raises ConfigError for a file that cannot be read, TypeError for
    anything else."""
    found = hashlib.sha256()
    for each in content:
        _feed(found.update, each)
    return found.hexdigest()[:DIGITS]


def _feed(put: Callable[[bytes], None], value: object) -> None:
    """Every value begins with its kind and its length, so that no two of them run into each other."""
    match value:
        case None | bool():
            put(repr(value).encode())
        case int() | np.integer():
            put(f"i{int(value)};".encode())
        case float() | np.floating():
            put(b"f" + struct.pack("<d", float(value)))
        case Enum():
            _feed(put, value.name)
        case str():
            put(f"s{len(value.encode())};".encode() + value.encode())
        case bytes():
            put(f"b{len(value)};".encode() + value)
        case Path():
            _feed(put, _bytes(value))
        case np.ndarray():
            put(f"a{value.dtype.str}{value.shape};".encode() + np.ascontiguousarray(value).tobytes())
        case BaseModel():
            _feed(put, {name: getattr(value, name) for name in type(value).model_fields})
        case Mapping():
            put(f"m{len(value)};".encode())
            for key in sorted(value, key=str):
                _feed(put, key)
                _feed(put, value[key])
        case Set():
            _feed(put, sorted(value))
        case Sequence():
            put(f"l{len(value)};".encode())
            for each in value:
                _feed(put, each)
        case _ if is_dataclass(value) and not isinstance(value, type):
            _feed(put, {each.name: getattr(value, each.name) for each in fields(value)})
        case _:
            raise TypeError(f"no fingerprint of a {type(value).__name__}: {value!r}")


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error


@cache
def source_fingerprint(module: str) -> str:
    """The fingerprint of all sources that a module reaches: its own, and those of this package and of its own top-level
    package that they import, within functions too. What it never imports does not count. As they are when it is first
    asked for: a process goes on with the code that it has. Empty for what has none."""
    files = reached_sources(module)
    return fingerprint(files) if files else ""


@lru_cache(maxsize=32)
def _reached(module: str) -> tuple[tuple[str, Path], ...]:
    tops = {_OWN, module.partition(".")[0]}
    found: dict[str, Path] = {}
    left = [_Target(module, whole=True)]
    done: set[_Target] = set()
    while left:
        target = left.pop()
        if target in done or target.module.partition(".")[0] not in tops:
            continue
        done.add(target)
        if (path := _file_of(target.module)) is None:
            continue
        found[target.module] = path
        left += _parents(target.module)
        left += _imports(target, path)
    return tuple(sorted(found.items()))


def reached_sources(module: str) -> dict[str, Path]:
    """The files of `source_fingerprint`, by the names of their modules."""
    return dict(_reached(module))


class _Target(NamedTuple):
    """A module that is reached, and whether for names in it; else only because what it holds is imported."""

    module: str
    whole: bool


def _parents(module: str) -> Iterator[_Target]:
    parts = module.split(".")
    for count in range(1, len(parts)):
        yield _Target(".".join(parts[:count]), whole=False)


@lru_cache(maxsize=4096)
def _file_of(module: str) -> Path | None:
    """Without importing it; None for what is no module, or has no source."""
    top, *rest = module.split(".")
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):  # `__main__` of a program that was typed in, for example.
        return None
    if spec is None:
        return None
    if not rest:
        return Path(spec.origin) if spec.origin and Path(spec.origin).suffix == ".py" else None
    for place in spec.submodule_search_locations or ():
        path = Path(place).joinpath(*rest)
        for file in (path.with_name(f"{path.name}.py"), path / "__init__.py"):
            if file.is_file():
                return file
    return None


@lru_cache(maxsize=4096)
def _tree(path: Path) -> ast.Module:
    return ast.parse(_bytes(path))


def _imports(target: _Target, path: Path) -> Iterator[_Target]:
    """The imports of a module. A package with lazy names imports them under TYPE_CHECKING; what a wing needs from a
    higher one is in PROVIDERS; a module that imports by name may import every module next to it."""
    package = target.module if path.name == "__init__.py" else target.module.rpartition(".")[0]
    lazy = path.name == "__init__.py" and target.whole
    for node in _nodes(_tree(path), types=lazy):
        match node:
            case ast.Import(names=names):
                yield from (_Target(each.name, whole=True) for each in names)
            case ast.ImportFrom(module=name, names=names, level=level):
                base = ".".join(part for part in (_up(package, level), name) if part)
                for each in names:
                    inner = f"{base}.{each.name}"
                    inside = _file_of(inner) is not None
                    yield _Target(inner if inside else base, whole=True)
            case ast.Call(func=ast.Name(id="provided"), args=[ast.Constant(value=str() as role)]):
                yield _Target(PROVIDERS[role].partition(":")[0], whole=True)
            case ast.Call(func=ast.Name(id="import_module") | ast.Attribute(attr="import_module")) if target.whole:
                beside = path.parent.glob("*.py") if package != _OWN else ()
                yield from (_Target(f"{package}.{each.stem}", whole=True) for each in beside if each != path)


def _up(package: str, level: int) -> str:
    """Where a relative import begins; nothing for an absolute one."""
    if level == 0:
        return ""
    return ".".join(package.split(".")[: len(package.split(".")) - level + 1])


def _nodes(tree: ast.AST, *, types: bool) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if types or not _for_types(node):
            yield node
            yield from _nodes(node, types=types)


def _for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
