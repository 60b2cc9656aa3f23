"""One run from start to end: the loop with the stages that were asked for around it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.references import STAY, goal_of
from allegro_twin.app.rig import Rig, limp_while
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.first_error import closing_noted
from allegro_twin.loop import paced, resume, to_the_end, until
from allegro_twin.plugins import BACKENDS, reference_of
from allegro_twin.sim.contact.collision_free_paths import CollisionFreeMove
from allegro_twin.spec.arm import ArmSpec
from allegro_twin.types import Array, HandState, Sample
from allegro_twin.version import __version__

if TYPE_CHECKING:
    from allegro_twin.grasping.verdict import TrialReport
    from allegro_twin.learning.environments.episode import EpisodeBackend, EpisodeScene
    from allegro_twin.spec.thermal import ThermalData
    from allegro_twin.viewing.camera import Scene
    from allegro_twin.viewing.overlays import Mark


_NOT_RENDERED = "only a simulation can be rendered; look at a recording with `allegro-twin view`"
REACHED = 0.03
"""rad. A joint that is further from where it was to go is not there, as of a motion of `Hand`. Dry friction alone keeps
the joints of a hand that closes its own loop up to 0.021 rad away (SIH, simulated)."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """Outputs of a run; None for what is not wanted."""

    record: Path | None = None
    image: Path | None = None
    video: Path | None = None
    rrd: Path | None = None
    live: str | None = None
    """`native` or `web`: a Rerun viewer while it runs, in real time."""
    wire_log: Path | None = None
    """Every frame of the hand's bus: .blf, .log or .asc."""
    size: tuple[int, int] = (480, 480)
    """Size of pictures and films: width and height, pixels."""
    camera: str = "auto"
    """From where, also to begin with in Rerun: a name or three numbers, as `viewing.views.view` takes them."""
    optional: bool = False
    """Pictures that cannot be made become a note; else the run is refused before the hand moves."""


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Outcome of a run."""

    last: HandState
    report: TrialReport | None
    notes: tuple[str, ...]
    """What was asked for and could not be had, and warnings."""
    motion: float = 0.0
    """How long the controller's motion takes, s; 0 where it has none of its own."""
    missed: str = ""
    """Which joints are not where the task was to bring them, and by how much; empty where they all are."""
    failed: bool = False
    """The episode has lost its object, or a posture's fingertips were its goal and are not there at its end."""
    unconfirmed: str = ""
    """Why it is not sure that the hand was left limp; empty when it is."""
    unwritten: str = ""
    """Which file could not be completed when the run had ended, and why; empty when all are."""


Advance = Callable[[float], None]
"""Told the hand's time after every sample, s."""
Tell = Callable[[str], None]
"""Told at once what a person needs to know while it runs."""


