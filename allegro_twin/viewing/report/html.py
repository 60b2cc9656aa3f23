"""The page of a report and its tables, and how they look in light and dark."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape


def html_page(title: str, about: str, parts: Iterable[str]) -> str:
    """A whole page. `title` and `about`, a line below it, are text; `parts` are pieces of HTML. Columns of tables of
    the class `sortable` sort by a click."""
    body = "".join(parts)
    script = f"<script>{_SORT}</script>" if "class='sortable'" in body else ""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body><main>"
        f"<header><h1>{escape(title)}</h1><p class='soft'>{escape(about)}</p></header>{body}</main>{script}</body>"
        "</html>\n"
    )


_LONG = 60
"""Characters of a sentence, which breaks into lines; what is shorter stays on one."""


def _cell(text: str) -> str:
    long = " class='long'" if len(text) > _LONG else ""
    return f"<td{long}>{escape(text)}</td>"


def html_table(heads: Iterable[str], rows: Iterable[Iterable[str]], caption: str = "") -> str:
    """A table that scrolls by itself where it is wide; heads, cells and caption are text."""
    head = "".join(f'<th scope="col">{escape(each)}</th>' for each in heads)
    body = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in rows)
    said = escape(caption)
    name = f" tabindex='0' role='region' aria-label='{said}'" if caption else ""
    above = f"<caption class='soft'>{said}</caption>" if caption else ""
    return f"<div class='wide'{name}><table>{above}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


# Blue and vermilion of Okabe and Ito's palette, which the colour-blind tell apart; lighter ones on dark.
_STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #1b1f24; --soft: #57606a; --line: #d0d7de; --card: #f6f8fa;
  --good: #005f9e; --bad: #b34700; --link: #0050a0; }
@media (prefers-color-scheme: dark) { :root { --paper: #0f1419; --ink: #e6edf3; --soft: #9aa4af; --line: #343d47;
  --card: #182028; --good: #6cb8f0; --bad: #ff9a57; --link: #82c0ff; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1180px; padding: 24px; background: var(--paper); color: var(--ink);
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 26px; margin: 0 0 4px; } h2 { font-size: 19px; margin: 36px 0 8px; }
h3 { font-size: 15px; margin: 0 0 4px; }
p { margin: 4px 0 12px; max-width: 75ch; } .soft { color: var(--soft); } a { color: var(--link); }
.numbers { display: flex; flex-wrap: wrap; gap: 12px; margin: 16px 0; padding: 0; list-style: none; }
.numbers li { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: 10px 16px; }
.numbers b { display: block; font-size: 22px; }
svg { max-width: 100%; height: auto; display: block; } svg text { fill: var(--ink); font: 13px system-ui, sans-serif; }
.grid { stroke: var(--line); } .zero { stroke: var(--soft); stroke-width: 1.5; }
.whisker { stroke: var(--good); stroke-width: 2.5; } .median { stroke: var(--ink); stroke-width: 2.5; }
.good { fill: var(--good); } .faint { fill-opacity: .55; } .bad { stroke: var(--bad); stroke-width: 2; fill: none; }
.cards { display: flex; flex-wrap: wrap; gap: 16px; }
figure { margin: 0; background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: 12px; }
figure img { display: block; width: 250px; max-width: 100%; border-radius: 4px; } figcaption { max-width: 320px; }
.wide { overflow-x: auto; max-height: 80vh; border: 1px solid var(--line); border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
caption { text-align: left; padding: 8px; }
th, td { padding: 4px 10px; border-bottom: 1px solid var(--line); text-align: left; white-space: nowrap; }
td.long { white-space: normal; min-width: 24em; }
td.n, th.n { text-align: right; } thead th { position: sticky; top: 0; background: var(--card); padding: 6px 10px; }
thead th:has(button) { padding: 0; }
thead button { all: unset; cursor: pointer; padding: 6px 10px; font-weight: 600; display: block; }
button:focus-visible, a:focus-visible, .wide:focus-visible { outline: 3px solid var(--good); outline-offset: -3px; }
th[aria-sort=ascending] button::after { content: " ▲"; } th[aria-sort=descending] button::after { content: " ▼"; }
.yes { color: var(--good); } .no { color: var(--bad); font-weight: 600; }
.line { fill: none; stroke-width: 1.6; } .line.ink { stroke: var(--ink); } .line.good { stroke: var(--good); }
.line.bad { stroke: var(--bad); } .line.soft { stroke: var(--soft); }
"""
_SORT = """
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  const value = (row, k) => row.cells[k].dataset.v ?? row.cells[k].textContent;
  heads.forEach((head, k) => head.firstElementChild.addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
    heads.forEach(other => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", down > 0 ? "ascending" : "descending");
    const order = (a, b) => {
      const x = value(a, k), y = value(b, k);
      if (x === "" || y === "") return (x === "") - (y === "");  // What has no value stays last.
      const number = Number(x) - Number(y);
      return down * (Number.isNaN(number) ? x.localeCompare(y) : number);
    };
    body.append(...[...body.rows].sort(order));
  }));
}
"""


def film_figure(source: str, caption: str) -> str:
    """A film in a card with words under it. `source`: where it is from the page."""
    return (
        "<figure style='display:inline-block;width:320px;margin:0 1em 1em 0'>"
        f"<video controls loop muted style='width:100%' src='{escape(source)}'></video>"
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
