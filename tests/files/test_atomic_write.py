"""Files that are written whole, and the places where they cannot be."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from allegro_twin.errors import RecordingError
from allegro_twin.files.atomic_write import check_place


@pytest.mark.parametrize(("flags", "why"), [(os.ST_RDONLY, "its file system is read-only"), (0, "no permission")])
def test_a_read_only_file_system_is_told_apart_from_a_missing_permission(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: int, why: str
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(os, "statvfs", lambda *_: SimpleNamespace(f_flag=flags))
    with pytest.raises(RecordingError, match=f"a.arrow: {why}$"):
        check_place(tmp_path / "a.arrow")
