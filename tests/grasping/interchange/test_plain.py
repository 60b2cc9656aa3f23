"""Files that are pickles are read and not run."""

from __future__ import annotations

import os
import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.interchange.plain import load_plain
from tests.grasping.interchange.samples import saved


def pickled(path: Path, content: object, protocol: int) -> Path:
    """As some version of NumPy or Python might have written it."""
    boxed = np.empty((), dtype=object)
    boxed[()] = content
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"shape": (), "fortran_order": False, "descr": "|O"})
        pickle.dump(boxed, file, protocol=protocol)
    return path


class Calls:
    """What a pickle does to whoever unpickles it."""

    def __init__(self, *what: object) -> None:
        self._what = what

    def __reduce__(self) -> Any:
        return self._what[0], self._what[1:]


CONTENT: dict[str, Any] = {
    "pose": np.arange(7.0),
    "columns": np.asfortranarray(np.arange(6, dtype=">f4").reshape(2, 3)),
    "none": np.zeros((0, 3)),
    "flags": np.array([True, False]),
    "names": np.array(["ffj0", "µ"]),
    "scale": np.float32(0.06),
    "count": np.int64(3),
    "text": "core/mug",
    "bytes": b"\x00\xff",
    "nested": [1, (2.5, None), {"a": {4}}, OrderedDict(b=1)],
}


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_and_plain_values_come_back_as_they_were(tmp_path: Path, protocol: int) -> None:
    found = load_plain(pickled(tmp_path / "a.npy", CONTENT, protocol))
    assert list(found) == list(CONTENT)
    for key, value in CONTENT.items():
        assert type(found[key]) is type(value), key
        if isinstance(value, np.ndarray):
            assert found[key].dtype == value.dtype, key
            np.testing.assert_array_equal(found[key], value)
        else:
            assert found[key] == value, key


def test_arrays_of_objects_and_bare_arrays_are_read_too(tmp_path: Path) -> None:
    np.save(tmp_path / "rows.npy", np.array([{"q": np.ones(2)}, {"q": np.zeros(2)}], dtype=object), allow_pickle=True)
    rows = load_plain(tmp_path / "rows.npy")
    assert rows.shape == (2,)
    np.testing.assert_array_equal(rows[0]["q"], [1, 1])
    np.save(tmp_path / "bare.npy", np.arange(3))
    np.testing.assert_array_equal(load_plain(tmp_path / "bare.npy"), [0, 1, 2])


def malicious(tmp_path: Path) -> dict[str, object]:
    """Pickles that would leave a file behind, or worse, if anything of them were run."""
    mark = f"touch {tmp_path / 'ran'}"
    inside = np.empty(1, dtype=object)
    inside[0] = Calls(os.system, mark)
    return {
        "bare": Calls(os.system, mark),
        "in a dictionary": {"obj_path": Calls(os.system, mark)},
        "in an array of objects": {"qpos": inside},
        "by evaluation": Calls(eval, f"__import__('os').system({mark!r})"),
        "by NumPy": Calls(np.load, str(tmp_path / "other.npy")),
        "by a way round names": Calls(getattr, Calls, "__reduce__"),
        "by another codec": Calls(__import__("codecs").encode, "x", "rot13"),
    }


@pytest.mark.parametrize("way", malicious(Path()))
@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_pickle_that_calls_something_is_refused_in_a_line_and_not_run(
    tmp_path: Path, way: str, protocol: int
) -> None:
    path = pickled(tmp_path / "bad.npy", malicious(tmp_path)[way], protocol)
    with pytest.raises(ConfigError, match=r"bad\.npy: holds .* which is no plain data and was not run: save") as caught:
        load_plain(path)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "ran").exists()


def header() -> bytes:
    """Of a .npy that holds a Python object."""
    text = "{'descr': '|O', 'fortran_order': False, 'shape': (), }".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


