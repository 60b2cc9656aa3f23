"""One class name, one thing; no word that the field does not use is a name; every term of the glossary has a place."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

from tests.test_architecture import parsed

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "allegro_twin"
BANNED = {
    "told", "said", "asked", "wish", "wishes", "news", "word", "words", "seen", "looked", "eyes", "looks", "felt",
    "beside", "together", "thing", "things", "pieces", "way", "ways", "goes", "journey", "doubt", "doubts", "settled",
    "determined", "nothing", "itself", "happenings", "onlookers", "onlooker", "board", "shelves", "wheel", "door",
}  # fmt: skip
"""Words of LEXICON's last table and its relatives: not the name of a module, a class or a function."""


@cache
def names() -> tuple[tuple[str, str, str], ...]:
    """Every public module, class and function at the top of a module: kind, name and module."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        module = path.relative_to(PACKAGE).with_suffix("").as_posix()
        if path.name != "__init__.py":
            found.append(("module", path.stem, module))
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                found.append(("class" if isinstance(node, ast.ClassDef) else "function", node.name, module))
    return tuple(found)


def words(name: str) -> set[str]:
    """`SecondCamera` and `second_camera` as their words."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z0-9]+|[A-Z]+(?![a-z])", name)}


def clashes() -> dict[str, list[str]]:
    """Class names that stand in two modules or more."""
    places = defaultdict(list)
    for kind, name, module in names():
        if kind == "class":
            places[name].append(module)
    return {name: modules for name, modules in places.items() if len(modules) > 1}


def banned() -> set[str]:
    """Names of which a word is banned."""
    return {f"{module}:{name}" for kind, name, module in names() if words(name) & BANNED and kind != "module"} | {
        module for kind, name, module in names() if kind == "module" and words(name) & BANNED
    }


def test_no_class_name_stands_in_two_modules() -> None:
    assert clashes() == {}


def test_no_name_has_a_word_that_nobody_searches_for() -> None:
    assert banned() == set()


def test_every_term_of_the_glossary_has_a_sentence_and_a_place_that_exists() -> None:
    rows = re.findall(
        r"^\| \*\*(.+?)\*\* \| (.+?) \| (.+?) \|$", (ROOT / "docs/reference/glossary.md").read_text(), re.M
    )
    assert len(rows) > 80
    assert [term for term, *_ in rows] == sorted((term for term, *_ in rows), key=str.lower)
    for term, text, places in rows:
        assert 3 <= len(text.split()) <= 25, term
        for place in re.findall(r"`([^`]+)`", places):
            assert (PACKAGE / place).exists() or (ROOT / place).exists(), f"{term}: {place}"
