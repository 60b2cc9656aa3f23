"""YAML as typed settings: strict models, errors in one line with file, key and nearest name, and JSON Schema."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeAlias, TypeVar, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import read_yaml

S = TypeVar("S", bound="Settings")
Where: TypeAlias = str | Callable[[tuple[int | str, ...]], str]
"""The source that an error names: fixed, or made from the keys that lead to what is wrong, with its line say."""

PerJoint = float | list[float]
"""One value for all joints, or one for each."""
Positive = Annotated[float, Field(gt=0)]
Seed = Annotated[int, Field(ge=0)]
"""Seed of random numbers; NumPy takes none below 0."""
Vector3 = tuple[float, float, float]
MOST_GRAVITY = 30.0
"""m/s². The most on a planet is Jupiter's, 24.8."""


def check_gravity(vector: Vector3) -> Vector3:
    """Raises ValueError for a gravity, m/s², that no planet has, as one in mm/s²."""
    if (size := math.hypot(*vector)) > MOST_GRAVITY:
        raise ValueError(
            f"gravity {list(vector)} is {size:g} m/s² strong, and on no planet it is more than {MOST_GRAVITY:g} "
            "(Earth: 9.81): give it in m/s²"
        )
    return vector


Gravity = Annotated[Vector3, AfterValidator(check_gravity)]
"""m/s²."""
_OTHER_UNIT = {
    "m": "in mm, divide it by 1000", "m/s": "in mm/s, divide it by 1000", "s": "in ms, divide it by 1000",
    "kg": "in g, divide it by 1000", "N·m": "in mN·m, divide it by 1000", "rad": "in degrees, divide it by 57.3",
    "rad/s": "in degrees/s, divide it by 57.3",
}  # fmt: skip


def at_most(most: float, unit: str) -> AfterValidator:
    """Bound of a number in a unit that is beyond all use, so that a larger number has another unit."""

    def check(value: float) -> float:
        if value > most:
            other = f" (if it is {_OTHER_UNIT[unit]})" if unit in _OTHER_UNIT else ""
            raise ValueError(f"it is in {unit}, here at most {most:g}{other}")
        return value

    return AfterValidator(check)


Probability = Annotated[float, Field(ge=0, le=1)]


class Settings(BaseModel):
    """Frozen settings in which an unknown key is an error. The text below a field describes it in the schema."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)

    another_kind: ClassVar[str] = ""
    """A key of files that stand in the same folder and are of another kind; a schema leaves them alone."""

    @model_validator(mode="wrap")
    @classmethod
    def _no_truth_for_numbers(cls, values: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """pydantic takes a truth value for 0 or 1, and YAML takes yes, no, on and off for truth values."""
        found = handler(values)
        if isinstance(values, Mapping):
            for name, value in values.items():
                if isinstance(name, str) and (place := _taken_for_number(value, getattr(found, name, value), name)):
                    raise ValueError(f"{place}: must be a number, and YAML's yes, no, on, off, true and false are none")
        return found


def _taken_for_number(given: Any, found: Any, place: str) -> str:
    """Where a truth value has become something else; empty where none has."""
    if isinstance(given, bool):
        return "" if isinstance(found, bool) else place
    if isinstance(given, list | tuple) and isinstance(found, list | tuple) and len(given) == len(found):
        pairs: Iterator[tuple[Any, Any, Any]] = (
            (k, one, other) for k, (one, other) in enumerate(zip(given, found, strict=True))
        )
    elif isinstance(given, Mapping) and isinstance(found, Mapping):
        pairs = ((key, value, found[key]) for key, value in given.items() if key in found)
    else:
        return ""
    return next(filter(None, (_taken_for_number(one, other, f"{place}.{key}") for key, one, other in pairs)), "")


def load_settings(model: type[S], path: Path) -> S:
    """The settings in a YAML file. Raises ConfigError, one line for the first thing that is wrong."""
    return parse_settings(model, read_yaml(path), str(path))


def parse_settings(model: type[S], content: dict[str, Any], where: Where) -> S:
    """Settings from a mapping; `where` names its source in the error."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ConfigError(_explain(error, model, where, content)) from error


_SHOWN = 5
"""Mistakes that are named in an error; the rest are counted."""


def _explain(error: ValidationError, model: type[BaseModel], source: Where, content: Any) -> str:
    details = _causes(_nearest_tuples(error.errors(include_url=False)))
    # A key that is wrong is often one that is missed elsewhere: the cause before its consequence.
    details.sort(key=lambda detail: detail["type"] != "extra_forbidden")
    where = source if isinstance(source, str) else source(details[0]["loc"])
    text = "; ".join(_mistake(detail, model, content) for detail in details[:_SHOWN])
    more = len(details) - _SHOWN
    return f"{where}: {text}{f'; and {more} more' if more > 0 else ''}"


def _nearest_tuples(details: list[Any]) -> list[Any]:
    """Where a value may be a tuple of several lengths, pydantic has mistakes for each of them and names the type in
    the place: only those of the length that fits, or else has the fewest, at the place without the type."""
    counts: dict[tuple[Any, Any], tuple[int, int]] = {}
    found = []
    for detail in details:
        place = detail["loc"]
        at = next((k for k, part in enumerate(place) if str(part).startswith("tuple[")), None)
        tag = None if at is None else (place[:at], place[at])
        if tag is not None:
            wrong_length, count = counts.get(tag, (0, 0))
            counts[tag] = (wrong_length + (detail["type"] in ("missing", "too_long", "too_short")), count + 1)
        found.append((tag, detail if at is None else detail | {"loc": place[:at] + place[at + 1 :]}))

    def nearest(tag: tuple[Any, Any]) -> bool:
        rivals = [each for each in counts if each[0] == tag[0]]
        return tag == min(rivals, key=counts.__getitem__)

    return [detail for tag, detail in found if tag is None or nearest(tag)]


