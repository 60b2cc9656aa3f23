"""An ONNX file, opened by onnxruntime."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from allegro_twin.errors import ConfigError


def session(path: Path) -> Any:
    """An open ONNX file, computing on one thread. Raises ConfigError where onnxruntime is missing."""
    try:
        import onnxruntime
        from onnxruntime.capi import onnxruntime_pybind11_state as state
    except ImportError as error:
        raise ConfigError("an ONNX policy needs onnxruntime: pip install 'allegro-twin[policy]'") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # So small a network gains nothing by more.
    refusals = (  # They share no base of their own.
        state.Fail, state.InvalidArgument, state.InvalidGraph, state.InvalidProtobuf, state.NoModel, state.NoSuchFile,
        state.NotImplemented, state.RuntimeException,
    )  # fmt: skip
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except refusals as error:
        raise ConfigError(f"{path}: not a readable ONNX file: {str(error).splitlines()[0]}") from error
