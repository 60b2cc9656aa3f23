"""What goes wrong without ending a session is counted, logged once and told in words."""

from __future__ import annotations

import dataclasses
import logging

import pytest

from allegro_twin.drivers.can.driver.health import Health


def test_only_the_first_of_its_kind_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    health = Health()
    with caplog.at_level(logging.WARNING):
        for _ in range(1000):
            health.note("malformed", "frame 080#01 is malformed")
        health.note("unknown", "frame 7FF#")
    assert [record.message for record in caplog.records] == [
        "malformed: frame 080#01 is malformed",
        "unknown: frame 7FF#",
    ]
    assert (health.malformed, health.unknown) == (1000, 1)


def test_trouble_is_told_in_words_and_its_absence_is_silent() -> None:
    assert Health(states=100).lines() == []
    assert Health(states=100, missed=2, unsent=1).lines() == [
        "2 periods without a state",
        "1 commands that the full transmit queue did not take",
    ]


def test_nothing_has_gone_wrong_at_first_and_every_kind_of_trouble_has_its_line() -> None:
    names = [field.name for field in dataclasses.fields(Health)]
    assert [getattr(Health(), name) for name in names] == [0] * len(names)
    assert len(Health(**dict.fromkeys(names, 3)).lines()) == len(names) - 1  # States are no trouble.
    assert all(line.startswith("3 ") for line in Health(**dict.fromkeys(names, 3)).lines())