def perform(
    rig: Rig, config: RunConfig, outputs: Outputs, advance: Advance = lambda t: None, tell: Tell = lambda line: None
) -> RunOutcome:
    """Run until the rig's time is over or its backend ends. The hand is limp afterwards, whatever happens.

    Raises HandError; ConfigError for pictures that cannot be made, unless they are optional; RecordingError for a file
    that cannot be written while the hand moves.
    """
    if rig.trial is not None and rig.seconds is not None and rig.seconds < rig.trial.seconds - 1e-9:
        raise ConfigError(
            f"seconds {rig.seconds:g}: the trial takes {rig.trial.seconds:.1f} s, and without its end there is no "
            "verdict; leave `seconds` out, or run a config without a scenario"
        )
    notes: list[str] = list(rig.trial.warnings()) if rig.trial is not None else []
    if rig.trial is None and config.task.scenario is not None:
        notes.append("no verdict: only a simulation sees what becomes of the object")
    seen = any(wanted is not None for wanted in (outputs.record, outputs.rrd, outputs.live))
    outcome, beside, viewers, unwritten = None, _Beside(rig, seen=seen), list[Any](), ""
    try:
        # The hand is closed inside the log, which has its last words, and outside of one that cannot be made.
        with closing(rig.backend), _wire_logged(rig, config, outputs), closing(rig.backend), ExitStack() as stack:
            planner = rig.planner
            if planner is not None:
                stack.callback(planner.close)
            samples = to_the_end(_begun(rig))
            if planner is not None and planner.real_time and not rig.live and outputs.live is None:
                samples = paced(samples)  # Plans are made in a time that passes.
            samples = _until_over(samples, rig)
            if rig.seconds is not None:
                waits = config.seconds is None and _planned_move(rig) is not None
                samples = beside.until_rested(samples, rig.seconds) if waits else until(rig.seconds, samples)
            samples = beside.followed(samples)
            samples = _kept(samples, rig, config, outputs, beside)
            samples = _drawn(samples, rig, outputs, beside, stack, tell, viewers)
            samples, last = _photographed(samples, rig, outputs, notes, stack), None
            try:
                for sample in samples:
                    last = sample.state
                    advance(last.t)
            except RecordingError as error:
                if not beside.ended:
                    raise
                unwritten = str(error)
            assert last is not None  # The loop yields at least the state after reset.
            missed = _missed(rig, config, last, beside.motion)
            rig.backend.close()  # What follows takes its time, and nobody would drive the hand.
            report = rig.trial.report() if rig.trial is not None else None
            _concluded(viewers, report, rig.spec.thermal)
            notes += rig.trial.remarks() if rig.trial is not None and report is not None and report.held else []
            notes += rig.device.warnings()
            notes += [] if planner is None else [planner.report(last.t)]
            notes += [] if rig.episode is None else describe_episode(rig.episode)
            failed = rig.episode is not None and _failed(rig.episode)
            outcome = RunOutcome(last, report, tuple(notes), beside.motion, missed, failed, unwritten=unwritten)
    except RecordingError as error:
        if outcome is None:
            raise
        outcome = replace(outcome, unwritten=unwritten or str(error))
    return replace(outcome, unconfirmed=rig.device.unconfirmed)


def _begun(rig: Rig) -> Iterator[Sample]:
    """Reset the hand and drive it; one whose time passes by itself is limp until its path is planned."""
    state, move = rig.backend.reset(), _planned_move(rig)
    if move is not None:
        state, _ = limp_while(rig, state, move.prepare)
    yield from resume(rig.backend, rig.controller, state)


def _planned_move(rig: Rig) -> CollisionFreeMove | None:
    """What the controller follows, where its path is planned when it begins."""
    reference = reference_of(rig.controller)
    return reference if isinstance(reference, CollisionFreeMove) else None


def _until_over(samples: Iterator[Sample], rig: Rig) -> Iterator[Sample]:
    """Stop with the end of the episode that a simulated hand is in."""
    for sample in samples:
        yield sample
        if rig.episode is not None and rig.episode.over:
            return


def describe_episode(episode: EpisodeBackend) -> list[str]:
    """What became of an episode so far: how long it lasted, and what its task says of it."""
    task = episode.engine.task
    t = int(episode.engine.count[0]) * task.interface.seconds
    came = task.describe_outcome(episode.terms, episode.success) if episode.terms else ""
    lasted = f"lost at {t:.2f} s" if episode.lost else f"{t:.2f} s"
    return [f"{task.name}: {', '.join(filter(None, (lasted, came)))}"]


def _failed(episode: EpisodeBackend) -> bool:
    return episode.lost or (episode.wanted_goal is not None and not episode.success)


class _Beside:
    """Columns beside the samples: the controller's set-points, and what a trial or an episode observes.

    `seen`: whether somebody looks on.
    """

    def __init__(self, rig: Rig, *, seen: bool) -> None:
        self._rig, self._target = rig, np.empty(0)
        self._scene = None if rig.episode is None or not seen else scene_of_episode(rig.episode)
        self.look = _look(rig) if self._scene is None else {"look": self._scene.appearance}
        """What the metadata of a recording say of the looks of a scene."""
        self.motion = 0.0
        """How long the controller's motion takes, s."""
        self.began = 0.0
        """When that began, s on the hand's clock."""
        self.ended = False
        """Whether the hand has no further sample."""

    def followed(self, samples: Iterator[Sample]) -> Iterator[Sample]:
        """A stage that keeps up with the samples."""
        if self._rig.trial is not None:
            samples = self._rig.trial.watched(samples)
        reference = reference_of(self._rig.controller)
        path = None
        for sample in samples:
            state = sample.state
            if path is None and reference is not None:
                path, self.began = reference.begin(state.position), state.t
                self.motion = float(getattr(path, "seconds", 0.0))
            if path is not None:
                self._target = path(state.t - self.began).position
            yield sample
        self.ended = True

    def until_rested(self, samples: Iterator[Sample], seconds: float) -> Iterator[Sample]:
        """Stop so many s after the motion began, and not before it has ended and was seen to rest."""
        for sample in samples:
            yield sample
            if sample.state.t - self.began >= max(seconds, self.motion + STAY) - 1e-9:
                return

    def __call__(self) -> dict[str, Array]:
        found: dict[str, Array] = dict(self._rig.trial.latest()) if self._rig.trial is not None else {}
        found |= self._scene.poses() if self._scene is not None else {}
        return found | {"target": self._target} if self._target.size else found


