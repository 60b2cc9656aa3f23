"""How a training begins: with a policy that does next to nothing, or with one that is there."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path
from typing import Any

import torch

from allegro_twin.errors import ConfigError
from allegro_twin.learning.training.graph.goal_features import numbers_left
from allegro_twin.learning.training.graph.onnx_import import layers_of
from allegro_twin.learning.training.learned import ACHIEVED, GOAL

STILL = 0.01
"""Of a policy's last weights, at the beginning (Andrychowicz et al. 2021, "What matters in on-policy RL")."""
KNOWN = 1_000_000
"""Observations that the normalisation of the policy counts as."""
_LEFT = "left"


def start_still(actor: Any) -> None:
    """Let an actor of rsl-rl do next to nothing: what a task does without action is a better beginning than chance."""
    with torch.no_grad():
        for each in actor.mlp[-1].parameters():
            each.mul_(STILL)


def start_from(actor: Any, path: Path, widths: dict[str, int]) -> None:
    """Take a policy over into an actor of rsl-rl that sees inputs of these `widths`: by their names, and of each the
    first numbers; what the policy does not see counts nothing. Raises ConfigError where its layers are others, or it
    sees what the actor does not."""
    given = layers_of(path)
    theirs = [layer for layer in given.layers if isinstance(layer, torch.nn.Linear)]
    mine = [layer for layer in actor.mlp if isinstance(layer, torch.nn.Linear)]
    if given.bound is not None or [layer.weight.shape[0] for layer in mine] != [len(layer.weight) for layer in theirs]:
        raise ConfigError(f"start {path}: its layers are {_sizes(theirs)}, and this recipe's {_sizes(mine)}")
    columns = _columns(path, given.widths, given.turns, widths)
    normal = actor.obs_normalizer
    with torch.no_grad():
        for layer, other in zip(mine, theirs, strict=True):
            layer.bias.copy_(other.bias)
            if layer is not mine[0]:
                layer.weight.copy_(other.weight)
        mine[0].weight.zero_()
        mine[0].weight[:, columns] = theirs[0].weight.to(mine[0].weight)
        deviation = 1.0 / torch.as_tensor(given.scale).to(normal._std) - normal.eps
        normal._mean[0, columns] = torch.as_tensor(given.mean).to(normal._mean)
        normal._std[0, columns] = deviation
        normal._var[0, columns] = deviation**2
        normal.count.fill_(KNOWN)


def _columns(path: Path, theirs: dict[str, int], turns: bool, mine: dict[str, int]) -> list[int]:
    """Where what the policy sees is among what the actor sees."""
    given, wanted = (dict(widths) for widths in (theirs, mine))
    for widths in (given, wanted):
        if GOAL in widths and ACHIEVED in widths:
            widths[_LEFT] = numbers_left(widths[GOAL], turns)
    firsts = dict(zip(wanted, accumulate(wanted.values(), initial=0), strict=False))
    more = [name for name, width in given.items() if width > wanted.get(name, 0)]
    if more:
        raise ConfigError(
            f"start {path}: it sees {given[more[0]]} numbers of {more[0]}, here are {wanted.get(more[0], 0)}"
        )
    return [firsts[name] + k for name, width in given.items() for k in range(width)]


def _sizes(layers: list[torch.nn.Linear]) -> str:
    return "-".join(str(width) for width in (layers[0].in_features, *(layer.out_features for layer in layers)))
