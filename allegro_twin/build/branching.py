"""What if: a recorded simulation goes on otherwise from some instant, beside what it did.

A simulation and its controller are deterministic. So the instant is reached by running the recording's own config
again from its beginning, with velocities, contacts, objects and the controller's memory as they were, and not by
guessing them from what was recorded; every row up to it is compared, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from pydantic import BaseModel

from allegro_twin.build.assemble import assemble
from allegro_twin.build.languages import LANGUAGES
from allegro_twin.build.rig import Rig
from allegro_twin.config import (
    CanSettings,
    DynamixelSettings,
    FaultSettings,
    FirmwareSettings,
    FollowSettings,
    GravitySettings,
    HandSettings,
    LimpSettings,
    PolicySettings,
    PositionSettings,
    ReplaySettings,
    RunConfig,
    SceneSettings,
    SimSettings,
    TaskSettings,
    TorqueSettings,
)
from allegro_twin.config.dynamixel import LineFaultSettings, ServoSettings
from allegro_twin.config.polled import PolledFaultSettings
from allegro_twin.config.run import LimitSettings
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.evaluate.held import Report
from allegro_twin.files.assets import parse_yaml
from allegro_twin.files.schema import parse
from allegro_twin.loop import Controller
from allegro_twin.replay.recording import Recording, load
from allegro_twin.sim.engine.backend import ENGINE, SimBackend
from allegro_twin.sim.model.posed import moved_by
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, Vector

Beside: TypeAlias = Callable[[], dict[str, Array]]
"""What is known beside a sample: where the recording's joints were (`target`), and what a trial sees."""
Changes: TypeAlias = Mapping[str, Any]
"""By key: `friction`, `damping`, `frictionloss`, or `controller.…` as in a config."""
_BLOCKS: Mapping[str, Mapping[str, type[BaseModel]]] = {
    "backend": {"sim": SimSettings, "can": CanSettings, "dynamixel": DynamixelSettings,
                "replay": ReplaySettings, **{language.kind: each for each, language in LANGUAGES.items()}},
    "controller": {
        "pd": PositionSettings, "pid": PositionSettings, "torque": TorqueSettings, "gravity": GravitySettings,
        "policy": PolicySettings, "limp": LimpSettings, "position": FollowSettings,
    },
    "scene": {"sim": SceneSettings},
    "hand": {"": HandSettings},
    "task": {"": TaskSettings},
    "limits": {"": LimitSettings},
    "faults": {"": FaultSettings},
    "servos": {"": ServoSettings},
    "firmware": {"": FirmwareSettings},
}  # fmt: skip
_LINES: Mapping[type[BaseModel], type[BaseModel]] = {
    DynamixelSettings: LineFaultSettings, **dict.fromkeys(LANGUAGES, PolledFaultSettings),
}  # fmt: skip
"""What may go wrong on whose line."""
PHYSICS = ("friction", "damping", "frictionloss")


@dataclass(frozen=True, slots=True, eq=False)
class Branched:
    """Both futures."""

    t: Vector
    """s, (k,), of the whole recording."""
    recorded: Array
    """Joint positions as they were, (k, n), rad."""
    branched: Array
    """As they would have been."""
    spec: HandSpec
    report: Report | None
    """The verdict on the branch, where the recording is of a scenario."""


def branch(
    path: Path,
    at: float,
    changes: Changes,
    through: Callable[[Iterator[Sample], Beside], Iterator[Sample]] = lambda samples, beside: samples,
) -> Branched:
    """Go on otherwise from `at`, s; `through`: stages for its samples. Raises ConfigError for a recording that cannot
    be repeated, or an odd change."""
    recording = load(path)
    config = _config(recording)
    after = _checked(config, changes)
    last = float(recording.columns["t"][-1])
    if not 0.0 <= at <= last:
        raise ConfigError(f"--at {at:g} s: {path} goes from 0 to {last:g} s")
    rig = assemble(config)
    if rig.sim is None:
        raise ConfigError(f"{path} is of a hand that is not simulated: only a simulation can go on otherwise")
    other = assemble(after).controller if after is not config else None
    with closing(rig.backend):
        samples = _run(rig, rig.sim, at, changes, other)
        follower = _Follower(recording, at, rig)
        samples = follower.watched(rig.trial.watched(samples) if rig.trial is not None else samples)
        found = [sample.state.position for sample in through(samples, follower.beside)]
        whole = rig.trial is not None and last >= rig.trial.seconds - 1e-9
        report = rig.trial.report() if whole and rig.trial is not None else None
    return Branched(recording.columns["t"], recording.columns["position"], np.array(found), rig.spec, report)


