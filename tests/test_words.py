"""One class name, one thing; no word that the field does not use is a name; every term of the glossary has a place;
every docstring is understood alone."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.test_architecture import parsed

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "allegro_twin"
BANNED = {
    "told", "said", "asked", "wish", "wishes", "news", "word", "words", "seen", "looked", "eyes", "looks", "felt",
    "beside", "together", "thing", "things", "pieces", "way", "ways", "goes", "journey", "doubt", "doubts", "settled",
    "determined", "nothing", "itself", "happenings", "onlookers", "onlooker", "board", "shelves", "wheel", "door",
}  # fmt: skip
"""Words of LEXICON's last table and its relatives: not the name of a module, a class or a function."""


QUESTION = re.compile(r"(What|How|Which|Where|From|Who|When|Whose)\b(?!-)")
"""Openings of the docstring of a module or a class that name no topic (rule 17)."""
RELATIVE = re.compile(r"(Of|Likewise|The same)\b")
"""Openings of a docstring that is not understood without the line above it, as in a tooltip."""
FILE_KEYS = {"hands/description/mounts:MountCameraSettings.looks", "learning/training/settings:Recipe.looked_at"}
"""Members that are keys of users' YAML files: `camera.looks` of a mount, `looked_at` of a recipe."""
DUNDER = {"__init__", "__call__"}


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


def members(node: ast.ClassDef) -> set[str]:
    """Public fields and methods of a class, and parameters of the methods as `method(name)`."""
    found = set()
    for each in node.body:
        if isinstance(each, ast.AnnAssign | ast.Assign):
            targets = each.targets if isinstance(each, ast.Assign) else [each.target]
            found |= {target.id for target in targets if isinstance(target, ast.Name)}
        elif isinstance(each, ast.FunctionDef) and (not each.name.startswith("_") or each.name in DUNDER):
            found |= {each.name} - DUNDER | parameters(each)
    for inner in ast.walk(node):
        if isinstance(inner, ast.Attribute) and isinstance(inner.ctx, ast.Store) and ast.unparse(inner.value) == "self":
            found.add(inner.attr)
    return {name for name in found if name.partition("(")[0] in DUNDER or not name.startswith("_")}


def parameters(node: ast.FunctionDef) -> set[str]:
    every = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return {f"{node.name}({each.arg})" for each in every}


@cache
def banned_members() -> frozenset[str]:
    """Public fields, methods and parameters of which a word is banned, as `module:Class.name` or `module:f(name)`."""
    found = set()
    for path in sorted(PACKAGE.rglob("*.py")):
        module = path.relative_to(PACKAGE).with_suffix("").as_posix()
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found |= {(f"{module}:{node.name}.{name}", name) for name in members(node)}
            elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                found |= {(f"{module}:{name}", name) for name in parameters(node)}
    return frozenset(full for full, name in found if words(name.partition("(")[2] or name) & BANNED)


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


def test_no_field_method_or_parameter_gets_a_word_that_nobody_searches_for() -> None:
    assert banned_members() == FILE_KEYS


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


def docstrings() -> Iterator[tuple[str, str, bool]]:
    """Place, text, and whether it is a module's or a class's, of every docstring, those of fields included."""
    for path in sorted(PACKAGE.rglob("*.py")):
        name, module = path.relative_to(PACKAGE).as_posix(), parsed(path)
        things = {
            id(node.body[0]) for node in ast.walk(module) if isinstance(node, ast.Module | ast.ClassDef) and node.body
        }
        for node in ast.walk(module):
            if (
                isinstance(node, ast.Expr)
                and isinstance(node.value, ast.Constant)
                and isinstance(node.value.value, str)
            ):
                yield f"{name}:{node.lineno}", node.value.value, id(node) in things


def openings() -> dict[str, str]:
    """Docstrings that do not say what they are about, by their place."""
    return {
        place: text.split("\n")[0]
        for place, text, thing in docstrings()
        if RELATIVE.match(text) or (thing and QUESTION.match(text))
    }


def test_every_docstring_says_what_it_is_about_without_the_line_above_it() -> None:
    assert openings() == {}, "begin with a noun or a verb: 'Mass of the object, kg.', not 'Of the object, kg.'"


@pytest.mark.parametrize(
    ("text", "thing"),
    [
        ("Of the arm, m.", False),
        ("Likewise the palm.", False),
        ("The same with limits.", False),
        ("What a hand says.", True),
    ],
)
def test_an_opening_that_names_no_topic_is_found(text: str, thing: bool) -> None:
    assert RELATIVE.match(text) or (thing and QUESTION.match(text))
    assert not QUESTION.match("What-if branches: a recording continues differently.")
