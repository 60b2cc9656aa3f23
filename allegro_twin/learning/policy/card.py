"""Policy cards: for which hand, task and control mode a policy was trained, and what it needs to run elsewhere."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.schema import Positive, Settings, parse_settings
from allegro_twin.hands.description.specs import load_spec, names_shipped_hand
from allegro_twin.hands.library.entries import HAND
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.learning.policy.interface import VERSION, Interface, Mode, observation_frame
from allegro_twin.learning.policy.script import (
    SampledScript,
    closing_moves,
    holding_script,
    sample_script,
    script_table,
)
from allegro_twin.spec import HandSpec, Side

KEY = "allegro_twin"
"""Key of the card in an ONNX file's metadata; a zip has it as the member `allegro_twin.json`."""
MEMBER = f"{KEY}.json"
ARM_PICK = "AllegroTwin/ArmPick-v0"
"""Task in the cards of policies that move an arm with its hand."""
CardType = TypeVar("CardType", bound="NetworkCard")


class GraspScript(Settings):
    """A script that closes a grasp of the library."""

    grasp: str
    wait: Positive
    """s in the pre-shape."""
    squeeze: Positive
    """s from closed to squeezed."""
    holds: bool = False
    """The squeeze from the beginning, without motion."""

    def sampled(self, spec: HandSpec, periods: int, period: float) -> SampledScript:
        grasp = load_grasp(self.grasp, spec)
        if self.holds:
            return holding_script(grasp, periods)
        return sample_script(closing_moves(grasp, self.wait, self.squeeze), grasp.preshape, periods, period)


class NetworkCard(Settings):
    """Description inside the file of any policy."""

    version: int = VERSION
    """Version of the meaning of observations and actions."""
    task: str
    """Id of the environment."""
    observation: int
    """Numbers in an observation, without goals."""
    action: int
    """Numbers in an action."""
    note: str = ""
    """How it was trained."""
    environment: dict[str, Any] | None = None
    """Keywords of the environments that it was trained in. None: not recorded."""


class PolicyCard(NetworkCard):
    """Description inside the file of a policy that moves a hand."""

    hand: str = HAND
    """The model of hand."""
    side: Side
    mode: Mode
    period: Positive
    decimation: Annotated[int, Field(ge=1)]
    step: Positive
    reach: Positive
    gains: str
    goal: Literal["none", "fingertips"]
    scripts: tuple[GraspScript, ...] = ()
    periods: int = 0
    """Length of the scripts, in control periods."""
    history: Annotated[int, Field(ge=1)] = 1
    """Decisions in an observation."""
    privileged: int = 0
    """Numbers of the observation that no real hand has."""
    algorithm: str = "PPO"
    """Class of Stable-Baselines3, for a zip."""

    def interface(self, spec: HandSpec) -> Interface:
        """Make the interface to a hand. Raises ConfigError for the other hand, another version, or a policy that no
        real hand can serve."""
        _check_version(self, "this policy")
        if self.hand != spec.model:
            raise ConfigError(f"this policy is for a hand of the model {self.hand}; this one is {spec.model}")
        if self.side != spec.side:
            raise ConfigError(f"this policy is for the {self.side} hand; this one is the {spec.side} hand: "
                              f"train one for it (allegro-twin train RECIPE --side {spec.side})")  # fmt: skip
        if self.privileged:
            raise ConfigError(
                f"this policy of {self.task} is privileged: {self.privileged} of the numbers it sees are not measured "
                "by any hand; it runs in its environment only"
            )
        if pictures := (self.environment or {}).get("observe"):
            raise ConfigError(
                f"this policy of {self.task} sees pictures ({', '.join(pictures)}), which no hand reports: it runs in "
                "its environment only"
            )
        rows = [closed.sampled(spec, self.periods, self.period) for closed in self.scripts]
        scripts = script_table(rows) if rows else None
        gains = load_gains(self.gains, spec)
        made = Interface(
            spec,
            gains,
            self.mode,
            self.period,
            self.decimation,
            self.step,
            scripts,
            self.reach,
            self.goal,
            self.history,
        )
        if (made.n_observation, spec.n_joints) != (self.observation, self.action):
            raise ConfigError(
                f"the policy sees {self.observation} numbers and gives {self.action}; this hand's interface has "
                f"{made.n_observation} and {spec.n_joints}"
            )
        return made

    def check_numbers(self, where: str) -> None:
        """Raise ConfigError for numbers of observations or actions that no task of this model of hand has. `where`: its
        file. Of a hand that is not on this computer nobody knows them."""
        if not names_shipped_hand(self.hand):
            return
        joints = load_spec(self.hand, self.side).n_joints
        sees = observation_frame(joints, bool(self.scripts or self.periods)) * self.history + self.privileged
        if (self.observation, self.action) != (sees, joints):
            raise ConfigError(
                f"{where}: its card says {self.observation} numbers of observation and {self.action} of action; with "
                f"history {self.history} and {self.privileged} privileged numbers a policy of {self.hand} has {sees} "
                f"and {joints}"
            )

    def script(self, grasp: str) -> int:
        """Number of a grasp's script. Raises ConfigError with the nearest names."""
        names = [closed.grasp for closed in self.scripts]
        if grasp not in names:
            raise ConfigError(unknown("grasp of this policy", grasp, sorted({*names})))
        return names.index(grasp)