def _missed(rig: Rig, config: RunConfig, last: HandState, motion: float) -> str:
    """Judged by where the joints truly are in a simulation, and by what any other hand reports."""
    goal = None if config.task.posture is None else goal_of(config, rig.spec)  # Without a task nothing was asked for.
    if goal is None or BACKENDS.kind(config.backend.kind).replays:  # In a recording others did what happened.
        return ""
    off = np.abs((last.position if rig.sim is None else rig.sim.true_position) - goal)
    far = [joint for joint in np.argsort(-off) if not off[joint] <= REACHED]
    if not far:
        return ""
    name = config.task.posture if isinstance(config.task.posture, str) else "the posture"
    joints = ", ".join(f"{rig.spec.joint_labels[joint]} {off[joint]:.2f}" for joint in far)
    early = f"; the motion takes {motion:.1f} s" if last.t < motion else ""
    return f"{name} is not reached at {last.t:.1f} s: rad short: {joints} (more than {REACHED:g}){early}"


def check_outputs(config: RunConfig, outputs: Outputs) -> None:
    """Raise ConfigError for outputs that the config's backend never has, before anything is computed."""
    replays = BACKENDS.kind(config.backend.kind).replays
    if outputs.wire_log is not None and (replays or config.backend.kind == "sim"):
        raise ConfigError(_no_frames(outputs.wire_log, config))
    if replays and (outputs.image is not None or outputs.video is not None):
        raise ConfigError(_NOT_RENDERED)


def _no_frames(path: Path, config: RunConfig) -> str:
    return f"{path}: only a hand on a CAN bus has frames to log, and a {config.backend.kind} hand has none"


@contextmanager
def _wire_logged(rig: Rig, config: RunConfig, outputs: Outputs) -> Iterator[None]:
    """Log the bus until the hand was closed within, so that its last words are in the log too."""
    path = outputs.wire_log
    if path is None:
        yield
        return
    logs: list[Callable[[Any], None]] = []

    def hear(frame: Any) -> None:
        for each in logs:
            each(frame)

    if not rig.device.listen(hear):
        raise ConfigError(_no_frames(path, config))
    from allegro_twin.drivers.can.tools.log import WireLog

    with closing_noted(WireLog(path, Path(getattr(config.backend, "channel", config.backend.kind)).name)) as log:
        logs.append(log)
        yield


def _kept(
    samples: Iterator[Sample], rig: Rig, config: RunConfig, outputs: Outputs, beside: _Beside
) -> Iterator[Sample]:
    if outputs.record is None:
        return samples
    from allegro_twin.recording.recorder import check_other_file, record

    if (recording := getattr(rig.backend, "recording", None)) is not None:
        check_other_file(outputs.record, recording.path)
    meta = recording_meta(rig, config) | beside.look
    return record(samples, outputs.record, rig.spec, rig.backend.period, meta=meta, extras=beside)


def recording_meta(rig: Rig, config: RunConfig) -> dict[str, Any]:
    """What a recording of a rig says beside its rows."""
    meta: dict[str, Any] = {"allegro_twin": __version__, "config": config.model_dump(mode="json")}
    if rig.sim is not None:
        meta |= rig.sim.meta()
    if rig.episode is not None:
        meta |= rig.episode.meta()
    if rig.trial is not None:
        meta |= rig.trial.meta()
    else:
        meta |= _look(rig)
    if rig.device.calibration:
        meta["calibration"] = dict(rig.device.calibration)
    return meta


