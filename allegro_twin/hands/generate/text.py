"""Numbers and XML as text, the same in both formats."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

from allegro_twin.hands.description.facts import VisualFacts

NOTICE = " Made by `make models` from models/{model}.yaml and conf/hands/{model}.yaml: edit those. "
ARM_NOTICE = " Made by `make models` from models/arms/{model}.yaml: edit that. "


def numbers(values: Iterable[float]) -> str:
    """Shortest text that reads back as the same floats."""
    return " ".join(number(value) for value in values)


def number(value: float) -> str:
    return repr(float(value) + 0.0).removesuffix(".0")


def mesh_name(visual: VisualFacts) -> str:
    """A name that says the shape, so that equal parts share a file. Sizes in tenths of a millimetre."""
    return "rounded_" + "_".join(str(round(size * 1e4)) for size in (*visual.size, visual.radius))


def document(root: ElementTree.Element, model: str, notice: str = NOTICE) -> str:
    root.insert(0, ElementTree.Comment(notice.format(model=model)))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
