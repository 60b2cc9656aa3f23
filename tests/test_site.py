"""The documentation site stands by itself, and its tutorials run."""

from __future__ import annotations

import json
import re
from importlib import util
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
SITE = ROOT / "out" / "site"
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))
built = pytest.mark.skipif(not (SITE / "index.html").is_file(), reason="the site is not built: make docs")


def execute() -> ModuleType:
    """docs/site/execute.py, which is a script."""
    path = ROOT / "docs" / "site" / "execute.py"
    spec = util.spec_from_file_location("execute", path)
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@built
def test_no_page_fetches_anything_from_elsewhere() -> None:
    fetched = re.compile(
        r'<(?:script|img|iframe)[^>]*\ssrc="(https?:[^"]*)"|<link[^>]*rel="stylesheet"[^>]*href="(https?:[^"]*)"'
    )
    found = {match for page in SITE.rglob("*.html") for match in fetched.findall(page.read_text())}
    assert found == set()


@built
def test_mathematics_is_drawn_by_the_browser_and_none_is_left_as_latex() -> None:
    pages = {page.name: page.read_text() for page in SITE.rglob("*.html")}
    assert "<math" in pages["grasp_search.html"]
    assert [name for name, text in pages.items() if 'class="arithmatex"' in text] == []


@built
def test_every_page_of_the_docs_is_in_the_navigation() -> None:
    """Or in a folder that is."""
    nav = (ROOT / "mkdocs.yml").read_text()
    docs = ROOT / "docs"
    pages = [path.relative_to(docs) for path in (*docs.rglob("*.md"), *TUTORIALS)]
    assert [page for page in pages if page.as_posix() not in nav and f" {page.parent.as_posix()}/\n" not in nav] == []


@built
def test_every_public_name_has_an_entry_in_the_reference() -> None:
    pages = {page.stem: page.read_text() for page in (SITE / "reference" / "api").glob("*.html")}
    entries = re.findall(r"^::: (\S+)$", "".join(map(Path.read_text, (ROOT / "docs/reference/api").glob("*.md"))), re.M)
    assert len(entries) > 20
    text = "".join(pages.values())
    assert {name for name in entries if f'id="{name}"' not in text} == set()


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_shows_what_came_out_of_it_and_nothing_failed(path: Path) -> None:
    cells = [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
    assert any(cell["outputs"] for cell in cells)
    kinds = {output["output_type"] for cell in cells for output in cell["outputs"]}
    assert "error" not in kinds
    assert path.stat().st_size < 700_000


@pytest.mark.long
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_runs_from_an_empty_folder(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("nbclient", reason="the extra docs is not installed: make docs")
    if "train" in path.stem:
        pytest.importorskip("stable_baselines3", reason="the tutorial trains: extra rl")
    script = execute()
    assert script.failed(script.executed(path, tmp_path)) == []
