"""Results that nobody measured, for pages."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.grasping.statistics import wilson

OBJECTS = ("tomato_soup_can", "lemon", "foam_brick", "golf_ball", "potted_meat_can")
TYPES = ("Medium Wrap", "Tripod", "Power Sphere")
DIRECTIONS = ("+x", "-x", "+y", "-y", "+z", "-z")


def png(path: Path, colour: tuple[int, int, int], width: int = 320, height: int = 240) -> Path:
    """A picture of one colour."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    rows = b"".join(b"\0" + bytes(colour) * width for _ in range(height))
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)
    return path


def results(folder: Path, count: int = 60, seed: int = 3) -> list[dict[str, Any]]:
    """Grasps whose figures have something to do with what came of them."""
    rng = np.random.default_rng(seed)
    rows: list[dict[str, Any]] = []
    for number in range(count):
        worth = float(rng.uniform())
        held = worth + rng.normal(scale=0.25) > 0.45
        draws = 50
        won = int(rng.binomial(draws, min(max(worth, 0.02), 0.99) if held else 0.3 * worth))
        part = wilson(won, draws)
        row: dict[str, Any] = {
            "grasp": f"g{number:03d}",
            "object": OBJECTS[number % len(OBJECTS)],
            "type": TYPES[number % len(TYPES)],
            "protocol": "fc 1",
            "held": bool(held),
            "reason": "" if held else "dropped by the end of <+z> & gone",
            **{f"margin_{d}": float(np.clip(worth + rng.normal(scale=0.2), -0.4, 1.0)) for d in DIRECTIONS},
            "drift_mm": float(rng.gamma(2.0, 4.0 * (1.2 - worth))),
            "rotation_deg": float(rng.gamma(2.0, 3.0 * (1.2 - worth))),
            "penetration_mm": float(rng.gamma(2.0, 0.4)),
            "contacts": int(rng.integers(3, 12)),
            "epsilon": max(0.0, 0.4 * worth + float(rng.normal(scale=0.06))),
            "volume": float(worth**4 * rng.uniform(0.5, 1.5)),
            "lp": worth - 0.2 + float(rng.normal(scale=0.1)),
            "torque_share": float("inf") if worth < 0.05 else float(1.1 - 0.8 * worth + rng.normal(scale=0.15)),
            "success": won / draws,
            "wilson_low": part.low,
            "wilson_high": part.high,
            "n": draws,
        }
        if number < 9:
            shade = int(60 + 190 * worth)
            row["picture"] = str(png(folder / f"g{number}.png", (80, shade, 160)))
            row["rrd"] = str(folder / "runs" / f"g{number} a.rrd")
        rows.append(row)
    return rows


if __name__ == "__main__":
    import sys

    from allegro_twin.grasping.evaluation.html_report import write_html_report

    place = Path(sys.argv[1])
    place.mkdir(parents=True, exist_ok=True)
    write_html_report(
        place / "page.html", results(place), about={"engine": "mujoco 4.0.0", "protocol": "fc 1", "seeds": "0–49"}
    )
