"""Hooks of the site: folders in the navigation, formulas as MathML, no links to files outside of the pages."""

from __future__ import annotations

import html
import posixpath
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

_MATH = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((\.\./[^)]*)\)")


def on_config(config: Any) -> Any:
    """Put the pages of a folder in the place of its name in the navigation."""
    root = Path(config["docs_dir"])

    def expand(entry: Any) -> Any:
        if isinstance(entry, list):
            return [expand(each) for each in entry]
        if isinstance(entry, dict):
            return {title: expand(each) for title, each in entry.items()}
        if not entry.endswith("/"):
            return entry
        pages = sorted((root / entry).glob("*.md"), key=lambda path: (path.stem != "index", path.stem))
        return [page.relative_to(root).as_posix() for page in pages]

    config["nav"] = expand(config["nav"])
    return config


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Remove links to files outside of the pages: a checkout has these files, the site does not."""
    folder = posixpath.dirname(page.file.src_uri)

    def inside(found: re.Match[str]) -> str:
        leaves = posixpath.normpath(posixpath.join(folder, found[2])).startswith("..")
        return found[1] if leaves else found[0]

    return _LINK.sub(inside, markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Convert LaTeX to MathML, which browsers draw themselves."""
    return _MATH.sub(_mathml, content)


def _mathml(found: re.Match[str]) -> str:
    display = "block" if found[1] == "div" else "inline"
    return str(convert(html.unescape(found[2]), display=display))
