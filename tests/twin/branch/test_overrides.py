"""`branch --set key=value`: what may be otherwise, from text."""

from __future__ import annotations

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.twin.branch.overrides import parse_changes


def test_physics_are_numbers_and_a_controllers_keys_are_as_in_a_config() -> None:
    texts = ["friction=0.5", "strength=0", "damping=2", "controller.gains=v4", "controller.kp=[1, 2]"]
    assert parse_changes(texts) == {
        "friction": 0.5,
        "strength": 0,
        "damping": 2,
        "controller.gains": "v4",
        "controller.kp": [1, 2],
    }
    assert parse_changes([]) == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("friction", "say key=value"),
        ("=0.5", "say key=value"),
        ("fricton=0.5", "did you mean 'friction'"),
        ("gains=v4", "no key named 'gains'"),
        ("friction=much", "friction needs a number, not much"),
        ("friction=true", "friction needs a number, not true"),
        ("friction=-0.1", "friction is 0 or more"),
        ("friction=.inf", "friction is 0 or more"),
        ("friction=.nan", "friction is 0 or more"),
    ],
)
def test_what_cannot_be_is_named(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=f"^--set {text}: .*{said}"):
        parse_changes([text])


def test_a_key_that_is_given_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"--set strength=1.0: strength is given twice: say it once"):
        parse_changes(["strength=0.5", "friction=0.4", "strength=1.0"])
