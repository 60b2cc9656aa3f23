"""Every block in the docs runs as it stands: Python, commands, YAML and files, page by page in an empty folder.

A comment in the Markdown before a block says what is different about it:

    <!-- test: slow -->             the block runs in `make test-slow`; `long`: in `make test-long`
    <!-- test: skip hardware -->    it does not run, for one of the REASONS; the parser still checks its commands
    <!-- test: schema config -->    YAML of this kind (SCHEMAS); `schema config fragment`: a part of such a file

A first line `# name.py` (or `<!-- name.xml -->`) gives a block a file name; later blocks of the page find that file.
"""

from __future__ import annotations

import ast
import json
import os
import re
import runpy
import shlex
import sys
import textwrap
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml

from allegro_twin.app.config import RunConfig
from allegro_twin.cell.calibration.pictures import CalibrationFolder
from allegro_twin.cell.camera.settings import DepthCameraSettings
from allegro_twin.cell.settings import LabSettings
from allegro_twin.files.schema import Settings, parse_settings
from allegro_twin.grasping.scenario import Scenario, TrialProtocol
from allegro_twin.learning.training.settings import Recipe
from allegro_twin.surfaces.cli import completion
from tests.surfaces.cli.conftest import Run, command
from tests.surfaces.cli.wrong import built

__all__ = ["command"]  # The command line in this process, as a fixture.
ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "plugins").glob("*/README.md")]
    + [page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "api"]
)
KINDS = {"tutorials", "how-to", "reference", "explanation", "results"}
LANGUAGES = {"python", "sh", "yaml", "xml", "text"}
REASONS = {
    "extra": "needs an extra that `dev` lacks",
    "forever": "serves until Ctrl-C",
    "gpu": "needs an NVIDIA GPU",
    "hardware": "needs a hand, an arm or an adapter",
    "minutes": "takes many minutes",
    "ros": "needs a ROS installation",
    "screen": "needs a screen or a browser",
    "system": "changes the computer, or depends on it",
    "yours": "needs a file of the reader's",
}
SCHEMAS: dict[str, type[Settings]] = {
    "calibration": CalibrationFolder,
    "camera": DepthCameraSettings,
    "config": RunConfig,
    "lab": LabSettings,
    "protocol": TrialProtocol,
    "recipe": Recipe,
    "scenario": Scenario,
}
WHOLE = {
    "camera": ROOT / "conf/cameras/d435i_table.yaml",
    "config": ROOT / "conf/sim_right.yaml",
    "lab": ROOT / "conf/lab_allegro.yaml",
    "scenario": ROOT / "scenarios/demo/lemon.yaml",
}
"""Files that complete a fragment."""
SUFFIXES = {".arrow", ".bag", ".csv", ".log", ".mcap", ".npy", ".npz", ".obj", ".onnx", ".stl", ".xml", ".yaml", ".zip"}
WRITTEN = {"out", "record", "image", "video", "rrd", "wire_log", "report", "film", "into", "keep", "target", "folder"}
"""Parameters that name what a command writes."""
DEFAULT_FOLDERS = {
    "plan": "plans",
    "new": "mine",
    "hand": "mine",
    "improve": "improved",
    "train": "runs",
    "excite": "out",
}
TESTED_ELSEWHERE = {"docs/contract.md", "docs/design.md"}
"""Pages whose blocks have tests of their own, or are drawings."""
FENCE = re.compile(
    r"^(?P<indent> *)(?:<!-- test: (?P<tag>.*?) -->\n *)?```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^ *```$", re.M | re.S
)
NAME = re.compile(r"(?:# |<!-- )([\w./-]+\.\w+)(?: -->)?\n")


class Block(NamedTuple):
    """A fenced block of a page."""

    page: Path
    line: int
    language: str
    tag: tuple[str, ...]
    text: str

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    @property
    def file(self) -> str:
        """The name of its file; empty without one."""
        found = NAME.match(self.text)
        return found[1] if found else ""

    @property
    def tier(self) -> str:
        """`fast`, `slow`, `long`, or `skip`."""
        return self.tag[0] if self.tag and self.tag[0] in ("slow", "long", "skip") else "fast"


