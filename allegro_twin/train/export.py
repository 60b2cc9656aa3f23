"""A trained policy as ONNX: normalisation, network and bounds in one graph that needs no PyTorch to run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from allegro_twin.files.whole import whole_file
from allegro_twin.policy.card import Card, write_card
from allegro_twin.train.network import ACHIEVED, BOUND, GOAL, Normalised

OPSET, IR = 17, 9  # Read by every onnxruntime since 1.17.


class _Graph:
    """Nodes in a row, each from the output of the last."""

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


def to_onnx(model: Any, path: Path, card: Card) -> None:
    """The mean action of a model of Stable-Baselines3 whose observations are `Normalised`, within [-1, 1]."""
    front, body, head = model.policy.pi_features_extractor, model.policy.mlp_extractor, model.policy.action_net
    assert isinstance(front, Normalised)
    names = front.names or ["observation"]
    spaces = [model.observation_space[name] for name in front.names] or [model.observation_space]
    inputs = [_floats(name, space.shape[-1]) for name, space in zip(names, spaces, strict=True)]
    graph = _Graph(names[0])
    if len(names) > 1:
        graph.last = GOAL
        graph.add("Sub", ACHIEVED)
        missing, graph.last = graph.last, names[0]
        graph.add("Concat", *names[1:], missing, axis=1)
    graph.add("Sub", graph.constant(front.mean.float().numpy()))
    graph.add("Mul", graph.constant(front.scale.numpy()))
    graph.add("Clip", graph.constant(-BOUND), graph.constant(BOUND))
    for layer in [*body.policy_net, head]:
        kind = type(layer).__name__
        if kind == "Linear":
            weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
            graph.add("Gemm", graph.constant(weight), graph.constant(bias), transB=1)
        else:
            graph.add({"Tanh": "Tanh", "ELU": "Elu"}[kind])
    graph.add("Clip", graph.constant(-1.0), graph.constant(1.0), output="action")
    whole = helper.make_graph(graph.nodes, "policy", inputs, [_floats("action", card.action)], graph.weights)
    made = helper.make_model(whole, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR)
    onnx.checker.check_model(made)
    with whole_file(path) as temporary:
        onnx.save(made, str(temporary))
        write_card(temporary, card)


def _floats(name: str, width: int) -> Any:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])
