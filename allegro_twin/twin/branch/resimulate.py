"""Branch of a recorded simulation: it runs again from its beginning, with a change at some instant.

A simulation, an episode of an environment included, and its controller are deterministic. Running the recording's own
config again therefore reaches the instant with all velocities, contacts, objects and the controller's memory as they
were. Every row up to it is compared, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np

from allegro_twin.app.rig import Rig, assemble
from allegro_twin.app.session import describe_episode, scene_of_episode
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError
from allegro_twin.recording.reader import Recording
from allegro_twin.sim.engine.backend import ENGINE
from allegro_twin.twin.branch.overrides import Changes, apply_changes, hand_change, recorded_config
from allegro_twin.twin.branch.recover_controller import hand_over
from allegro_twin.twin.branch.result import BranchResult, SampleStages
from allegro_twin.types import Array, Sample

if TYPE_CHECKING:
    from allegro_twin.learning.environments.episode import EpisodeBackend


def resimulate(recording: Recording, at: float, changes: Changes, stages: SampleStages) -> BranchResult:
    """Run a recorded simulation again. Raises ConfigError for a recording that cannot be repeated."""
    path, engine = recording.path, recording.meta.get("engine", "an earlier version")
    if engine != ENGINE:
        raise ConfigError(f"{path} was made with {engine}, and this is {ENGINE}: it would not be the same")
    config = recorded_config(recording)
    after = apply_changes(config, changes)
    rig = assemble(config)
    with ExitStack() as stack:
        stack.callback(rig.backend.close)
        if rig.sim is None and rig.episode is None:
            raise ConfigError(f"{path} is of a simulation that its config does not describe: it cannot be repeated")
        other = None if after is config else rig.with_controller(after)
        for planner in (each.planner for each in (rig, other) if each is not None):
            if planner is not None:
                stack.callback(planner.close)
        last = float(recording.columns["t"][-1])
        follower = _Follower(recording, at, rig)
        samples = _run(rig, at, changes, None if other is None else other.controller)
        samples = follower.watched(rig.trial.watched(samples) if rig.trial is not None else samples)
        positions = [sample.state.position for sample in stages(samples, follower.beside)]
        whole = rig.trial is not None and last >= rig.trial.seconds - 1e-9
        report = rig.trial.report() if whole and rig.trial is not None else None
        notes = () if rig.episode is None else tuple(_became(rig.episode, last))
    return BranchResult(
        recording.columns["t"], recording.columns["position"], np.array(positions), rig.spec, report, notes=notes
    )


def _became(episode: EpisodeBackend, last: float) -> Iterator[str]:
    """What became of the episode of a branch by the end of its recording, `last`, s."""
    yield from (f"The episode of the branch: {line}" for line in describe_episode(episode))
    if not episode.over:
        yield f"It is not over at {last:.2f} s, where the recording ends."


class _Follower:
    """Follows the recording row by row, to its end."""

    def __init__(self, recording: Recording, at: float, rig: Rig) -> None:
        self._recording, self._at, self._trial, self._row = recording, at, rig.trial, 0
        self._scene = None if rig.episode is None else scene_of_episode(rig.episode)

    def watched(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """Compare samples before `at` with the recording (a stage). Raises ConfigError where they differ."""
        path, position = self._recording.path, self._recording.columns["position"]
        for row, sample in enumerate(samples):
            self._row = row
            if sample.state.t <= self._at + 1e-9 and (sample.state.position != position[row]).any():
                raise ConfigError(
                    f"{path} is not repeated by this program: it differs at {sample.state.t:.3f} s. Was it made by "
                    "another version, interrupted by hand, or driven by more than its config says? With --hand FILE a "
                    "model goes on from what a mirror knows"
                )
            yield sample
            if row + 1 == len(self._recording):
                return

    def beside(self) -> dict[str, Array]:
        own: dict[str, Array] = dict(self._trial.latest()) if self._trial is not None else {}
        own |= self._scene.poses() if self._scene is not None else {}
        names = {"target": "position", "target_object": "object"}
        was = {
            name: self._recording.columns[of][self._row] for name, of in names.items() if of in self._recording.columns
        }
        return own | was


def _run(rig: Rig, at: float, changes: Changes, other: Controller[Any] | None) -> Iterator[Sample]:
    """The control loop, with a change in the middle."""
    controller, backend = rig.controller, rig.backend
    state = backend.reset()
    memory, done = controller.start(state), False
    change = hand_change(changes, rig.spec)
    while True:
        if not done and state.t >= at - 1e-9:
            done = True
            for simulated in (rig.sim, rig.episode):
                if simulated is not None:
                    simulated.become(change, changes.get("friction"))
            if other is not None:
                controller, memory = hand_over(controller, memory, other, state)
        command, memory = controller(state, memory)
        backend.write(command)
        yield Sample(state, command)
        state = backend.read()
