"""Loads policies from files: ONNX through onnxruntime, and Stable-Baselines3's own zip."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from allegro_twin.errors import CommandError, ConfigError, unknown
from allegro_twin.files.assets import find_file
from allegro_twin.learning.policy.card import NetworkCard, PolicyCard, onnx_session, read_card
from allegro_twin.learning.policy.controller import Policy, PolicyController
from allegro_twin.learning.policy.interface import Floats, Observation
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector


@dataclass(frozen=True, slots=True, eq=False)
class LoadedPolicy:
    """A policy and its card."""

    policy: Policy
    card: PolicyCard


def load_policy(path: str | Path, *, trust: bool = False) -> LoadedPolicy:
    """Load a policy from `.onnx`, by path or by the name of one that ships, or from `.zip` where `trust` says that its
    maker is trusted: loading it runs what is pickled in it.

    Raises ConfigError for a missing file or library, no card, spaces that do not fit the card or its hand, numbers that
    are not float32, or a zip that is not trusted.
    """
    file = policy_file(path)
    card = read_card(file)
    if file.suffix != ".onnx" and not trust:
        raise ConfigError(
            f"{path}: a zip of Stable-Baselines3 can run any program when it is loaded: take the policy's .onnx, or, "
            "if you trust who made it, load_policy(…, trust=True), in a config trust: true"
        )
    policy = _Onnx(file, card) if file.suffix == ".onnx" else _Baselines(file, card)
    card.check_numbers(str(file))
    return LoadedPolicy(policy, card)


def onnx_policy(file: Path, card: NetworkCard) -> Policy:
    """The network of an ONNX file with this card. Raises ConfigError for one of other sizes."""
    return _Onnx(file, card)


def policy_file(path: str | Path) -> Path:
    """A policy's file, by its path or by the name of one that ships. Raises ConfigError with the nearest names."""
    given = Path(path)
    if not given.suffix and len(given.parts) == 1:
        return find_file(given, "policy", "conf/policies", ".onnx")
    if given.suffix not in (".onnx", ".zip"):
        raise ConfigError(f"{path}: a policy file ends in .onnx or .zip")
    return given


def policy_controller(
    path: str | Path, spec: HandSpec, *, goal: Vector | None = None, grasp: str | None = None
) -> PolicyController:
    """Make the controller of a policy file for this hand. `grasp`: choose one of its scripts; None for the first."""
    loaded = load_policy(path)
    script = 0 if grasp is None else loaded.card.script(grasp)
    return PolicyController(loaded.policy, loaded.card.interface(spec), goal, script)


PARTS = ("observation", "achieved_goal", "desired_goal", "state")
"""Parts of an observation, by name. Pictures come besides."""
_FLOATS = "tensor(float)"


def check_inputs(path: Path, parts: Iterable[str], who: str) -> None:
    """Raise ConfigError where an ONNX policy takes what is not among these parts of an observation. What a zip takes is
    known once it is trusted."""
    if path.suffix != ".onnx":
        return
    for name in (entry.name for entry in onnx_session(path).get_inputs()):
        if name not in parts:
            raise ConfigError(f"{who} takes {name}; an observation of these environments has {', '.join(parts)}")


