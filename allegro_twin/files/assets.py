"""Files that ship with the package, YAML files, and the user's cache."""

from __future__ import annotations

import pickle
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import yaml

from allegro_twin.errors import ConfigError, unknown

_KINDS = {
    "scenarios": "scenario",
    "conf/postures": "posture",
    "conf/grasps": "grasp",
    "conf/trajectories": "trajectory",
    "conf/hands": "hand",
    "conf/training": "recipe",
    "conf/protocols": "protocol",
}
_PACKAGE = Path(__file__).resolve().parent.parent


@cache
def data_root() -> Path:
    """The folder that holds models/, conf/, scenarios/ and examples/: inside an installed wheel, else the checkout."""
    inside = _PACKAGE / "_data"
    return inside if inside.is_dir() else _PACKAGE.parent


def refuse_shipped(path: str | Path) -> None:
    """Raise ConfigError for a file to be written that lies among those of conf."""
    file = Path(path).resolve()
    if file.is_relative_to((data_root() / "conf").resolve()):
        copy = f": copy it, `cp {path} my_{file.name}`, and name the copy" if file.is_file() else "; name one elsewhere"
        raise ConfigError(f"{path}: what ships with the package is not changed; choose a file of your own{copy}")


def find_file(path: str | Path, kind: str, folder: str, suffix: str = ".yaml", *, below: bool = False) -> Path:
    """A file given by its path, or by its bare name in a shipped folder, or `below` it too. Raises ConfigError with the
    nearest names, and with what else has that name."""
    given = Path(path)
    if given.is_file():
        return given
    shipped = data_root() / folder
    if given.suffix == suffix and (data_root() / given).is_file():
        return data_root() / given
    if len(given.parts) > 1 or given.suffix == suffix:
        raise ConfigError(f"{path}: no such {kind} file")
    matches = {file.stem: file for file in sorted(shipped.glob(f"{'**/' if below else ''}*{suffix}"))}
    if given.name not in matches:
        other = _other(given.name)
        raise ConfigError(unknown(kind, given.name, matches) + (f" ({given.name!r} is {other})" if other else ""))
    return matches[given.name]


def _other(name: str) -> str:
    """The kind of what ships under a name, such as `a posture`; empty for nothing."""
    for folder, kind in _KINDS.items():
        if any(file.stem == name for file in (data_root() / folder).rglob("*.yaml")):
            return f"a {kind}"
    return ""


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file. Raises ConfigError with the file and the line."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    return parse_yaml(text, str(path))


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """The mapping in a YAML text; `where` names its source. Raises ConfigError with the source and the line."""
    try:
        content = pickle.loads(_parsed(text))
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise ConfigError(f"{where}:{line}: not valid YAML: {error.problem}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{where}: cannot be read: {str(error).splitlines()[0]}") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{where}: must hold a mapping of keys to values, not {type(content).__name__}")
    return content


@lru_cache(maxsize=256)
def _parsed(text: str) -> bytes:
    """The pickled content of a YAML text: every reader unpickles an object of its own, in a fortieth of the time."""
    return pickle.dumps(yaml.load(text, Loader=_LOADER))


def compose_yaml(text: str) -> yaml.Node | None:
    """The tree of a YAML text, with the place of every part; None for a text of comments. Raises yaml.YAMLError."""
    return yaml.compose(text, Loader=_LOADER)


class _LOADER(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # The C loader is optional.
    """A safe loader that refuses a key given twice, which YAML forbids and PyYAML silently overwrites."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is given twice", key_node.start_mark)
            seen.add(key)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping


def cache_folder(kind: str, what: str) -> Path:
    """The folder of one kind of result in the user's cache. Raises ConfigError, saying that `what` needs the extra,
    where the platform's folders are not known."""
    try:
        from platformdirs import user_cache_path
    except ImportError as error:
        raise ConfigError(f"{what} is kept in a cache: pip install 'allegro-twin[objects]'") from error
    return user_cache_path("allegro_twin", appauthor=False) / kind