def _drawn(
    samples: Iterator[Sample],
    rig: Rig,
    outputs: Outputs,
    beside: _Beside,
    stack: ExitStack,
    tell: Tell,
    viewers: list[Any],
) -> Iterator[Sample]:
    if outputs.rrd is None and outputs.live is None:
        return samples
    viewer_of, shown = rerun_stage()
    from allegro_twin.viewing.scenery import scenery

    scene = scenery(rig.spec, beside.look)
    if outputs.rrd is not None:
        viewer = stack.enter_context(viewer_of(rig.spec, scene, view=outputs.camera).recorded(outputs.rrd))
        viewers.append(viewer)
        samples = shown(samples, viewer, beside)
    if outputs.live is not None:
        viewer = viewer_of(rig.spec, scene, live=True, view=outputs.camera)
        viewers.append(viewer)
        stack.callback(viewer.close)
        if outputs.live == "web":
            tell(f"Open {viewer.serve()}")
        else:
            viewer.spawn()
        samples = shown(paced(samples), viewer, beside)
    return samples


def _concluded(viewers: list[Any], report: TrialReport | None, thermal: ThermalData | None) -> None:
    if viewers and report is not None:
        from allegro_twin.grasping.evaluation.rejudge import phase_results, report_markdown

        for viewer in viewers:
            viewer.conclude(phase_results(report), report_markdown(report, thermal))


def scene_of_episode(episode: EpisodeBackend) -> EpisodeScene:
    """The scene of an episode, as pictures and recordings show it."""
    from allegro_twin.learning.environments.episode import EpisodeScene

    return EpisodeScene(episode)


def _look(rig: Rig) -> dict[str, Any]:
    """What a recording says of the looks of a scene; nothing where our own hand is all there is."""
    if rig.trial is not None:
        return rig.trial.meta()
    if rig.sim is None or (rig.spec.foreign is None and not isinstance(rig.spec, ArmSpec)):
        return {}
    from allegro_twin.sim.model.appearance import scene_appearance

    return {"look": scene_appearance(rig.sim.model, rig.spec, ())}


def _photographed(
    samples: Iterator[Sample], rig: Rig, outputs: Outputs, notes: list[str], stack: ExitStack
) -> Iterator[Sample]:
    if outputs.image is None and outputs.video is None:
        return samples
    try:
        if rig.sim is None and rig.episode is None:
            raise ConfigError(_NOT_RENDERED)
        for name, wanted in (("PIL", outputs.image), ("av", outputs.video)):
            if wanted is not None:
                import_module(name)
        from allegro_twin.viewing.stills import photographed

        objects = [] if rig.trial is None else [rig.trial.objects[0].grasp_object.name]
        scene, marks = _scene_of(rig)
        return photographed(samples, scene, outputs.video, outputs.image, _moments(rig), outputs.size,
                            outputs.camera, stack, objects, marks)  # fmt: skip
    except (ImportError, ConfigError) as error:
        why = str(error) if isinstance(error, ConfigError) else f"{error}; pip install 'allegro-twin[view]'"
        if not outputs.optional:
            files = " and ".join(str(path) for path in (outputs.image, outputs.video) if path is not None)
            raise ConfigError(f"no picture {files}: {why}") from error
        notes.append(f"no pictures: {why}")
        return samples


def _scene_of(rig: Rig) -> tuple[Scene, Callable[[], Sequence[Mark]]]:
    """What is seen of a rig in this program, and what is marked there: the goal of an episode."""
    if rig.episode is None:
        assert rig.sim is not None
        return rig.sim, tuple
    from allegro_twin.viewing.batch import BatchScene

    engine = rig.episode.engine
    return BatchScene(engine.worlds, 0), lambda: engine.task.marks(0)


def _moments(rig: Rig) -> list[float]:
    """When a trial is worth a picture: the object pushed, the fingers closed, and the end of every check."""
    if rig.trial is None:
        return [] if rig.seconds is None else [rig.seconds]
    from allegro_twin.grasping.timeline import PUSHED

    protocol = rig.trial.protocol
    return [w.end for w in rig.trial.windows if w.check or w.name in (protocol.reference, PUSHED)]


def rerun_stage() -> tuple[Any, Any]:
    """The viewer and its stage. Raises ConfigError where Rerun is not installed."""
    try:
        from allegro_twin.viewing.rerun.viewer import Viewer, shown
    except ImportError as error:
        raise ConfigError(f"looking needs Rerun: pip install 'allegro-twin[view]' ({error})") from error
    return Viewer, shown
