"""One block of YAML with new content in its old clothes: comments, order and the digits of what stays are kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, MutableMapping, MutableSequence
from io import StringIO
from typing import Any

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.constructor import RoundTripConstructor
from ruamel.yaml.error import YAMLError
from ruamel.yaml.representer import RoundTripRepresenter
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from allegro_twin.errors import ConfigError

INDENT = 2


def edited(text: str, content: Mapping[str, Any], where: str) -> str:
    """A mapping's text with new content: comments, order and the look of what stays are kept."""
    ruamel = YAML()
    ruamel.Constructor, ruamel.Representer = _Constructor, _Representer
    ruamel.width = 1 << 20
    ruamel.preserve_quotes = True
    ruamel.indent(mapping=INDENT, sequence=2 * INDENT, offset=INDENT)
    try:
        node = ruamel.load(text) if text.strip() else CommentedMap()
        node = CommentedMap() if node is None else node
        _merge(node, content)
        stream = StringIO()
        ruamel.dump(node, stream)
    except YAMLError as error:
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise ConfigError(f"{where}: cannot be changed by a program: {problem}; edit it by hand") from error
    return stream.getvalue()


def _merge(node: MutableMapping[str, Any], content: Mapping[str, Any]) -> None:
    for key in [key for key in node if key not in content]:
        del node[key]
    for key, value in content.items():
        old = node.get(key)
        if isinstance(old, MutableMapping) and isinstance(value, Mapping):
            _merge(old, value)
        elif isinstance(old, CommentedSeq) and isinstance(value, list | tuple):
            _merge_list(old, value)
        elif key not in node or not _same(old, value):
            node[_key(key) if key not in node else key] = _styled(value)


def _merge_list(node: MutableSequence[Any], values: list[Any] | tuple[Any, ...]) -> None:
    for place, value in enumerate(values[: len(node)]):
        if not _same(node[place], value):
            node[place] = _styled(value)
    del node[len(values) :]
    for value in values[len(node) :]:
        node.append(_styled(value))


def _same(old: Any, new: Any) -> bool:
    """Equal to the last bit: the sign of a zero counts, for the mirror image has it."""
    if isinstance(old, float) and isinstance(new, float):
        return old == new and math.copysign(1.0, old) == math.copysign(1.0, new)
    return type(old) is type(new) and bool(old == new)


def _styled(value: Any) -> Any:
    """Plain data as YAML that a person would write: numbers in a row, the rest in blocks."""
    if isinstance(value, Mapping):
        return CommentedMap({_key(key): _styled(inner) for key, inner in value.items()})
    if isinstance(value, list | tuple):
        sequence = CommentedSeq([_styled(inner) for inner in value])
        if not any(isinstance(inner, Mapping | list | tuple) for inner in value):
            sequence.fa.set_flow_style()
        return sequence
    return _key(value) if isinstance(value, str) else value


def _key(word: str) -> str:
    """A word in quotes where YAML 1.1 would read something else: `off` is a posture, not False."""
    try:
        plain = yaml.safe_load(word) == word
    except yaml.YAMLError:
        plain = False
    return word if plain else DoubleQuotedScalarString(word)


class _Written(float):
    """A number as it stands in the file, digit by digit."""

    text: str


class _Constructor(RoundTripConstructor):
    """Keeps the text of every number that stays."""

    def written(self, node: Any) -> _Written:
        number = _Written(self.construct_yaml_float(node))
        number.text = node.value
        return number


class _Representer(RoundTripRepresenter):
    """Writes numbers so that YAML 1.1 and 1.2 read them back to the last bit."""

    def written(self, number: _Written) -> Any:
        return self.represent_scalar(_FLOAT, number.text)

    def plain(self, number: float) -> Any:
        text = repr(number)
        return self.represent_scalar(_FLOAT, text if "." in text else text.replace("e", ".0e"))


_FLOAT = "tag:yaml.org,2002:float"
_Constructor.add_constructor(_FLOAT, _Constructor.written)
_Representer.add_representer(_Written, _Representer.written)
_Representer.add_representer(float, _Representer.plain)