def check_card(
    card: PolicyCard,
    task: PolicyCard,
    remedy: str = "give the recipe that it was trained with",
    who: str = "the policy",
) -> None:
    """Raise ConfigError unless a policy's card is one that this task would write, for any objects."""
    for name in sorted(
        PolicyCard.model_fields, key=("observation", "action").__contains__
    ):  # These follow from others.
        if name in ("scripts", "periods", "note", "algorithm", "environment"):
            continue
        if getattr(card, name) != getattr(task, name):
            raise ConfigError(
                f"{who} has {name} {getattr(card, name)}, these environments have {getattr(task, name)}: {remedy}"
            )


def _check_version(card: NetworkCard, who: str) -> None:
    if card.version != VERSION:
        raise ConfigError(f"{who} is of version {card.version}; this package runs {VERSION}: train it anew")


def read_card(path: Path) -> PolicyCard:
    """Read the card of a policy that moves a hand. Raises ConfigError without a card or file, for one of another
    version, and for a policy of `ArmPick`."""
    content = _card_content(path)
    if content.get("task") == ARM_PICK:
        raise ConfigError(
            f"{path} is a policy of ArmPick, which moves an arm with its hand: it runs in its environment only, "
            f'gymnasium.make("{ARM_PICK}", policy=…)'
        )
    return _parsed(path, content, PolicyCard)


def policy_task(path: Path) -> str:
    """Id of the environment of a policy. Raises ConfigError as `read_card` does."""
    return str(_card_content(path).get("task"))


def read_network_card(path: Path, kind: type[CardType], task: str) -> CardType:
    """Read a card of another kind. Raises ConfigError as `read_card` does, and for another task's."""
    content = _card_content(path)
    if content.get("task") != task:
        raise ConfigError(f"{path} is a policy of {content.get('task')}, not of {task}")
    return _parsed(path, content, kind)


def _parsed(path: Path, content: Any, kind: type[CardType]) -> CardType:
    card = parse_settings(kind, content, str(path))
    _check_version(card, f"policy {path}")
    return card


def _card_content(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ConfigError(f"{path}: no such policy file")
    text = _zip_text(path) if path.suffix == ".zip" else _onnx_text(path)
    if text is None:
        raise ConfigError(f"{path}: no card inside: not a policy of this package, or saved by other means")
    try:
        content: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: its card is not JSON ({error}): write it with write_card") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: its card is no JSON object: write it with write_card")
    return content


def write_card(path: Path, card: NetworkCard) -> None:
    """Write a card into a policy file that has none. Raises ConfigError for a file that is neither .zip nor .onnx."""
    text = card.model_dump_json()
    if path.suffix == ".zip":
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(MEMBER, text)
        return
    if path.suffix != ".onnx":
        raise ConfigError(f"{path}: a policy file ends in .onnx or .zip")
    try:
        import onnx
    except ImportError as error:
        raise ConfigError("writing an ONNX policy needs onnx: pip install 'allegro-twin[rl]'") from error
    model = onnx.load(str(path))
    model.metadata_props.add(key=KEY, value=text)
    onnx.save(model, str(path))


def _zip_text(path: Path) -> bytes | None:
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.read(MEMBER) if MEMBER in archive.namelist() else None
    except zipfile.BadZipFile as error:
        raise ConfigError(f"{path}: not a zip file") from error


def _onnx_text(path: Path) -> str | None:
    found: dict[str, str] = onnx_session(path).get_modelmeta().custom_metadata_map
    return found.get(KEY)


def onnx_session(path: Path) -> Any:
    """Open an ONNX file, to compute on one thread. Raises ConfigError where onnxruntime is missing."""
    try:
        import onnxruntime
        from onnxruntime.capi import onnxruntime_pybind11_state as state
    except ImportError as error:
        raise ConfigError("an ONNX policy needs onnxruntime: pip install 'allegro-twin[policy]'") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # So small a network gains nothing by more.
    refusals = (  # They share no base class.
        state.Fail, state.InvalidArgument, state.InvalidGraph, state.InvalidProtobuf, state.NoModel, state.NoSuchFile,
        state.NotImplemented, state.RuntimeException,
    )  # fmt: skip
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except refusals as error:
        raise ConfigError(f"{path}: not a readable ONNX file: {str(error).splitlines()[0]}") from error