@cache
def blocks(page: Path) -> tuple[Block, ...]:
    text = page.read_text() if page.relative_to(ROOT).as_posix() not in TESTED_ELSEWHERE else ""
    found = []
    for each in FENCE.finditer(text):
        body = textwrap.dedent(each["text"])
        line = text.count("\n", 0, each.start()) + 1
        found.append(Block(page, line, each["language"], tuple((each["tag"] or "").split()), body))
    return tuple(found)


ALL = [block for page in PAGES for block in blocks(page)]


def commands(text: str) -> Iterator[list[str]]:
    """The words of each simple command of a shell block."""
    lines = text.replace("\\\n", " ").split("\n")
    for line in lines:
        words = shlex.split(line, comments=True)
        part: list[str] = []
        for word in [*words, "&&"]:
            if word in ("&&", ";", "&", "|"):
                if part:
                    yield part
                part = []
            else:
                part.append(word)


def test_every_block_has_a_language_and_a_tag_that_is_known() -> None:
    wrong = [block.place for block in ALL if block.language not in LANGUAGES]
    assert wrong == []
    for block in ALL:
        if block.tier == "skip":
            assert len(block.tag) == 2, block.place
            assert block.tag[1] in REASONS, block.place
        elif block.tag and block.tag[0] == "schema":
            assert block.language == "yaml", block.place
            assert block.tag[1] in {*SCHEMAS, "library", "none"}, block.place
        else:
            assert block.tag in ((), ("slow",), ("long",)), block.place


def test_every_comment_for_the_tests_stands_before_a_block() -> None:
    for page in (each for each in PAGES if each.relative_to(ROOT).as_posix() not in TESTED_ELSEWHERE):
        meant = len(re.findall(r"^ *<!-- test: ", page.read_text(), re.M))
        assert page.relative_to(ROOT).as_posix() in TESTED_ELSEWHERE or meant == sum(
            bool(block.tag) for block in blocks(page)
        ), page


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.parent.name in KINDS], ids=lambda page: f"{page.parent.name}/{page.stem}"
)
def test_a_page_says_of_which_kind_it_is_in_its_first_lines(page: Path) -> None:
    kind = page.parent.name.capitalize()
    assert re.match(rf"# .+\n\n\*{kind}\b", page.read_text()), f"begin with `# Title` and `*{kind}: …*`"


@pytest.mark.parametrize("page", sorted((ROOT / "docs/how-to").glob("*.md")), ids=lambda page: page.stem)
def test_a_how_to_is_short(page: Path) -> None:
    prose = re.sub(r"^```.*?^```$|^\|.*$", "", page.read_text(), flags=re.M | re.S)
    assert len(prose.split()) <= 600


