"""Figures of benchmarks on the terminal: a value beside its bar."""

from __future__ import annotations

from collections.abc import Iterable


def show(figures: Iterable[tuple[str, float, float, str]]) -> None:
    """One a line, as they come."""
    for what, measured, bar, unit in figures:
        print(f"{what:<72}{measured:>10.2f} {unit:<2}{bar:>8} {unit}", flush=True)
