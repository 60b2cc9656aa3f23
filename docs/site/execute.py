"""Run the tutorials and keep what they show: `python docs/site/execute.py [NAME…]`, each in an empty folder."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

TUTORIALS = Path(__file__).resolve().parents[1] / "tutorials"
PATIENCE = 1800
"""s for a cell."""


def executed(path: Path, folder: Path) -> nbformat.NotebookNode:
    """A notebook with what came out of it. Raises nbclient.exceptions.CellExecutionError."""
    notebook = nbformat.read(path, as_version=4)
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    os.environ |= {"COLUMNS": "100", "PYTHONWARNINGS": "ignore", "TERM": "dumb"}
    NotebookClient(
        notebook, timeout=PATIENCE, coalesce_streams=True, resources={"metadata": {"path": str(folder)}}
    ).execute()
    for cell in notebook.cells:
        cell.metadata = {}  # Without the times, so that a page changes only where what it shows does.
    return notebook


def failed(notebook: nbformat.NotebookNode) -> list[str]:
    """What commands said that went wrong without ending their cell, or for want of an extra."""
    texts = [output.text for cell in notebook.cells for output in cell.get("outputs", ()) if "text" in output]
    return [text for text in texts if "Traceback" in text or "pip install" in text]


if __name__ == "__main__":
    for name in sys.argv[1:] or [path.stem for path in sorted(TUTORIALS.glob("*.ipynb"))]:
        with tempfile.TemporaryDirectory() as folder:
            found = executed(TUTORIALS / f"{name}.ipynb", Path(folder))
        if wrong := failed(found):
            sys.exit(f"{name}: {wrong[0][-2000:]}")
        nbformat.write(found, TUTORIALS / f"{name}.ipynb")
