"""`.npy` files that hold Python objects, read without running what they say.

Such a file is a pickle, and a pickle is a program. Here nothing that it names is called but a handful of stand-ins,
which only keep what they are given; arrays are made from that afterwards, their sizes checked. NumPy's own way to
restore an array from a pickle is not used either: it trusts the numbers that it is told.
"""

from __future__ import annotations

import io
import math
import pickle
import re
import struct
import tokenize
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from allegro_twin.errors import ConfigError

_MALFORMED = (
    pickle.UnpicklingError, ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError, ImportError,
    OverflowError, MemoryError, RecursionError, NotImplementedError, SyntaxError, AssertionError, struct.error,
    tokenize.TokenError,
)  # fmt: skip
"""What an unpickler raises on bytes that are no pickle, or one with holes."""
_DEEPEST, _LONGEST = 50, 200
_NUMBERS = re.compile(r"[biufcSU]\d{1,9}")
"""What a dtype may be: logical, whole, real and complex numbers, bytes and text, of some size."""


class _Refused(Exception):
    """A pickle names something that is not plain data."""


class _DType:
    """A dtype, as it was told."""

    __slots__ = ("code", "order")

    def __init__(self, code: object, *_: object) -> None:
        self.code, self.order = str(code), "="

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.order = str(state[1])

    def dtype(self) -> np.dtype[Any] | None:
        """None for Python objects."""
        if self.code in ("O", "O8", "O4"):
            return None
        if not _NUMBERS.fullmatch(self.code):
            raise _Refused(f"numbers of type {self.code}")
        found = np.dtype(self.code)
        match self.order:
            case "<" | ">" as order:
                return found.newbyteorder(order)
        return found


class _Array:
    """An array, as it was told."""

    __slots__ = ("kind", "raw", "shape", "transposed")

    def __init__(self) -> None:
        self.shape, self.kind, self.transposed, self.raw = (), _DType("O"), False, [None]

    shape: Any
    kind: Any
    transposed: bool
    raw: Any

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, self.shape, self.kind, self.transposed, self.raw = state

    def array(self, within: int, done: dict[int, Any]) -> NDArray[Any]:
        shape = tuple(int(size) for size in self.shape)
        dtype, count = self.kind.dtype(), math.prod(shape)
        order: Literal["C", "F"] = "F" if self.transposed else "C"
        if dtype is None:
            if not isinstance(self.raw, list) or len(self.raw) != count:
                raise ValueError("an array of objects without them")
            flat = np.empty(count, dtype=object)
            for index, value in enumerate(self.raw):
                flat[index] = to_plain(value, within, done)
            return np.reshape(flat, shape, order=order)
        if len(self.raw) != count * dtype.itemsize or min(shape, default=0) < 0:
            raise ValueError("an array whose size is not what it says")
        return np.reshape(np.frombuffer(bytes(self.raw), dtype=dtype), shape, order=order).copy()


class _Call:
    """Function that a pickle may call. A pickle can change neither it nor anything through it."""

    __slots__ = ("_function",)

    def __init__(self, function: Callable[..., object]) -> None:
        object.__setattr__(self, "_function", function)

    def __call__(self, *arguments: object) -> object:
        return self._function(*arguments)  # type: ignore[attr-defined]  # Set past __setattr__.

    def __setattr__(self, name: str, value: object) -> None:
        raise _Refused("a change to what it may call")

    def __setstate__(self, state: object) -> None:
        raise _Refused("a change to what it may call")


def _scalar(kind: _DType, raw: object = b"") -> _Array:
    found = _Array()
    found.kind, found.raw = kind, raw if kind.code[:1] != "O" else [raw]
    return found


def _from_buffer(raw: object, kind: _DType, shape: object, order: object, *_: object) -> _Array:
    found = _Array()
    found.shape, found.kind, found.transposed, found.raw = shape, kind, order == "F", raw
    return found


def _encoded(text: object, encoding: object = "latin1") -> bytes:
    """Bytes, as the oldest protocols write them."""
    if not isinstance(text, str) or encoding != "latin1":
        raise _Refused(f"text in {encoding}")
    return text.encode("latin1")


def _bytes(content: object = b"") -> bytes:
    if not isinstance(content, bytes):  # A number would be a size, of any number of bytes.
        raise _Refused("bytes by their number")
    return content


_CORE = ("numpy.core", "numpy._core")
_KNOWN: dict[tuple[str, str], object] = {
    **{(f"{core}.multiarray", "_reconstruct"): _Call(lambda *_: _Array()) for core in _CORE},
    **{(f"{core}.multiarray", "scalar"): _Call(_scalar) for core in _CORE},
    **{(f"{core}.numeric", "_frombuffer"): _Call(_from_buffer) for core in _CORE},
    ("numpy", "ndarray"): "ndarray",  # Only ever an argument.
    ("numpy", "dtype"): _Call(_DType),
    ("_codecs", "encode"): _Call(_encoded),
    ("collections", "OrderedDict"): _Call(OrderedDict),
    ("builtins", "set"): _Call(set),
    ("builtins", "frozenset"): _Call(frozenset),
    ("builtins", "complex"): _Call(complex),
    ("builtins", "bytes"): _Call(_bytes),
    ("builtins", "bytearray"): _Call(_bytes),
}


class _Unpickler(pickle._Unpickler):
    """Python's own in Python: the one in C, given a damaged file, has been seen to lose a buffer."""

    def find_class(self, module: str, name: str) -> Any:
        place = ("builtins" if module == "__builtin__" else module, name)  # Python 2's name of it.
        if place not in _KNOWN:
            raise _Refused(f"{module}.{name}")
        return _KNOWN[place]


def to_plain(value: object, within: int, done: dict[int, Any]) -> Any:
    """Copy with arrays for their stand-ins, in containers too; `done`: the copy of each object, by its id, for few
    bytes can hold the same list within itself so often that going through it would never end."""
    if within > _DEEPEST:
        raise RecursionError(f"containers in containers, more than {_DEEPEST} deep")
    if id(value) not in done:
        done[id(value)] = _made(value, within + 1, done)
    return done[id(value)]


def _made(value: object, within: int, done: dict[int, Any]) -> Any:
    match value:
        case _Array():
            array = value.array(within, done)
            return array[()] if value.shape == () and array.dtype.kind != "O" else array
        case dict():
            return {to_plain(key, within, done): to_plain(item, within, done) for key, item in value.items()}
        case list() | tuple() | set() | frozenset():
            return type(value)(to_plain(item, within, done) for item in value)
        case None | bool() | int() | float() | complex() | str() | bytes() | bytearray():
            return value
    raise _Refused(f"a {type(value).__name__.lstrip('_')} by itself")


def load_plain(path: Path) -> Any:
    """What a `.npy` file holds: an array, or the Python object in it. Raises ConfigError, a line, for what is no such
    file, is cut short, or holds anything but arrays, numbers, text and the containers of them."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(file)
        if not dtype.hasobject:
            return np.load(io.BytesIO(content), allow_pickle=False)
        found = to_plain(_Unpickler(file).load(), 0, {})
    except _Refused as error:
        raise ConfigError(
            f"{path}: holds {_first_line(error)}, which is no plain data and was not run: save arrays, numbers and text"
        ) from None
    except _MALFORMED as error:
        raise ConfigError(f"{path}: not a readable .npy file: {_first_line(error)}") from error
    if isinstance(found, np.ndarray) and found.dtype.kind == "O" and found.shape == () == shape:
        return found.item()
    return found


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:_LONGEST]
