"""Tables of what needs no learning: a run replaces its own rows of a page, and no others."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.unlearned import chosen, put

OLD = ("| hand | task | nothing |", "|---|---|---|", "| `leap` | `Lift` | 48 % |", "| `sih` | `Lift` | 20 % |")
NEW = ("| hand | task | script |", "|---|---|---|", "| `leap` | `Lift` | 50 % |", "| `leap` | `Grasp` | 26 % |")


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "page.md"
    path.write_text("\n".join(("before", "<!-- hands -->", *OLD, "<!-- /hands -->", "after")) + "\n")
    return path


def test_rows_of_other_hands_stay(page: Path) -> None:
    put(NEW, [page], "hands", key=2)
    lines = (*NEW[:3], OLD[3], NEW[3])
    assert page.read_text() == "\n".join(("before", "<!-- hands -->", *lines, "<!-- /hands -->", "after")) + "\n"


def test_without_a_key_the_whole_table_is_replaced(page: Path) -> None:
    put(NEW, [page], "hands")
    assert page.read_text() == "\n".join(("before", "<!-- hands -->", *NEW, "<!-- /hands -->", "after")) + "\n"


def test_words_are_rows_and_pages_in_any_order(page: Path) -> None:
    assert chosen([str(page), "sih"], ("leap", "sih"), "hands") == (["sih"], [page])
    assert chosen([], ("leap", "sih"), "hands") == (["leap", "sih"], [])


def test_a_wrong_word_or_page_ends_before_anything_is_computed(page: Path) -> None:
    with pytest.raises(SystemExit, match="no row named 'Leap'; did you mean 'leap'"):
        chosen(["Leap"], ("leap", "sih"), "hands")
    with pytest.raises(SystemExit, match="has no <!-- tasks --> and <!-- /tasks -->: write both where the table is"):
        chosen(["leap", str(page)], ("leap", "sih"), "tasks")
    with pytest.raises(SystemExit, match=r"none.md: No such file"):
        chosen([str(page.with_name("none.md"))], ("leap", "sih"), "hands")
