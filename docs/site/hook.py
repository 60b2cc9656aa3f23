"""What the site needs beyond Markdown: mathematics that no script has to draw, and no links out of the pages."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

_MATH = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_OUT = re.compile(r"(?<!!)\[([^\]]*)\]\(\.\./[^)]*\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """In a checkout such a link leads to a file beside the pages, which the site does not have."""
    return _OUT.sub(r"\1", markdown) if "/" not in page.file.src_uri else markdown


def on_page_content(content: str, **_: Any) -> str:
    """LaTeX as MathML, which browsers draw by themselves."""
    return _MATH.sub(_mathml, content)


def _mathml(found: re.Match[str]) -> str:
    display = "block" if found[1] == "div" else "inline"
    return str(convert(html.unescape(found[2]), display=display))
