"""Twenty scans, each damaged by code, through the reader of meshes: `python -m benchmarks.dirty_meshes`.

Prints the table of docs/results/meshes.md: what comes of each, against the solid that it was made of. `--files FOLDER`
also keeps the files.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from allegro_twin.errors import ConfigError
from allegro_twin.sim.objects.clean_mesh import make_clean
from tests.sim.dirty_meshes import DIRTY, Dirty, distances


def main() -> None:
    """Print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=Path, help="keep the files in this folder")
    parser.add_argument("numbers", nargs="*", type=int, help="only these, from 0")
    asked = parser.parse_args()
    print("| | scan | volume, true | error | off the true surface | CPU s | said |\n|---|---|---|---|---|---|---|")
    with TemporaryDirectory() as temporary:
        for number in asked.numbers or range(len(DIRTY)):
            folder = (asked.files or Path(temporary)) / str(number)
            folder.mkdir(parents=True, exist_ok=True)
            print(f"| {number} | {row(DIRTY[number], folder)} |", flush=True)


def row(dirty: Dirty, folder: Path) -> str:
    """What came of one."""
    truth = dirty.solid()
    file = dirty.write(folder, truth)
    start, name = time.process_time(), f"{dirty.name}: {dirty.what} | {1e6 * truth.volume:.1f} cm³"
    try:
        made = make_clean(file)
    except ConfigError as error:
        return f"{name} | – | – | {time.process_time() - start:.1f} | refused: {str(error).replace(str(folder), '')}"
    spent = time.process_time() - start
    off = max(distances(truth, made.vertices, made.faces))
    wrong = 100 * (made.report.volume[1] / truth.volume - 1)
    return f"{name} | {wrong:+.1f} % | {1000 * off:.2f} mm | {spent:.1f} | {made.report.line().partition(': ')[2]}"


if __name__ == "__main__":
    main()
