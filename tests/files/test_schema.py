"""What is wrong with a settings file is told once, at the place where it stands in the file."""

from __future__ import annotations

import math

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import Settings, parse_settings


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