def _causes(details: list[Any]) -> list[Any]:
    """Without the containers that are only too short because one of their elements is wrong."""
    places = [detail["loc"] for detail in details]

    def follows(detail: Any) -> bool:
        here = detail["loc"]
        inside = (place for place in places if len(place) > len(here) and place[: len(here)] == here)
        return detail["type"] == "too_short" and any(inside)

    return [detail for detail in details if not follows(detail)]


def _mistake(detail: Any, model: type[BaseModel], content: Any) -> str:
    place = detail["loc"]
    location = ".".join(_written(place, content)) or "(top)"
    if detail["type"] == "extra_forbidden":
        keys = _keys(model, place[:-1])
        near = get_close_matches(str(place[-1]), keys, n=1, cutoff=0.5)
        return f"{location}: unknown key; " + (
            f"did you mean {near[0]!r}?" if near else f"known keys: {', '.join(sorted(keys))}"
        )
    if detail["type"] == "missing":
        return f"{location}: missing"
    message = str(detail["msg"][0].lower() + detail["msg"][1:])
    if not place:  # About the whole, and it names what it is about.
        return message.removeprefix("value error, ")
    if detail["type"] == "unknown_kind":  # It names the kind.
        return f"{location}: {message}"
    if detail["type"] == "value_error" and isinstance(detail["input"], dict):  # It names the key.
        return f"{location}: {message.removeprefix('value error, ')}"
    value = repr(detail["input"])
    shown = value if len(value) <= 60 else value[:57] + "..."
    return f"{location}: {message.removeprefix('value error, ')}, not {shown}"


def _written(place: tuple[int | str, ...], content: Any) -> Iterator[str]:
    """The keys of a place as they stand in the file: without the kinds that pydantic puts behind the key of a union,
    and which are the value of a key there."""
    for part in place:
        here = content if isinstance(content, dict) else {}
        if isinstance(part, str) and part not in here and part in [v for v in here.values() if isinstance(v, str)]:
            continue
        content = here.get(part) if isinstance(content, dict) else _element(content, part)
        yield str(part)


def _element(content: Any, part: int | str) -> Any:
    within = isinstance(content, list | tuple) and isinstance(part, int) and part < len(content)
    return content[part] if within else None


def _keys(model: Any, location: tuple[int | str, ...]) -> list[str]:
    """Every key known at a place in nested settings; a place inside a union knows the keys of all that fit."""
    models = models_in(model)
    for part in location:
        inner = [m.model_fields[part] for m in models if isinstance(part, str) and part in m.model_fields]
        if inner:  # Anything else is an index, or the tag of a union that pydantic puts into the path.
            models = [found for field in inner for found in models_in(field.annotation)]
            models += [found for field in inner for each in field.metadata for found in getattr(each, "models", list)()]
        elif isinstance(part, str):
            tagged = [m for m in models if part in get_args(getattr(m.model_fields.get("kind"), "annotation", None))]
            models = tagged or models
    return sorted({name for m in models for name in m.model_fields})


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """Every model in a field's annotation: itself, or those of a union or a container."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (list, tuple, Union, dict) or get_args(annotation):
        return [found for argument in get_args(annotation) for found in models_in(argument)]
    return []


def first_difference(theirs: dict[str, Any], ours: dict[str, Any], above: str = "") -> str:
    """The first value that is another, in words; empty where there is none."""
    for key in [*ours, *(theirs.keys() - ours.keys())]:
        one, other = theirs.get(key), ours.get(key)
        if isinstance(one, dict) and isinstance(other, dict):
            if deeper := first_difference(one, other, f"{above}{key}."):
                return deeper
        elif one != other:
            return f"{above}{key} {one}, and these have {other}"
    return ""


def json_schema(model: type[Settings], title: str) -> dict[str, Any]:
    """The JSON Schema of a file that is read into a model: keys, types and ranges. What the model checks beyond them is
    reported when the file is read."""
    schema = model.model_json_schema()
    for part in (schema, *schema.get("$defs", {}).values(), *_inlined(schema)):
        for content in part.get("properties", {}).values():
            if "description" in content:
                content["description"] = " ".join(content["description"].split())
    if model.another_kind:
        schema = _unless(model.another_kind, schema)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema | {"title": title}


def _inlined(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Models that stand in a union itself: those of installed packages."""
    for content in schema.get("properties", {}).values():
        yield from (each for each in content.get("oneOf", ()) if "title" in each)


def _unless(key: str, schema: dict[str, Any]) -> dict[str, Any]:
    """A schema that holds for files without a key, which says that a file is of another kind; with all keys where
    editors look for their texts."""
    whole = {name: content for name, content in schema.items() if name != "$defs"}
    texts = {name: {"description": each["description"]} for name, each in schema["properties"].items()
             if "description" in each}  # fmt: skip
    return {"type": "object", "properties": texts, "$defs": schema.get("$defs", {}),
            "if": {"required": [key]}, "else": whole}  # fmt: skip
