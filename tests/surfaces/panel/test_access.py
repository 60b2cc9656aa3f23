"""From another computer only who knows the token comes in, and nobody guesses for long."""

from __future__ import annotations

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.panel.access import REST, TRIES, Access, TokenGate, checked

TOKEN = "a-token-of-some-length"


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_without_a_token_all_may_come_in() -> None:
    gate = TokenGate(None, Clock())
    assert gate.answer("127.0.0.1", "") is Access.WELCOME
    assert not gate.asks


@pytest.mark.parametrize("given", ["", "a", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "ä" * 22])
def test_only_the_token_opens(given: str) -> None:
    gate = TokenGate(TOKEN, Clock())
    assert gate.answer("10.0.0.1", given) is Access.WRONG
    assert gate.answer("10.0.0.1", TOKEN) is Access.WELCOME


def test_of_a_thousand_guesses_ten_are_looked_at() -> None:
    gate = TokenGate(TOKEN, Clock())
    answers = [gate.answer("10.0.0.1", f"guess-{k}") for k in range(1000)]
    assert answers.count(Access.WRONG) == TRIES
    assert answers.count(Access.ENOUGH) == 1000 - TRIES


def test_while_an_address_must_rest_not_even_the_token_opens_and_another_address_is_free() -> None:
    clock = Clock()
    gate = TokenGate(TOKEN, clock)
    for k in range(TRIES):
        gate.answer("10.0.0.1", f"guess-{k}")
    assert gate.answer("10.0.0.1", TOKEN) is Access.ENOUGH
    assert gate.answer("10.0.0.2", TOKEN) is Access.WELCOME
    clock.now += REST
    assert gate.answer("10.0.0.1", TOKEN) is Access.WELCOME


def test_who_brings_no_token_has_not_guessed() -> None:
    gate = TokenGate(TOKEN, Clock())
    assert [gate.answer("10.0.0.1", "") for _ in range(100)] == [Access.WRONG] * 100
    assert gate.answer("10.0.0.1", TOKEN) is Access.WELCOME


def test_guesses_from_a_million_addresses_do_not_fill_the_memory() -> None:
    gate = TokenGate(TOKEN, Clock())
    for k in range(5000):
        gate.answer(f"10.0.{k // 250}.{k % 250}", "guess")
    assert len(gate._wrong) <= 1024


@pytest.mark.parametrize(
    ("token", "message"), [("short", "has 5 characters"), ("with a space in its middle", "letters")]
)
def test_a_token_that_is_easy_or_does_not_fit_into_an_address_is_refused(token: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        checked(token)
