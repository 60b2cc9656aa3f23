"""What is wrong with a settings file is told once, at the place where it stands in the file."""

from __future__ import annotations

import math

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import Settings, json_schema, parse_settings


class Place(Settings):
    at: tuple[float, float] | tuple[float, float, float]


@pytest.mark.parametrize(("at", "said"), [
    ((math.nan, 0.0), "file: at.0: input should be a finite number, not nan"),
    ((0.0, 0.0, "x"), "file: at.2: input should be a valid number, unable to parse string as a number, not 'x'"),
])  # fmt: skip
def test_a_mistake_in_a_place_of_two_or_three_numbers_is_told_once_and_without_types(
    at: tuple[object, ...], said: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_settings(Place, {"at": at}, "file")
    assert str(refused.value) == said


class Numbers(Settings):
    one: float = 0.0
    whole: int = 0
    row: tuple[float, ...] = ()
    table: dict[str, list[float]] | None = None
    on: bool = False
    either: bool | str = False
    inner: Place | None = None


@pytest.mark.parametrize(
    ("content", "place"),
    [
        ({"one": True}, "one"), ({"whole": False}, "whole"), ({"row": [1.0, True]}, "row.1"),
        ({"table": {"index": [0.0, False]}}, "table.index.1"), ({"inner": {"at": [True, 0.0]}}, "at.0"),
    ],
)  # fmt: skip
def test_a_truth_value_is_no_number_and_yaml_says_yes_for_one(content: dict[str, object], place: str) -> None:
    with pytest.raises(ConfigError, match=f"{place}: must be a number, and YAML's yes, no, on, off"):
        parse_settings(Numbers, content, "file")


def test_a_truth_value_stays_one_where_it_is_asked_for() -> None:
    found = parse_settings(Numbers, {"on": True, "either": True, "row": [1, 2]}, "file")
    assert (found.on, found.either, found.row) == (True, True, (1.0, 2.0))


def test_two_settings_of_one_name_keep_the_texts_below_their_own_fields() -> None:
    def first() -> type[Settings]:
        class Part(Settings):
            size: float = 0.0
            """m, of the
            first."""

        return Part

    def second() -> type[Settings]:
        class Part(Settings):
            size: float = 0.0
            """m, of the second."""

        return Part

    texts = [json_schema(part, "part")["properties"]["size"]["description"] for part in (first(), second())]
    assert texts == ["m, of the first.", "m, of the second."]
