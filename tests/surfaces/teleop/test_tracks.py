"""A file of hand tracking is what its tracker saw, in three formats; what is wrong with one is said in a line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.teleop.tracks import HEADER, read_track
from tests.surfaces.teleop.synthetic import EXAMPLE, hand, performed, write_csv

TIMES, FRAMES = performed(rate=5.0)


def test_a_track_is_the_same_in_every_format_and_what_was_not_seen_is_nan(tmp_path: Path) -> None:
    frames = np.round(FRAMES, 4)
    frames[3] = np.nan
    write_csv(tmp_path / "a.csv", TIMES, frames)
    np.savez(tmp_path / "a.npz", t=TIMES, landmarks=frames, side="left")
    rows = [
        {"t": t, "landmarks": None if np.isnan(f).any() else f.tolist()} for t, f in zip(TIMES, frames, strict=True)
    ]
    (tmp_path / "a.json").write_text(json.dumps({"side": "left", "frames": rows}))
    for suffix, side in ((".csv", None), (".npz", "left"), (".json", "left")):
        track = read_track(tmp_path / f"a{suffix}")
        np.testing.assert_allclose(track.times, TIMES)
        np.testing.assert_allclose(track.landmarks, frames)
        assert track.side == side
        assert np.isnan(track.landmarks[3]).all()


def test_the_example_is_what_its_generator_makes(tmp_path: Path) -> None:
    write_csv(tmp_path / "again.csv", *performed(rate=10.0))
    assert (tmp_path / "again.csv").read_text() == EXAMPLE.read_text()


def csv_of(times: Any, frames: Any, folder: Path) -> bytes:
    write_csv(folder / "made.csv", np.asarray(times, dtype=float), np.asarray(frames))
    return (folder / "made.csv").read_bytes()


def huge(**frame: Any) -> bytes:
    return json.dumps({"frames": [frame]}).encode()


def test_a_table_that_excel_has_saved_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbf" + EXAMPLE.read_bytes() + b"\r\n\r\n")
    np.testing.assert_array_equal(read_track(tmp_path / "a.csv").times, read_track(EXAMPLE).times)


def test_a_file_that_is_no_track_is_refused_in_one_line(tmp_path: Path) -> None:
    one = hand(0.3)
    head = ",".join(HEADER)
    cases = {
        "a.txt": (b"", "hand tracking is a file in .npz, .csv, .json, or `webcam`"),
        "empty.csv": (b"", "its first line must be t,x0,y0,z0,x1,…,z20: 64 names"),
        "head.csv": (f"{head}\n".encode(), "holds no frame"),
        "short.csv": (f"{head}\n0,1,2\n".encode(), "short.csv:2: has 3 values; the first line has 64 names"),
        "word.csv": (f"{head}\n0{',x' * 63}\n".encode(), "word.csv:2: could not convert"),
        "nan.csv": (csv_of([0, 1], [one * np.nan] * 2, tmp_path), "no frame has a whole hand of 21 landmarks"),
        "time.csv": (csv_of([0, np.nan], [one] * 2, tmp_path), "t of frame 1 is not a number"),
        "back.csv": (csv_of([0, 2, 1], [one] * 3, tmp_path), "after frame 1 it goes from 2 to 1 s"),
        "still.csv": (csv_of([0, 0], [one] * 2, tmp_path), "t must ascend; after frame 0"),
        "mm.csv": (csv_of([0], [one * 1000.0], tmp_path), "90 m from the wrist to the middle knuckle is no hand's"),
        "ms.csv": (
            csv_of([0, 33, 67], [one] * 3, tmp_path),
            "a frame every 33.5 s follows no hand: t is in s, not in ms or µs",
        ),
        "bytes.npz": (b"\x00\x01", "not a .npz of plain numbers"),
        "text.json": (b"{", "not valid JSON"),
        "list.json": (b"[]", "must hold a mapping with a list of `frames`"),
        "none.json": (b'{"frames": []}', "holds no frame"),
        "t.json": (b'{"frames": [{"landmarks": null}]}', "frame 0: needs `t`, s, and `landmarks`"),
        "true.json": (b'{"frames": [{"t": true, "landmarks": null}]}', "frame 0: needs `t`, s, and `landmarks`"),
        "huge.json": (huge(t=10**400, landmarks=None), "frame 0: t has too many digits"),
        "huge_t.json": (huge(t=10**400, landmarks=one.tolist()), "frame 0: t has too many digits"),
        "huge_point.json": (huge(t=0, landmarks=[[10**400, 0, 0]] * 21), "frame 0: a landmark is three numbers, m"),
        "few.json": (b'{"frames": [{"t": 0, "landmarks": [[0, 0, 0]]}]}', "frame 0: needs 21 landmarks or null, not 1"),
        "handed.json": (
            b'{"handedness": "Left", "frames": []}',
            "handedness is Left, and the side is the file's own `side`",
        ),
        "frame.json": (
            b'{"frames": [{"t": 0, "landmarks": null, "hand": "left"}]}',
            "frame 0: hand is left, and the side is the file's own `side`",
        ),
        "typo.json": (
            b'{"frames": [{"t": 0, "Landmarks": []}]}',
            "frame 0: has no `landmarks`; a frame without a hand",
        ),
        "side.json": (b'{"side": "top", "frames": []}', "side is right or left, not 'top'"),
    }
    for name, (content, words) in cases.items():
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(ConfigError) as refused:
            read_track(path)
        assert words in str(refused.value), f"{name}: {refused.value}"
        assert name in str(refused.value)
        assert "\n" not in str(refused.value)
    with pytest.raises(ConfigError, match=r"none.npz: cannot be read: No such file"):
        read_track(tmp_path / "none.npz")


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"t": TIMES}, "lacks the array 'landmarks'; it has t"),
        ({"t": TIMES, "landmarks": FRAMES[:, :20]}, r"landmarks has shape \(30, 20, 3\); 30 frames need \(30, 21, 3\)"),
        ({"t": TIMES, "landmarks": np.full((30, 21, 3), "x")}, "t and landmarks must be numbers"),
        ({"t": TIMES, "landmarks": np.array([{}])}, "not a .npz of plain numbers"),
        ({"t": TIMES, "landmarks": FRAMES, "hand": "left"}, "hand is left, and the side is the file's own `side`"),
    ],
)
def test_arrays_of_another_shape_are_refused_by_name(arrays: dict[str, Any], words: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ConfigError, match=words):
        read_track(tmp_path / "a.npz")
