"""How YAML becomes typed settings: strict models, and one-line errors with file, path, value and nearest key."""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import read_yaml

S = TypeVar("S", bound="Settings")
Where: TypeAlias = str | Callable[[tuple[int | str, ...]], str]
"""The source that an error names: fixed, or made from the keys that lead to what is wrong, with its line say."""


class Settings(BaseModel):
    """Frozen settings in which an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def load(model: type[S], path: Path) -> S:
    """The settings in a YAML file. Raises ConfigError, one line for the first thing that is wrong."""
    return parse(model, read_yaml(path), str(path))


def parse(model: type[S], content: dict[str, Any], where: Where) -> S:
    """Settings from a mapping; `where` names its source in the error."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ConfigError(_explain(error, model, where)) from error


def _explain(error: ValidationError, model: type[BaseModel], source: Where) -> str:
    details = error.errors(include_url=False)
    # A key that is wrong is often one that is missed elsewhere: the cause before its consequence.
    details.sort(key=lambda detail: detail["type"] != "extra_forbidden")
    first, more = details[0], len(details) - 1
    where = source if isinstance(source, str) else source(first["loc"])
    location = ".".join(str(part) for part in first["loc"]) or "(top)"
    tail = f" ({more} more)" if more else ""
    if first["type"] == "extra_forbidden":
        keys = _keys(model, first["loc"][:-1])
        near = get_close_matches(str(first["loc"][-1]), keys, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"known keys: {', '.join(sorted(keys))}"
        return f"{where}: {location}: unknown key; {hint}{tail}"
    if first["type"] == "missing":
        return f"{where}: {location}: missing{tail}"
    message = first["msg"][0].lower() + first["msg"][1:]
    if not first["loc"]:  # About the whole, and it names what it is about.
        return f"{where}: {message.removeprefix('value error, ')}{tail}"
    value = repr(first["input"])
    shown = value if len(value) <= 60 else value[:57] + "..."
    return f"{where}: {location}: {message.removeprefix('value error, ')}, not {shown}{tail}"


def _keys(model: Any, location: tuple[int | str, ...]) -> list[str]:
    """Every key known at a place in nested settings; a place inside a union knows the keys of all that fit."""
    models = _models(model)
    for part in location:
        inner = [m.model_fields[part].annotation for m in models if isinstance(part, str) and part in m.model_fields]
        if inner:  # Anything else is an index, or the tag of a union that pydantic puts into the path.
            models = [found for annotation in inner for found in _models(annotation)]
        elif isinstance(part, str):
            tagged = [m for m in models if part in get_args(getattr(m.model_fields.get("kind"), "annotation", None))]
            models = tagged or models
    return sorted({name for m in models for name in m.model_fields})


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (list, tuple, Union, dict) or get_args(annotation):
        return [found for argument in get_args(annotation) for found in _models(argument)]
    return []