def array(dtype: bytes, shape: bytes, raw: bytes) -> bytes:
    """A pickle, opcode by opcode, of an array that says of itself what it likes."""
    return (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR(I1\n" + shape + b"cnumpy\ndtype\n(S'"
        + dtype + b"'\nI00\nI01\ntR(I3\nS'<'\nNNNI-1\nI-1\nI0\ntbI00\n" + raw + b"tb."
    )  # fmt: skip


SLY = {
    "larger than its bytes": (array(b"f8", b"(I1000000\nt", b"S'12345678'\n"), "size is not what it says"),
    "of negative size": (array(b"f8", b"(I-1\nI-1\nt", b"S'12345678'\n"), "size is not what it says|not a readable"),
    "of text for objects": (array(b"O8", b"(I1\nt", b"S'A'\n"), "an array of objects without them"),
    "of no numbers": (array(b"f8,,", b"(I1\nt", b"S'A'\n"), "holds numbers of type f8,,"),
    "of pointers": (array(b"O8", b"(I1\nt", b"S'AAAAAAAA'\n"), "an array of objects without them"),
    "of pointers in records": (array(b"O,f8", b"(I1\nt", b"S'AAAAAAAAAAAAAAAA'\n"), "holds numbers of type"),
    "a change to what may be called": (b"cnumpy\ndtype\n}S'a'\nI1\nsb.", "holds a change to what it may call"),
    "within itself": (b"]p0\ng0\na.", "not a readable .npy file: containers in containers"),
    "nothing": (b"", "not a readable .npy file"),
    "cut short": (array(b"f8", b"(I1\nt", b"S'12345678'\n")[:60], "not a readable .npy file"),
    "a name of two lines": (b"\x8c\x03os\n\x8c\x06system\x93.", "holds os, which is no plain data and was not run"),
    "a buffer cut short": (b"\x80\x05\x96\xff\x00\x00\x00\x00\x00\x00\x00abc", "not a readable .npy file"),
    "a stand-in by itself": (b"cnumpy\ndtype\n(S'f8'\ntR.", "holds a DType by itself"),
    "a function by itself": (b"cnumpy\ndtype\n.", "holds a Call by itself"),
}


@pytest.mark.parametrize("what", SLY)
def test_a_pickle_that_lies_is_answered_in_a_line(tmp_path: Path, what: str) -> None:
    content, answer = SLY[what]
    (tmp_path / "sly.npy").write_bytes(header() + content)
    with pytest.raises(ConfigError, match=answer) as caught:
        load_plain(tmp_path / "sly.npy")
    assert "\n" not in str(caught.value)


def test_what_holds_itself_a_million_times_is_gone_through_once(tmp_path: Path) -> None:
    nested: list[Any] = [1.0]
    for _ in range(40):
        nested = [nested, nested]
    found = load_plain(pickled(tmp_path / "dag.npy", nested, 4))
    for _ in range(40):
        found = found[1]
    assert found == [1.0]


def test_a_file_that_is_none_is_answered_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_text("no array")
    with pytest.raises(ConfigError, match=r"a\.npy: not a readable \.npy file"):
        load_plain(tmp_path / "a.npy")
    for old, new in ((b"'shape': (), }", b"'shape': (((, "), (b"'|O'", b"',|'")):
        (tmp_path / "a.npy").write_bytes(header().replace(old, new))
        with pytest.raises(ConfigError, match=r"a\.npy: not a readable \.npy file"):
            load_plain(tmp_path / "a.npy")
    with pytest.raises(ConfigError, match=r"b\.npy: cannot be read: No such file"):
        load_plain(tmp_path / "b.npy")


def test_a_tensor_is_named(tmp_path: Path) -> None:
    """As torch writes it: by a function of its own."""
    saved(tmp_path / "a.npy", {"qpos": 1.0})
    content = (tmp_path / "a.npy").read_bytes()[: len(header())] + b"ctorch._utils\n_rebuild_tensor_v2\n)R."
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ConfigError, match=r"holds torch\._utils\._rebuild_tensor_v2, which is no plain data"):
        load_plain(tmp_path / "a.npy")
