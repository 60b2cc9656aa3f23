"""ONNX files of trained policies: normalisation, network and bounds in one graph, written and read back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from allegro_twin.errors import ConfigError
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.learning.policy.card import NetworkCard, write_card
from allegro_twin.learning.training.goal_features import HAD, SCALAR, VECTOR, WANTED
from allegro_twin.learning.training.progress import ACHIEVED, GOAL

OPSET, IR = 17, 9  # Read by every onnxruntime since 1.17.


class _Graph:
    """Nodes in a chain, each from the output of the last."""

    def __init__(self, first: str) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []
        self.last = first

    def constant(self, value: Any) -> str:
        name = f"c{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(value, np.float32), name))
        return name

    def add(self, kind: str, *further: str, output: str | None = None, **attributes: Any) -> None:
        output = output or f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, [self.last, *further], [output], **attributes))
        self.last = output


@dataclass(frozen=True, slots=True, eq=False)
class PolicyNetwork:
    """A policy's mean action: inputs are concatenated, normalised, and passed through layers."""

    widths: dict[str, int]
    """Names and widths of the inputs, in order. With a goal the goal difference follows as a further part."""
    mean: Any
    scale: Any
    """Factor on the distance from the mean, (features,)."""
    bound: float | None
    """Clipping limit of normalised inputs."""
    layers: list[Any]
    """PyTorch layers: linear ones, Tanh and ELU."""
    turns: bool = False
    """Goals are orientations (allegro_twin/learning/training/goal_features.py)."""


def to_onnx(policy: PolicyNetwork, path: Path, card: NetworkCard) -> None:
    """Write the mean action, within [-1, 1]."""
    names = list(policy.widths)
    inputs = [_floats(name, width) for name, width in policy.widths.items()]
    graph = _Graph(names[0])
    if len(names) > 1:
        missing = _add_goal_difference(graph, policy.turns)
        graph.last = names[0]
        graph.add("Concat", *names[1:], missing, axis=1)
    graph.add("Sub", graph.constant(policy.mean))
    graph.add("Mul", graph.constant(policy.scale))
    if policy.bound is not None:
        graph.add("Clip", graph.constant(-policy.bound), graph.constant(policy.bound))
    for layer in policy.layers:
        kind = type(layer).__name__
        if kind == "Linear":
            weight, bias = (part.detach().cpu().numpy() for part in (layer.weight, layer.bias))
            graph.add("Gemm", graph.constant(weight), graph.constant(bias), transB=1)
        else:
            graph.add({"Tanh": "Tanh", "ELU": "Elu"}[kind])
    graph.add("Clip", graph.constant(-1.0), graph.constant(1.0), output="action")
    whole = helper.make_graph(graph.nodes, "policy", inputs, [_floats("action", card.action)], graph.weights)
    made = helper.make_model(whole, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    onnx.checker.check_model(made)
    with atomic_file(path) as temporary:
        onnx.save(made, str(temporary))
        write_card(temporary, card)


def _add_goal_difference(graph: _Graph, turns: bool) -> str:
    """Add nodes of the goal difference; returns the name of its output."""
    graph.last = GOAL
    if not turns:
        graph.add("Sub", ACHIEVED)
        return graph.last
    graph.last = ACHIEVED
    graph.add("MatMul", graph.constant(HAD))
    had, graph.last = graph.last, GOAL
    graph.add("MatMul", graph.constant(WANTED))
    graph.add("Mul", had)
    products = graph.last
    graph.add("MatMul", graph.constant(SCALAR))
    graph.add("Sign")
    sign, graph.last = graph.last, products
    graph.add("MatMul", graph.constant(VECTOR))
    graph.add("Mul", sign)
    return graph.last


def _floats(name: str, width: int) -> Any:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])


_PLAIN = {"Tanh": torch.nn.Tanh, "Elu": torch.nn.ELU}


def read_onnx_network(path: Path) -> PolicyNetwork:
    """Read a file that `to_onnx` has written. Raises ConfigError for any other."""
    graph = onnx.load(str(path)).graph
    weights = {each.name: np.array(numpy_helper.to_array(each)) for each in graph.initializer}
    widths = {each.name: each.type.tensor_type.shape.dim[1].dim_value for each in graph.input}
    # Several inputs are concatenated first; the last node clips actions.
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
    return PolicyNetwork(widths, constants[0][0], constants[1][0], bound, layers, turns)


class NetworkActor(torch.nn.Module):  # type: ignore[misc]  # PyTorch is untyped where it is not installed.
    """The mean action as a PyTorch module, within [-1, 1], of concatenated inputs (n, features)."""

    def __init__(self, policy: PolicyNetwork) -> None:
        super().__init__()
        self.register_buffer("mean", torch.as_tensor(policy.mean))
        self.register_buffer("scale", torch.as_tensor(policy.scale))
        self.bound, self.layers = policy.bound, torch.nn.Sequential(*policy.layers)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        scaled = (observation - self.mean) * self.scale
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