def anchors(page: Path) -> set[str]:
    """As GitHub and the site make them from headings, and those that are written."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S)
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"[`*]", "", head)) for head in heads]
    made = {re.sub(r"[^\w\- ]", "", head.strip().lower()).replace(" ", "-") for head in plain}
    return made | set(re.findall(r'<a id="([^"]+)"', text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_page_and_an_anchor_that_exist(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S)
    wrong = []
    for link in re.findall(r'\]\(([^)\s]+)\)|src="([^"]+)"', text):
        target, _, anchor = "".join(link).partition("#")
        if target.startswith(("http:", "https:", "mailto:")):
            continue
        path = (page.parent / target).resolve() if target else page
        if not path.exists() or (anchor and path.suffix == ".md" and anchor not in anchors(path)):
            wrong.append("".join(link))
    assert wrong == []


def test_every_page_that_the_package_names_exists() -> None:
    """In messages, docstrings and the comments of configs."""
    wrong = []
    for folder in ("allegro_twin", "benchmarks", "conf", "models", "plugins", "ros", "scenarios", "studies", "tests"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix not in (".py", ".yaml", ".md", ".toml") or not path.is_file():
                continue
            for name, anchor in re.findall(r"\bdocs/([\w/-]+\.md)(?:#([\w-]+))?", path.read_text()):
                page = ROOT / "docs" / name
                if not page.is_file() or (anchor and anchor not in anchors(page)):
                    wrong.append(f"{path.relative_to(ROOT)}: docs/{name}#{anchor}")
    assert wrong == []


class Lines(NamedTuple):
    """The commands of a page so far."""

    files: set[str]
    """Files and folders that blocks made."""

    def exists(self, name: str) -> bool:
        made = any(name == each or name.startswith(f"{each.rstrip('/')}/") for each in self.files)
        return made or any((ROOT / folder / name).exists() for folder in ("", "conf"))


def check_command(words: list[str], lines: Lines, place: str, *, files: bool) -> None:
    """Parse a command as the program does. `files`: what it reads must exist, shipped or made on the page before."""
    root = built()
    name, rest = words[1], words[2:]
    if name.startswith("-"):
        return
    assert name in root.commands, f"{place}: no command {name}"
    each = root.commands[name]
    if hasattr(each, "commands"):
        assert rest[0] in each.commands, f"{place}: no command {name} {rest[0]}"
        each, rest = each.commands[rest[0]], rest[1:]
    # A command keeps the names of its option for help from the first time that it parses.
    with each.make_context(f"allegro-twin {name}", list(rest), help_option_names=["-h", "--help"]) as context:
        values = dict(context.params)
    if name in DEFAULT_FOLDERS:
        lines.files.add(DEFAULT_FOLDERS[name])
    read: list[str] = []
    written: list[str] = []
    for key, value in values.items():
        for item in value if isinstance(value, (list, tuple)) else [value]:
            if item is not None and not isinstance(item, (bool, int, float)):
                (written if key in WRITTEN else read).append(str(getattr(item, "value", item)))
    for item in read if files else ():
        if Path(item).suffix in SUFFIXES:
            assert lines.exists(item), f"{place}: {item} does not exist"
    for target in (values.get("targets") or ()) if files else ():
        known = target in completion.targets() or target in completion.policies() or target in completion.recipes()
        assert known or lines.exists(target), f"{place}: {target} is nothing that ships"
    lines.files.update(written)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_is_one_that_the_program_understands(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    python = "".join(block.text for block in blocks(page) if block.language == "python")
    lines = Lines({block.file for block in blocks(page) if block.file} | set(re.findall(r'"([\w./-]+\.\w+)"', python)))
    for block in blocks(page):
        if block.language == "sh":
            for words in commands(block.text):
                if words[0].endswith("allegro-twin"):
                    check_command(words, lines, block.place, files=block.tier != "skip")


@pytest.mark.parametrize("block", [block for block in ALL if block.language == "yaml"], ids=lambda block: block.place)
def test_a_yaml_block_is_valid(block: Block) -> None:
    content = yaml.safe_load(block.text)
    kind = block.tag[1] if block.tag else "config"
    if kind == "none":  # A kind of file that is read key by key.
        assert isinstance(content, dict)
        return
    if kind == "library":
        from allegro_twin.hands.library.entries import PostureFile, TrajectoryFile

        for entry in content["entries"].values():
            model: type[Settings] = TrajectoryFile if entry.get("kind") == "trajectory" else PostureFile
            parse_settings(model, entry, block.place)
        return
    if block.tag[2:] == ("fragment",):
        content = yaml.safe_load(WHOLE[kind].read_text()) | content
    parse_settings(SCHEMAS[kind], content, block.place)


class Place(NamedTuple):
    """Where the blocks of a page run."""

    folder: Path
    run: Run


def run_block(block: Block, place: Place) -> None:
    """Do what a block says, in the folder of its page. What is not Python or a command of ours is left out."""
    if block.language == "python":
        name = block.file or f"block_{block.line}.py"
        path = place.folder / name
        path.write_text(block.text)
        runpy.run_path(str(path), run_name="__main__")
        return
    for words in commands(block.text):
        if words[0] == "python" and words[1].endswith(".py"):
            runpy.run_path(words[1], run_name="__main__")
            continue
        assert words[0] == "allegro-twin", f"{block.place}: {words[0]} does not run here; tag it"
        code, _, errors = place.run(*words[1:])
        assert code in (0, 5), f"{block.place}: {' '.join(words)} ended with {code}: {errors}"


def through(page: Path, tier: str, place: Place) -> None:
    """Run the blocks of a page in order, with those of the cheaper tiers, which they may need."""
    tiers = {"fast": ("fast",), "slow": ("fast", "slow"), "long": ("fast", "slow", "long")}[tier]
    for block in blocks(page):
        if block.file and block.language != "python":
            (place.folder / block.file).write_text(block.text)
        if block.language in ("python", "sh") and block.tier in tiers:
            run_block(block, place)


def pages_of(tier: str) -> list[Any]:
    return [
        pytest.param(page, id=str(page.relative_to(ROOT)))
        for page in PAGES
        if any(block.language in ("python", "sh") and block.tier == tier for block in blocks(page))
    ]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Run) -> Place:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["block.py"])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(tmp_path)]))
    return Place(tmp_path, command)


@pytest.mark.usefixtures("short_films")
@pytest.mark.parametrize("page", pages_of("fast"))
def test_the_cheap_blocks_of_a_page_run(page: Path, place: Place) -> None:
    through(page, "fast", place)


@pytest.mark.slow
@pytest.mark.parametrize("page", pages_of("slow"))
def test_the_blocks_of_a_page_that_take_seconds_run(page: Path, place: Place) -> None:
    through(page, "slow", place)


@pytest.mark.long
@pytest.mark.parametrize("page", pages_of("long"))
def test_the_blocks_of_a_page_that_take_minutes_run(page: Path, place: Place) -> None:
    through(page, "long", place)


@pytest.mark.slow
@pytest.mark.parametrize("side", ["right", "left"])
def test_the_scenario_of_the_how_to_holds(side: str, place: Place) -> None:
    page = ROOT / "docs/how-to/write_a_scenario.md"
    block = next(block for block in blocks(page) if block.file == "my_scenario.yaml")
    (place.folder / block.file).write_text(block.text)
    code, shown, _ = place.run("run", block.file, "--side", side)
    assert (code, "% of the drift limits left" in shown) == (0, True)


def generated() -> dict[str, str]:
    """The pages of the reference that a script writes, as it writes them now."""
    made = runpy.run_path(str(ROOT / "docs/site/reference.py"))
    return {"commands.md": made["commands"](), "configs.md": made["configs"]()} | {
        f"api/{name}": text for name, text in made["api"]().items()
    }


def test_the_generated_reference_has_every_command_key_and_public_name() -> None:
    """The texts may be older: `make reference` writes them anew."""
    for name, text in generated().items():
        there = (ROOT / "docs/reference" / name).read_text()
        missing = set(re.findall(r"`[^`]+`", text)) - set(re.findall(r"`[^`]+`", there))
        names = {each for each in missing if re.fullmatch(r"`(--)?[A-Za-z_][\w-]*`", each)}
        assert names == set(), f"make reference: {name}"


def imported(text: str) -> Iterator[str]:
    """Every name that Python code imports from the package, dotted."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "allegro_twin":
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] == "allegro_twin")


