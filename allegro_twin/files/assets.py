"""Files that ship with the package, YAML files, and the user's cache."""

from __future__ import annotations

import pickle
import re
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
    "conf/pick": "recipe",
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


def is_file(path: Path) -> bool:
    """Whether there is such a file; False, too, for what no file system takes as a name."""
    try:
        return path.is_file()
    except OSError:
        return False


def find_file(path: str | Path, kind: str, folder: str, suffix: str = ".yaml", *, below: bool = False) -> Path:
    """A file given by its path, or by its bare name in a shipped folder, or `below` it too. Raises ConfigError with the
    nearest names, and with what else has that name."""
    given = Path(path)
    if is_file(given):
        return given
    shipped = data_root() / folder
    if given.suffix == suffix and is_file(data_root() / given):
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
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: cannot be read: it is not UTF-8 text; save it as UTF-8") from error
    except OSError as error:
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
    except RecursionError as error:
        raise ConfigError(f"{where}: lists and mappings are nested too deep to be read") from error
    if content is None:
        raise ConfigError(f"{where}: is empty; it must hold a mapping of keys to values")
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


_MERGE = "tag:yaml.org,2002:merge"
_BASE_60_OR_8 = re.compile(r"[-+]?(0[0-7_]*[0-7]|[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?)")


class _LOADER(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # The C loader is optional.
    """A safe loader that refuses a key given twice, which YAML forbids and PyYAML silently overwrites, and numbers that
    YAML 1.1 and 1.2 read differently: 010 is 8 or 10, and 1:30 is 90 or a text. A date is a text, as in 1.2."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            if key_node.tag == _MERGE:
                continue
            if not isinstance(key_node, yaml.ScalarNode):
                raise _refusal("a key is one word, not a list or a mapping", key_node)
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise _refusal(f"key {key!r} is given twice", key_node)
            seen.add(key)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping

    def construct_word(self, node: yaml.ScalarNode) -> int | float | bool:
        """Number or truth value of a scalar with the tag int, float or bool. Raises a refusal for one that YAML 1.1 and
        1.2 read differently."""
        word, kind = node.value, node.tag.rpartition(":")[2]
        if kind != "bool" and _BASE_60_OR_8.fullmatch(word):
            raise _refusal(f"{word} is one number in YAML 1.1 and another thing in 1.2: a decimal number has no "
                           f"leading zero and no colon; a text is in quotes", node)  # fmt: skip
        try:
            value: int | float | bool = getattr(self, f"construct_yaml_{kind}")(node)
        except (KeyError, ValueError) as error:  # A tag that somebody wrote, or more than 4300 digits.
            raise _refusal(f"{word if len(word) <= 20 else word[:20] + '...'} is no {kind}", node) from error
        return value


def _refusal(said: str, node: yaml.Node) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(None, None, said, node.start_mark)


for _kind in ("int", "float", "bool"):
    _LOADER.add_constructor(f"tag:yaml.org,2002:{_kind}", _LOADER.construct_word)
_LOADER.add_constructor("tag:yaml.org,2002:timestamp", _LOADER.construct_yaml_str)


def cache_folder(kind: str, what: str) -> Path:
    """The folder of one kind of result in the user's cache. Raises ConfigError, saying that `what` needs the extra,
    where the platform's folders are not known."""
    try:
        from platformdirs import user_cache_path
    except ImportError as error:
        raise ConfigError(f"{what} is kept in a cache: pip install 'allegro-twin[objects]'") from error
    return user_cache_path("allegro_twin", appauthor=False) / kind
