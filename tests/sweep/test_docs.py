"""The example of docs/how-to/run_a_sweep.md runs as it stands."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs/how-to/run_a_sweep.md"


@pytest.mark.slow
def test_the_example_runs(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(DOCS.read_text().split("```python\n")[1].split("```")[0])
    done = subprocess.run([sys.executable, "study.py"], cwd=tmp_path, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == (f"{0.05 * 999} 1000\n", "")
    assert len(list((tmp_path / "out/reach").glob("part-*.parquet"))) == 5
