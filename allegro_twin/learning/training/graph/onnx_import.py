"""A policy read back from its ONNX file: what normalises its inputs, and its layers, as PyTorch's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper

from allegro_twin.errors import ConfigError
from allegro_twin.learning.training.graph.onnx_export import Layered

_PLAIN = {"Tanh": torch.nn.Tanh, "Elu": torch.nn.ELU}


def layers_of(path: Path) -> Layered:
    """Of a file that `to_onnx` has written. Raises ConfigError for any other."""
    graph = onnx.load(str(path)).graph
    weights = {each.name: np.array(numpy_helper.to_array(each)) for each in graph.initializer}
    widths = {each.name: each.type.tensor_type.shape.dim[1].dim_value for each in graph.input}
    # Several inputs are put side by side first, the last node is the bounds of actions.
    before = max((at for at, node in enumerate(graph.node) if node.op_type == "Concat"), default=-1)
    turns = any(node.op_type == "Sign" for node in graph.node)
    nodes = graph.node[before + 1 : -1]
    constants = [[weights[name] for name in node.input[1:] if name in weights] for node in nodes]
    kinds = [node.op_type for node in nodes]
    if kinds[:2] != ["Sub", "Mul"] or not set(kinds[2:]) <= {"Clip", "Gemm", *_PLAIN}:
        raise ConfigError(f"{path}: not a policy that `allegro-twin train` wrote: its graph is {', '.join(kinds)}")
    bound = float(constants[2][1]) if kinds[2] == "Clip" else None
    first = 2 if bound is None else 3
    layers = [_layer(kind, given) for kind, given in zip(kinds[first:], constants[first:], strict=True)]
    return Layered(widths, constants[0][0], constants[1][0], bound, layers, turns)


class Acting(torch.nn.Module):  # type: ignore[misc]  # PyTorch is untyped where it is not installed.
    """Its mean action, within [-1, 1], of inputs that are side by side already, (n, features)."""

    def __init__(self, policy: Layered) -> None:
        super().__init__()
        self.register_buffer("mean", torch.as_tensor(policy.mean))
        self.register_buffer("scale", torch.as_tensor(policy.scale))
        self.bound, self.layers = policy.bound, torch.nn.Sequential(*policy.layers)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        scaled = (seen - self.mean) * self.scale
        if self.bound is not None:
            scaled = scaled.clamp(-self.bound, self.bound)
        found: torch.Tensor = self.layers(scaled).clamp(-1.0, 1.0)
        return found


def _layer(kind: str, given: list[Any]) -> Any:
    if kind != "Gemm":
        return _PLAIN[kind]()
    weight, bias = given
    layer = torch.nn.Linear(weight.shape[1], weight.shape[0])
    with torch.no_grad():
        layer.weight.copy_(torch.from_numpy(weight))
        layer.bias.copy_(torch.from_numpy(bias))
    return layer
