"""Writes ONNX files of one linear layer, by the format's own bytes: neither `onnx` nor a learner is needed."""

from __future__ import annotations

import struct
from pathlib import Path

FLOAT, DOUBLE = 1, 11
"""Types of numbers."""


def write_linear(
    path: Path,
    card: str | None,
    inputs: dict[str, tuple[int | str, ...]],
    outputs: int,
    *,
    kind: int = FLOAT,
) -> Path:
    """action = `observation` @ 0, or that of the first input; `card`: the text of the metadata, or None. Shapes of
    inputs are (batch, numbers)."""
    first, (batch, numbers) = next(iter(inputs)), next(iter(inputs.values()))
    assert isinstance(numbers, int)
    zeros = struct.pack("<f" if kind == FLOAT else "<d", 0.0) * (numbers * outputs)
    weights = _number(1, numbers) + _number(1, outputs) + _number(2, kind) + _text(8, b"w") + _text(9, zeros)
    node = _text(1, first.encode()) + _text(1, b"w") + _text(2, b"action") + _text(4, b"MatMul")
    graph = _text(1, node) + _text(2, b"policy") + _text(5, weights)
    graph += b"".join(_text(11, _value(name, shape, kind)) for name, shape in inputs.items())
    graph += _text(12, _value("action", (batch, outputs), kind))
    model = _number(1, 8) + _text(7, graph) + _text(8, _text(1, b"") + _number(2, 17))
    if card is not None:
        model += _text(14, _text(1, b"allegro_twin") + _text(2, card.encode()))
    path.write_bytes(model)
    return path


def _value(name: str, shape: tuple[int | str, ...], kind: int) -> bytes:
    axes = b"".join(_text(1, _number(1, each) if isinstance(each, int) else _text(2, each.encode())) for each in shape)
    return _text(1, name.encode()) + _text(2, _text(1, _number(1, kind) + _text(2, axes)))


def _varint(value: int) -> bytes:
    found = b""
    while value > 127:
        found, value = found + bytes([value & 127 | 128]), value >> 7
    return found + bytes([value])


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _text(field: int, value: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(value)) + value
