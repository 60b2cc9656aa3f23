"""Functions of arrays under NumPy's names, for NumPy's arrays and for PyTorch's tensors on a device alike.

`array_namespace(x)` is NumPy for its own arrays, else an object with the functions that this package needs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray


def array_namespace(x: Any) -> Any:
    """The functions for an array: `numpy`, or the `TensorNamespace` of a tensor's device."""
    return np if isinstance(x, np.ndarray | np.generic | float) else tensor_namespace(str(x.device))


@cache
def tensor_namespace(device: str) -> TensorNamespace:
    """The functions for one device, as PyTorch calls it. Raises ImportError without PyTorch."""
    return TensorNamespace(device)


def as_array(x: Any) -> NDArray[np.float64]:
    """A tensor as it is; anything else as NumPy's array of doubles."""
    return x if hasattr(x, "device") and not isinstance(x, np.ndarray) else np.asarray(x, dtype=np.float64)


_YZX = np.array([1, 2, 0])


def take(x: Any, index: Any, axis: int) -> Any:
    """Parts of an array along its first axis (0) or its last (-1). NumPy's own indexing takes five times as long."""
    if isinstance(x, np.ndarray):
        return x.take(index, axis)
    return x[index] if axis == 0 else x[..., index]


def cross(x: Any, y: Any) -> Any:
    """Cross products of vectors (..., 3); NumPy's own, with the same bits, takes ten times as long."""
    if not isinstance(x, np.ndarray):
        return array_namespace(x).cross(x, y)
    return (x * y.take(_YZX, -1) - x.take(_YZX, -1) * y).take(_YZX, -1)


def to_numpy(x: Any) -> Any:
    """NumPy's array of an array; a tensor on a device is copied."""
    return x if isinstance(x, np.ndarray) else x.detach().cpu().numpy()


def fetch(tree: Any) -> Any:
    """A tree of dictionaries and tuples with NumPy's arrays in place of tensors, which are copied from their device all
    at once; each array has a row for each of the same simulations."""
    leaves = list(_leaves(tree))
    if all(isinstance(leaf, np.ndarray) for leaf in leaves):
        return tree
    join = array_namespace(leaves[0])
    parts = [join.asarray(leaf.reshape(len(leaf), -1), np.float64) for leaf in leaves]
    whole = iter(
        np.split(to_numpy(join.concatenate(parts, axis=-1)), np.cumsum([part.shape[1] for part in parts]), axis=-1)
    )
    kinds = {str(kind): np.dtype(name) for name, kind in (("int64", join.torch.int64), ("bool", join.torch.bool))}
    rows = (
        np.ascontiguousarray(next(whole).reshape(tuple(leaf.shape)), kinds.get(str(leaf.dtype), np.float32))
        for leaf in leaves
    )
    return _filled(tree, rows)


def _leaves(tree: Any) -> Iterator[Any]:
    if isinstance(tree, dict | tuple):
        for part in tree.values() if isinstance(tree, dict) else tree:
            yield from _leaves(part)
    else:
        yield tree


def _filled(tree: Any, leaves: Iterator[Any]) -> Any:
    if isinstance(tree, dict):
        return {name: _filled(part, leaves) for name, part in tree.items()}
    if isinstance(tree, tuple):
        parts = [_filled(part, leaves) for part in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    return next(leaves)


class TensorNamespace:
    """NumPy's functions for tensors on one device: real numbers are in single precision, whole ones have 64 bits."""

    def __init__(self, device: str) -> None:
        import torch

        self.torch, self.device = torch, torch.device(device)
        self._kinds = {
            np.dtype(np.float32): torch.float32,
            np.dtype(np.float64): torch.float32,
            np.dtype(np.int64): torch.int64,
            np.dtype(np.uint64): torch.int64,
            np.dtype(bool): torch.bool,
        }
        for name in (
            "where", "exp", "log", "sqrt", "abs", "sign", "sin", "cos", "arctan2", "arccos", "floor", "isfinite", "any",
        ):  # fmt: skip
            setattr(self, name, getattr(torch, name))
        self.rint = torch.round

    def asarray(self, x: Any, dtype: Any = None) -> Any:
        """A copy of an array on the device; a tensor is on it already."""
        if isinstance(x, self.torch.Tensor):
            return x if dtype is None else x.to(self._kinds[np.dtype(dtype)])
        array = np.asarray(x, dtype)
        return self.torch.tensor(array, dtype=self._kinds[array.dtype], device=self.device)

    def double(self, x: Any) -> Any:
        """In double precision."""
        return self.torch.as_tensor(x, dtype=self.torch.float64, device=self.device)

    def zeros(self, shape: Any, dtype: Any = np.float64) -> Any:
        return self.torch.zeros(shape, dtype=self._kinds[np.dtype(dtype)], device=self.device)

    def ones(self, shape: Any, dtype: Any = np.float64) -> Any:
        return self.torch.ones(shape, dtype=self._kinds[np.dtype(dtype)], device=self.device)

    def full(self, shape: Any, value: Any, dtype: Any = np.float64) -> Any:
        return self.torch.full((shape,), value, dtype=self._kinds[np.dtype(dtype)], device=self.device)

    def arange(self, n: int) -> Any:
        return self.torch.arange(n, device=self.device)

    def copy(self, x: Any) -> Any:
        return x.clone()

    def flatnonzero(self, x: Any) -> Any:
        return self.torch.nonzero(x).reshape(-1)

    def concatenate(self, parts: Sequence[Any], axis: int = 0) -> Any:
        return self.torch.cat(list(parts), dim=axis)

    def stack(self, parts: Sequence[Any], axis: int = 0) -> Any:
        return self.torch.stack(list(parts), dim=axis)

    def clip(self, x: Any, low: Any, high: Any) -> Any:
        return self.torch.clamp(x, low, high)

    def minimum(self, x: Any, y: Any) -> Any:
        return self.torch.minimum(x, y) if isinstance(y, self.torch.Tensor) else self.torch.clamp(x, max=y)

    def maximum(self, x: Any, y: Any) -> Any:
        return self.torch.maximum(x, y) if isinstance(y, self.torch.Tensor) else self.torch.clamp(x, min=y)

    def max(self, x: Any, axis: int) -> Any:
        return self.torch.amax(x, dim=axis)

    def cross(self, x: Any, y: Any) -> Any:
        return self.torch.linalg.cross(x, y)

    def nan_to_num(self, x: Any, nan: float = 0.0, posinf: float | None = None, neginf: float | None = None) -> Any:
        return self.torch.nan_to_num(x, nan, posinf, neginf)
