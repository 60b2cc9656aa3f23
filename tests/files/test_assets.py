"""YAML files: what is refused with its line, and what is read as YAML 1.2 has it."""

from __future__ import annotations

from pathlib import Path

import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import parse_yaml, read_yaml


@pytest.mark.parametrize("word", ["010", "-007", "0_7", "00", "1:30", "-1:30.5", "12:00:00"])
def test_a_number_that_two_versions_of_yaml_read_differently_is_refused_with_its_line(word: str) -> None:
    with pytest.raises(ConfigError, match=rf"^F:2: not valid YAML: {word} is one number in YAML 1\.1 and another"):
        parse_yaml(f"b: 1\na: {word}", "F")
    assert parse_yaml(f"a: '{word}'", "F") == {"a": word}


def test_plain_numbers_dates_and_merged_mappings_are_read() -> None:
    text = "a: [0, -1, 0.5, .5, 1_000, 0x10, 1.5e-3, .inf]\nday: 2026-13-45\nb: &b {x: 1, y: 1}\nc: {<<: *b, y: 2}"
    numbers = [0, -1, 0.5, 0.5, 1000, 16, 0.0015, float("inf")]
    assert parse_yaml(text, "F") == {"a": numbers, "day": "2026-13-45", "b": {"x": 1, "y": 1}, "c": {"x": 1, "y": 2}}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("? [a, b]\n: 2", "F:1: not valid YAML: a key is one word, not a list or a mapping"),
        ("a: 1\n? {b: c}\n: 2", "F:2: not valid YAML: a key is one word, not a list or a mapping"),
        ("a: " + 5000 * "9", "F:1: not valid YAML: 99999999999999999999... is no int"),
        ("a: !!int x", "F:1: not valid YAML: x is no int"),
        ("a: !!bool x", "F:1: not valid YAML: x is no bool"),
        ("a: " + 3000 * "[" + 3000 * "]", "F: lists and mappings are nested too deep to be read"),
        ("# nothing\n", "F: is empty; it must hold a mapping of keys to values"),
        ("[1]", "F: must hold a mapping of keys to values, not list"),
    ],
)
def test_what_holds_no_mapping_of_words_is_one_line(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse_yaml(text, "F")
    assert str(refused.value) == message


def test_a_file_in_another_encoding_is_to_be_saved_as_utf_8(tmp_path: Path) -> None:
    (file := tmp_path / "mine.yaml").write_text("a: 1\n", encoding="utf-16")
    with pytest.raises(ConfigError, match=r"mine\.yaml: cannot be read: it is not UTF-8 text; save it as UTF-8$"):
        read_yaml(file)
