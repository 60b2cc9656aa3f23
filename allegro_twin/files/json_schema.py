"""Settings as JSON Schema, with what the code says of every key, for editors that complete and check YAML."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

from allegro_twin.files.schema import Settings


def json_schema(model: type[Settings], title: str) -> dict[str, Any]:
    """Of a file that is read into a model. It knows keys, types and ranges; what the model checks beyond them is said
    when the file is read."""
    schema = model.model_json_schema()
    known = {each.__name__: each for each in _family(Settings)}
    for name, part in [(model.__name__, schema), *schema.get("$defs", {}).items(), *_inlined(schema)]:
        if name in known:
            _describe(part, known[name])
    if model.another_kind:
        schema = _unless(model.another_kind, schema)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema | {"title": title}


def _inlined(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Models that stand in a union itself: those of installed packages."""
    for content in schema.get("properties", {}).values():
        for each in content.get("oneOf", ()):
            if "title" in each:
                yield each["title"], each


def _unless(key: str, schema: dict[str, Any]) -> dict[str, Any]:
    """A schema that holds for files without a key, which says that a file is of another kind; with all keys where
    editors look for their texts."""
    whole = {name: content for name, content in schema.items() if name != "$defs"}
    texts = {name: {"description": each["description"]} for name, each in schema["properties"].items()
             if "description" in each}  # fmt: skip
    return {"type": "object", "properties": texts, "$defs": schema.get("$defs", {}),
            "if": {"required": [key]}, "else": whole}  # fmt: skip


def _describe(part: dict[str, Any], model: type[Settings]) -> None:
    """Put the text that stands below each field into its property."""
    texts: dict[str, str] = {}
    for each in reversed(model.__mro__):
        if issubclass(each, Settings):
            texts |= dict(_docstrings(each))
    for key, content in part.get("properties", {}).items():
        if key in texts:
            content["description"] = texts[key]


def _docstrings(model: type[Settings]) -> Iterator[tuple[str, str]]:
    tree = ast.parse(textwrap.dedent(inspect.getsource(model)))
    assert isinstance(tree.body[0], ast.ClassDef)
    for field, text in pairwise(tree.body[0].body):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
            and isinstance(text.value.value, str)
        ):
            yield field.target.id, " ".join(text.value.value.split())


def _family(model: type[Settings]) -> Iterator[type[Settings]]:
    for each in model.__subclasses__():
        yield each
        yield from _family(each)