class _Onnx:
    """Inputs have the names of the observation's parts, or `observation` alone; the output is `action`."""

    def __init__(self, path: Path, card: NetworkCard) -> None:
        self._session = onnx_session(path)
        self._path = path
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        for entry in (*inputs, outputs[0]):
            if entry.type != _FLOATS or len(entry.shape) != 2:
                raise ConfigError(f"{path}: {entry.name} is a {entry.type} of shape {entry.shape}; a policy takes and "
                                  "gives float32 of shape (n, numbers): export it so")  # fmt: skip
        self._sizes = {entry.name: entry.shape[-1] for entry in inputs}
        if PARTS[0] not in self._sizes or not self._sizes.keys() <= {*PARTS}:
            raise ConfigError(f"{path}: the network takes {', '.join(self._sizes) or 'nothing'}; its inputs must be "
                              f"named as the parts of an observation: {', '.join(PARTS)}")  # fmt: skip
        _check_sizes(path, (self._sizes[PARTS[0]], outputs[0].shape[-1]), card)
        self._rows = inputs[0].shape[0]

    def __call__(self, observation: Observation) -> Floats:
        parts = _checked_parts(self._path, observation, self._sizes)
        single = parts["observation"].ndim == 1
        feed = {name: np.atleast_2d(parts[name]) for name in self._sizes}
        if isinstance(self._rows, int) and any(len(part) != self._rows for part in feed.values()):
            raise CommandError(f"policy {self._path.name} takes {self._rows} observations at once, not "
                               f"{len(feed[PARTS[0]])}: export it with a free first axis")  # fmt: skip
        action: Floats = _checked_action(self._path, self._session.run(None, feed)[0])
        return action[0] if single else action


class _Baselines:
    """A model of Stable-Baselines3, deterministic."""

    def __init__(self, path: Path, card: PolicyCard) -> None:
        try:
            import stable_baselines3
        except ImportError as error:
            message = "a policy in a zip needs stable-baselines3: pip install 'allegro-twin[rl]'"
            raise ConfigError(message) from error
        if not hasattr(stable_baselines3, card.algorithm):
            raise ConfigError(f"{path}: {unknown('algorithm', card.algorithm, stable_baselines3.__all__)}")
        self._model = getattr(stable_baselines3, card.algorithm).load(str(path), device="cpu")
        space = self._model.observation_space
        spaces = dict(space.spaces) if hasattr(space, "spaces") else {"observation": space}
        self._path, self._whole = path, hasattr(space, "spaces")
        self._sizes = {name: each.shape[-1] for name, each in spaces.items()}
        part = spaces["observation"]
        _check_sizes(path, (part.shape[-1], self._model.action_space.shape[-1]), card)

    def __call__(self, observation: Observation) -> Floats:
        parts = _checked_parts(self._path, observation, self._sizes)
        seen = parts if self._whole else parts["observation"]
        return _checked_action(self._path, self._model.predict(seen, deterministic=True)[0])


def _check_sizes(path: Path, sizes: tuple[object, object], card: NetworkCard) -> None:
    """Raise ConfigError unless the file's spaces are its card's. A free axis of an ONNX file is no number."""
    for size, expected, what in zip(sizes, (card.observation, card.action), ("sees", "gives"), strict=True):
        if isinstance(size, int) and size != expected:
            raise ConfigError(f"{path}: the network {what} {size} numbers; its card says {expected}, for {card.task}")


def _checked_action(path: Path, action: Floats) -> Floats:
    """Raise CommandError for an action that is not finite."""
    if not np.isfinite(action).all():
        at = np.argwhere(~np.isfinite(action))[0]
        raise CommandError(f"policy {path.name}: its action is not finite: {action[tuple(at)]} at {at[-1]}")
    return action


def _checked_parts(path: Path, observation: Observation, sizes: Mapping[str, object]) -> dict[str, Floats]:
    """The parts of an observation that a policy takes, each (numbers,) or (n, numbers). Raises CommandError for other
    parts, other sizes, and for what is not finite."""
    given = observation if isinstance(observation, dict) else {"observation": observation}
    found: dict[str, Floats] = {}
    for name, size in sizes.items():
        if name not in given:
            raise CommandError(f"policy {path.name} takes {', '.join(sizes)}; the observation has {', '.join(given)}")
        part = np.asarray(given[name], np.float32)
        if part.ndim not in (1, 2) or (isinstance(size, int) and part.shape[-1] != size):
            raise CommandError(f"policy {path.name} takes {size} numbers of {name}, not an array of shape {part.shape}")
        if not np.isfinite(part).all():
            at = np.argwhere(~np.isfinite(part))[0]
            raise CommandError(f"policy {path.name}: {name} is not finite: {part[tuple(at)]} at {at[-1]}")
        found[name] = part
    return found