@cache
def public() -> frozenset[str]:
    made = runpy.run_path(str(ROOT / "docs/site/reference.py"))
    names = {f"{package}.{name}" for package, each in made["packages"]().items() for name in each}
    return frozenset(names | {"allegro_twin", "allegro_twin.gym"})


def readers() -> Iterator[tuple[str, str]]:
    """Code outside of the package that readers learn from, with its place."""
    for block in ALL:
        if block.language == "python":
            yield block.place.rsplit(":", 1)[0], block.text
    for path in sorted((ROOT / "examples").glob("*.py")):
        yield str(path.relative_to(ROOT)), path.read_text()
    for folder in ("plugins", "studies"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if "tests" not in path.relative_to(ROOT).parts:
                yield str(path.relative_to(ROOT)), path.read_text()
    for path in sorted((ROOT / "docs/tutorials").glob("*.ipynb")):
        for cell in json.loads(path.read_text())["cells"]:
            if cell["cell_type"] == "code" and cell["source"][:1] != ["%%sh\n"]:
                yield str(path.relative_to(ROOT)), "".join(cell["source"])


@cache
def imports() -> dict[str, set[str]]:
    """The names of the package that each place imports; a study or a plugin is one place."""
    found: dict[str, set[str]] = {}
    for place, text in readers():
        parts = place.split("/")
        where = "/".join(parts[:2]) if parts[0] in ("plugins", "studies") else place
        found.setdefault(where, set()).update(imported(text))
    return found


@pytest.mark.parametrize("place", sorted(imports()))
def test_docs_examples_notebooks_plugins_and_studies_import_public_names_only(place: str) -> None:
    assert imports()[place] <= public(), f"{place}: import from the package or its wings"
