"""Functions for sweeps, and what they leave behind so that a test can count their calls."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from allegro_twin.errors import HandError

Items = list[Mapping[str, Any]]
Rows = list[dict[str, Any]]


def waves(shared: Mapping[str, Any], items: Items) -> Rows:
    """Some numbers a row; a line for each call in the file that `shared` names, and the time it is told to take."""
    if "log" in shared:
        with Path(shared["log"]).open("a") as log:
            log.write(" ".join(str(item["n"]) for item in items) + "\n")
    time.sleep(shared.get("seconds", 0.0))
    return [{"n": item["n"], "sine": math.sin(item["n"] * shared.get("scale", 0.1)), "odd": None} for item in items]


def fussy(shared: Mapping[str, Any], items: Items) -> Rows:
    """Does not like some items."""
    for item in items:
        if item["n"] in shared["disliked"]:
            raise HandError(f"no {item['n']},\nplease")
    return waves(shared, items)


def fatal(shared: Mapping[str, Any], items: Items) -> Rows:
    """Its process is killed at some item: as often as `times` says, counted in a file."""
    marks = Path(shared["marks"])
    if any(item["n"] == shared["at"] for item in items):
        done = marks.stat().st_size if marks.exists() else 0
        if done < shared["times"]:
            with marks.open("a") as file:
                file.write("x")
            os.kill(os.getpid(), signal.SIGKILL)
    return waves(shared, items)


def too_few(shared: Mapping[str, Any], items: Items) -> Rows:
    return waves(shared, items)[1:]


def named_otherwise(shared: Mapping[str, Any], items: Items) -> Rows:
    return [{shared["name"] if item["n"] == 2 else "n": 1} for item in items]


def mixed(shared: Mapping[str, Any], items: Items) -> Rows:
    """A column that is an integer here and not there."""
    return [{"value": item["n"] if item["n"] < 5 else shared["other"]} for item in items]


def wide(shared: Mapping[str, Any], items: Items) -> Rows:
    """A row of a hundred kilobytes."""
    return [{"n": item["n"], "text": "x" * 100_000} for item in items]


def broken(shared: Mapping[str, Any], items: Items) -> Rows:
    raise ZeroDivisionError("as a mistake in a function does")


def numbered(count: int) -> list[dict[str, int]]:
    return [{"n": n} for n in range(count)]


def as_bytes(table: Any) -> bytes:
    """All of a table: its schema and every bit of its columns."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    found: bytes = sink.getvalue().to_pybytes()
    return found


def calls(log: Path) -> list[list[int]]:
    return [[int(word) for word in line.split()] for line in log.read_text().splitlines()]


def slower_first(shared: Mapping[str, Any], items: Items) -> Rows:
    """Even items take their time."""
    time.sleep(0.3 if items[0]["n"] % 2 == 0 else 0.0)
    return waves(shared, items)
