"""Reports as one HTML file that fetches nothing: the page, its tables, and charts as inline SVG."""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.viewing.report.charts import (
        ChartLine,
        IntervalRow,
        interval_chart,
        line_chart,
        rate_chart,
        round_ticks,
        scatter_chart,
        strip_chart,
        svg,
        svg_text,
    )
    from allegro_twin.viewing.report.html import html_page, html_table

__all__ = [
    "ChartLine",
    "IntervalRow",
    "html_page",
    "html_table",
    "interval_chart",
    "line_chart",
    "rate_chart",
    "round_ticks",
    "scatter_chart",
    "strip_chart",
    "svg",
    "svg_text",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "charts": (
            "ChartLine", "IntervalRow", "interval_chart", "line_chart", "rate_chart", "round_ticks", "scatter_chart",
            "strip_chart", "svg", "svg_text",
        ),
        "html": ("html_page", "html_table"),
    },
)  # fmt: skip