class _Follower:
    """Keeps up with the recording row by row, to its end."""

    def __init__(self, recording: Recording, at: float, rig: Rig) -> None:
        self._recording, self._at, self._trial, self._row = recording, at, rig.trial, 0

    def watched(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """A stage. Raises ConfigError where the samples are not the recording's before `at`."""
        path, position = self._recording.path, self._recording.columns["position"]
        for row, sample in enumerate(samples):
            self._row = row
            if sample.state.t <= self._at + 1e-9 and (sample.state.position != position[row]).any():
                raise ConfigError(
                    f"{path} is not repeated by this program: it differs at {sample.state.t:.3f} s. Was it made by "
                    "another version, or interrupted by hand?"
                )
            yield sample
            if row + 1 == len(self._recording):
                return

    def beside(self) -> dict[str, Array]:
        own: dict[str, Array] = dict(self._trial.latest()) if self._trial is not None else {}
        return own | {"target": self._recording.columns["position"][self._row]}


def changes_of(texts: list[str]) -> dict[str, Any]:
    """`friction=0.5` and the like. Raises ConfigError."""
    found = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise ConfigError(f"--set {text}: say key=value, for example friction=0.5 or controller.gains=v4")
        if key not in PHYSICS and not key.startswith("controller."):
            raise ConfigError(f"--set {text}: {unknown('key', key, [*PHYSICS, 'controller.gains'])}")
        found[key] = parse_yaml(f"value: {value}", f"--set {text}")["value"]
        if key in PHYSICS and (isinstance(found[key], bool) or not isinstance(found[key], int | float)):
            raise ConfigError(f"--set {text}: {key} needs a number, not {value}")
    return found


def _config(recording: Recording) -> RunConfig:
    """The recording's own. Raises ConfigError where it cannot be run again."""
    content, engine = recording.meta.get("config"), recording.meta.get("engine")
    if content is None or engine is None:
        raise ConfigError(
            f"{recording.path} is of a hand, not of a simulation: its speeds, contacts and objects are not known well "
            "enough to go on from them"
        )
    if engine != ENGINE:
        raise ConfigError(f"{recording.path} was made with {engine}, and this is {ENGINE}: it would not be the same")
    return parse(RunConfig, _given(RunConfig, content), f"{recording.path}: config")


def _given(model: type[BaseModel], content: Mapping[str, Any]) -> dict[str, Any]:
    """What somebody wrote: a recording holds all keys of a config, and one at its default is read by nobody here."""
    found = {}
    for key, value in content.items():
        default = model.model_fields[key].get_default(call_default_factory=True)
        if value is None or value == (list(default) if isinstance(default, tuple) else default):
            continue
        if key == "faults" and model in _LINES:
            value = _given(_LINES[model], value)
        elif key in _BLOCKS and isinstance(value, Mapping):
            value = _given(_BLOCKS[key].get(value.get("kind", ""), _BLOCKS[key].get("", RunConfig)), value)
        found[key] = value
    return found


def _checked(config: RunConfig, changes: Changes) -> RunConfig:
    """The config with its controller changed; the same one where that is not asked for."""
    own = {key.removeprefix("controller."): value for key, value in changes.items() if key.startswith("controller.")}
    return config.changed(controller=own) if own else config


def _run(rig: Rig, sim: SimBackend, at: float, changes: Changes, other: Controller[Any] | None) -> Iterator[Sample]:
    """The loop, with a change in the middle; a controller of the same kind keeps its memory, another begins anew."""
    controller, backend = rig.controller, rig.backend
    state = backend.reset()
    memory, done = controller.start(state), False
    while True:
        if not done and state.t >= at - 1e-9:
            done = True
            _apply(sim, changes)
            if other is not None:
                same = type(other) is type(controller) and hasattr(other, "gains")
                controller = replace(controller, gains=other.gains) if same else other  # type: ignore[type-var, attr-defined]
                memory = memory if same else controller.start(state)
        command, memory = controller(state, memory)
        backend.write(command)
        yield Sample(state, command)
        state = backend.read()


def _apply(sim: SimBackend, changes: Changes) -> None:
    """Friction of every contact; damping (N·m·s/rad) and dry friction (N·m) of every joint."""
    joints = [*moved_by(sim.spec, sim.model).values(), *(sim.model.joint(f.name).id for f in sim.spec.followers)]
    dofs = [int(sim.model.jnt_dofadr[joint]) for joint in joints]
    if "friction" in changes:
        sim.model.geom_friction[:, 0] = changes["friction"]
    if "damping" in changes:
        sim.model.dof_damping[dofs] = changes["damping"]
    if "frictionloss" in changes:
        sim.model.dof_frictionloss[dofs] = changes["frictionloss"]
