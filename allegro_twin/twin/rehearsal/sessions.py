"""Sessions of a rehearsal with one hand: ends of joints, excitations, postures, a trajectory, grasps.

Every session opens the hand behind its guard and leaves it limp. Errors are of the true joints where a simulation knows
them, else of what the encoders say, corrected by the offsets that the ends of the joints have shown.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from allegro_twin.app.config import RunConfig
from allegro_twin.app.controller_settings import PositionSettings
from allegro_twin.app.rig import Physics, Rig, assemble
from allegro_twin.app.serve_can import checkup_of
from allegro_twin.app.session import recording_meta
from allegro_twin.app.simulated import following, simulated
from allegro_twin.backend import HandBackend
from allegro_twin.control.controllers import PD, PID
from allegro_twin.control.trajectory import Moves
from allegro_twin.controller import Controller
from allegro_twin.drivers.can.config import VIRTUAL, CanSettings
from allegro_twin.drivers.can.opening import hidden_truth
from allegro_twin.errors import ConfigError, LinkError, RecordingError
from allegro_twin.grasping.scenario import load_scenario, scenario_grasp, scenario_protocol
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.description.calibration import load_wiring
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.settings import TaskSettings
from allegro_twin.loop import resume, run, until
from allegro_twin.recording.recorder import record
from allegro_twin.sim.contact.collision_free_paths import CollisionFreeMove
from allegro_twin.sim.settings import SceneSettings
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.joint_ends import JointEnds, find_joint_ends
from allegro_twin.twin.identify.motions.excitation import ExcitationPose, find_pose
from allegro_twin.twin.identify.record_excitation import numbered_files, pose_config, record_run, remaining_run
from allegro_twin.twin.rehearsal.approach import approach_from
from allegro_twin.twin.rehearsal.measures import Following
from allegro_twin.twin.rehearsal.protocol import REST, rehearsal_trajectory
from allegro_twin.types import Sample, TorqueCommand, Vector

_log = logging.getLogger(__name__)

if TYPE_CHECKING:
    from allegro_twin.grasping.trial import Trial
    from allegro_twin.sim.engine.backend import SimBackend

Advance = Callable[[float], None]
"""Called with the hand's time after every sample, s."""
IDLE = 0.1
"""rad. A joint that moves less while it is led to both its ends has no power, or is stuck."""


class RehearsedTwin(NamedTuple):
    """Hand as its host believes it to be, and the error of its encoders then."""

    name: str
    serial: str
    """The hand's file; empty: none."""
    shift: Vector
    """To add to positions that are read with this file, (n,), rad."""


class RehearsedHand:
    """A hand that is rehearsed, by its config. Hidden hands override how it is opened and who knows the truth."""

    def __init__(self, config: RunConfig) -> None:
        if not isinstance(config.backend, CanSettings):
            raise ConfigError(f"a rehearsal is for a hand on a bus, real or virtual; this is a {config.backend.kind} "
                              "hand: try conf/can_virtual.yaml")  # fmt: skip
        self.config = config.model_copy(update={"task": TaskSettings(), "seconds": None})
        self._sim: SimBackend | None = None

    @property
    def settings(self) -> CanSettings:
        """The bus block of the config."""
        assert isinstance(self.config.backend, CanSettings)
        return self.config.backend

    @property
    def simulated(self) -> bool:
        """Whether its scene is simulated in this program: it is put into its poses, and grasps have objects."""
        return self.settings.interface == VIRTUAL

    def check_link(self) -> str:
        """Walk the link step by step at zero torque. Returns the last finding; raises what the first broken one
        raises."""
        found = None
        for found in checkup_of(self.config).walk():
            if found.broken is not None:
                raise found.broken("; ".join(filter(None, (f"{found.name}: {found.text}", found.remedy))))
        return "" if found is None else found.text

    def placed(self, pose: ExcitationPose) -> tuple[RunConfig, Physics | None]:
        """The config of the hand in a pose, and what stands behind it if it is virtual."""
        return self._as_made(pose_config(self.config, pose))

    def true_position(self) -> Vector | None:
        """Where the joints of the session's hand truly are, (n,), rad; None where nobody knows."""
        return None if self._sim is None else self._sim.true_position

    def trial(self, scenario: str, serial: str, film: Path | None = None) -> TrialReport:
        """A whole trial of a scenario with its grasp. `film`: where an .mp4 of it goes. Raises HandError."""
        settings, path = load_scenario(scenario)
        gains = scenario_protocol(settings, path).gains
        blocks = self.settings.model_dump(exclude_unset=True)
        if (scene := self.settings.scene) is not None:  # How it stands, and in which steps, is the scenario's.
            blocks["scene"] = {"kind": "sim", "truth": scene.truth}
        config = self.config.changed(task={"scenario": str(path)}, controller=following(self.config.hand, gains),
                                     backend=blocks)  # fmt: skip
        config, physics = self._as_made(config)
        return grasp_trial(config.changed(hand={"serial": serial}), physics, film)

    def _as_made(self, config: RunConfig) -> tuple[RunConfig, Physics | None]:
        """The config with a virtual hand that stays what it is by the rehearsal's own config, whatever the host then
        believes of it."""
        if not self.simulated:
            return config, None
        backend, hand = config.backend, config.hand
        assert isinstance(backend, CanSettings)
        scene, truth = backend.scene or SceneSettings(kind="sim"), hidden_truth(backend)
        spec = load_spec(hand.model, hand.side, hand.serial, backend.version, truth)
        wiring = load_wiring(hand.model, hand.serial, truth).calibration
        wire = {"encoder_offset": list(wiring.encoder_offset), "torque_constant": list(wiring.torque_constant)}

        def physics(believed: HandSpec, step: float) -> tuple[HandBackend, Trial | None]:
            made = simulated(scene, config.task, spec, step)
            self._sim = made.backend
            return made.backend, made.trial

        content = scene.model_dump(exclude_unset=True) | {"kind": "sim", "truth": {"wire": wire}}
        return config.changed(backend={"scene": content}), physics


def grasp_trial(config: RunConfig, physics: Physics | None, film: Path | None = None) -> TrialReport:
    """Perform the trial of a config's scenario, which is simulated here. `film`: where an .mp4 of it goes; where the
    disk is full there is none, which is logged: the verdict counts. Raises HandError, ConfigError where nothing can be
    rendered, or without PyAV."""
    rig = assemble(config, physics)
    with closing(rig.backend), ExitStack() as stack:
        trial = rig.trial
        if trial is None:
            raise ConfigError("only where its scene is simulated has a scenario a verdict")
        samples = trial.watched(until(trial.seconds, run(rig.backend, rig.controller)))
        if film is not None:
            from allegro_twin.viewing.camera import Camera
            from allegro_twin.viewing.films import check_av, filmed

            check_av()
            film.parent.mkdir(parents=True, exist_ok=True)
            samples = filmed(samples, stack.enter_context(closing(Camera(trial.backend, shadows=False))), film)
        try:
            for _ in samples:
                pass
        except RecordingError as error:  # The film's, at its end: nothing else is written here.
            _log.warning("%s", error)
        return trial.report()


def lead_to_ends(
    hand: RehearsedHand, pose_name: str, serial: str, file: Path | None = None, advance: Advance = lambda t: None
) -> JointEnds:
    """Lead every joint to both its ends, as `calibrate limits` does. Raises ConfigError naming joints that did not
    move, WrongPose, HandError."""
    pose = find_pose(pose_name, hand.config.hand.side)
    config, physics = hand.placed(pose)
    config = config.changed(hand={"serial": serial})
    watched = _in_pose(pose, _kept(config, file))
    found = find_joint_ends(config, lambda t, total: advance(t), physics=physics, watched=watched)
    span = found.limits.upper - found.limits.lower
    still = [found.model.joint_labels[k] for k in np.flatnonzero(~(span > IDLE))]
    if still:
        raise ConfigError(
            f"{', '.join(still)} did not move while led to both ends (less than {IDLE:g} rad): without power, or stuck"
        )
    return found


def excite_in_pose(
    hand: RehearsedHand, pose_name: str, seconds: float, seed: int, folder: Path, serial: str,
    advance: Advance = lambda t: None,
) -> list[Path]:  # fmt: skip
    """Record what is left of one pose's excitation, as `excite` does. Returns all recordings of the pose. Raises
    HandError."""
    pose = find_pose(pose_name, hand.config.hand.side)
    config, physics = hand.placed(pose)
    config = config.changed(hand={"serial": serial})
    folder.mkdir(parents=True, exist_ok=True)
    job = remaining_run(config, pose_name, seconds, seed, folder)
    if job is not None:
        record_run(config, job, advance, physics)
    return list(numbered_files(pose_name, folder).values())


def hold_posture(
    hand: RehearsedHand, pose_name: str, twin: RehearsedTwin, posture: str, kind: str, file: Path | None = None,
    advance: Advance = lambda t: None,
) -> Following:  # fmt: skip
    """Go to a posture of the library and stay there for REST s. Raises HandError."""
    pose = find_pose(pose_name, hand.config.hand.side)
    return _follow(hand, pose, twin, {"posture": posture}, {"kind": kind}, None, REST, file, advance)


def follow_trajectory(
    hand: RehearsedHand, pose_name: str, twin: RehearsedTwin, speed: float, kind: str, file: Path | None = None,
    advance: Advance = lambda t: None, *, feedforward: bool = False,
) -> Following:  # fmt: skip
    """Perform the rehearsal's trajectory at a peak speed, rad/s. `feedforward`: with inverse dynamics. Raises
    HandError."""
    pose, law = find_pose(pose_name, hand.config.hand.side), {"kind": kind, "inverse_dynamics": feedforward}
    return _follow(hand, pose, twin, {}, law, lambda spec: rehearsal_trajectory(spec, speed), 0.0, file, advance)


def close_in_air(
    hand: RehearsedHand, pose_name: str, twin: RehearsedTwin, scenario: str, kind: str, file: Path | None = None,
    advance: Advance = lambda t: None,
) -> Following:  # fmt: skip
    """Pre-shape and close a scenario's grasp without its object, and do not squeeze. Raises HandError."""
    settings, path = load_scenario(scenario)

    def closing_moves(spec: HandSpec) -> Moves:
        grasp = scenario_grasp(settings, path, spec)
        return Moves([grasp.waypoint("preshape"), grasp.waypoint("close")])

    pose = find_pose(pose_name, hand.config.hand.side)
    return _follow(hand, pose, twin, {}, {"kind": kind}, closing_moves, REST, file, advance)


def _follow(
    hand: RehearsedHand, pose: ExcitationPose, twin: RehearsedTwin, task: Mapping[str, Any], law: Mapping[str, Any],
    moves: Callable[[HandSpec], Moves] | None, rest: float, file: Path | None, advance: Advance,
) -> Following:  # fmt: skip
    """Follow what a task asks for, or moves in its place, and stay for `rest` s. `law`: what the rehearsal says of the
    controller, whatever the config has."""
    own = hand.config.controller
    control = own.model_dump(exclude_unset=True) if isinstance(own, PositionSettings) else {}
    config, physics = hand.placed(pose)
    config = config.changed(hand={"serial": twin.serial}, task=dict(task), controller=control | dict(law))
    rig = assemble(config, physics)
    with closing(rig.backend):
        controller, seconds = rig.controller, rig.seconds
        assert isinstance(controller, PD | PID)
        if moves is not None:
            controller, seconds = replace(controller, reference=moves(rig.spec)), None
        state = rig.backend.reset()
        pose.check(state.gravity)
        assert isinstance(controller.reference, Moves | CollisionFreeMove)
        first, *others = controller.reference.waypoints
        state, legs = approach_from(rig, state, first, twin.shift, str(task.get("posture", "the first posture")))
        controller = replace(controller, reference=Moves([*legs, *others], rig.check_speed))
        path: Any = controller.reference.begin(state.position)
        began, rows = state.t, list[tuple[Any, ...]]()
        end = began + max(path.seconds, seconds or 0.0) + rest
        driven: Controller[Any] = controller
        for sample in _kept(config, file)(until(end, resume(rig.backend, driven, state)), rig):
            state, true = sample.state, hand.true_position()
            true = None if true is None else true.copy()
            command = sample.command
            assert isinstance(command, TorqueCommand)
            rows.append((state.t, *path(state.t - began), state.position + twin.shift, true, command.torque))
            advance(state.t)
    if rig.device.unconfirmed:
        raise LinkError(rig.device.unconfirmed)
    t, target, rate, position, truth, torque = zip(*rows, strict=True)
    known = None if truth[0] is None else np.array(truth)
    begins = np.array([0.0, *path.times[len(legs) :]]) + began  # One approach, in however many legs.
    return Following(
        rig.spec, np.array(t), np.array(target), np.array(rate), np.array(position), known, begins, np.array(torque)
    )


Stage = Callable[[Iterator[Sample], Rig], Iterator[Sample]]


def _in_pose(pose: ExcitationPose, then: Stage) -> Stage:
    """A stage that raises WrongPose at the first sample of a hand that lies otherwise."""

    def checked(samples: Iterator[Sample]) -> Iterator[Sample]:
        for number, sample in enumerate(samples):
            if number == 0:
                pose.check(sample.state.gravity)
            yield sample

    return lambda samples, rig: then(checked(samples), rig)


def _kept(config: RunConfig, file: Path | None) -> Stage:
    """A stage that records a session, where it is to be recorded."""

    def stage(samples: Iterator[Sample], rig: Rig) -> Iterator[Sample]:
        if file is None:
            return samples
        return record(samples, file, rig.spec, config.period, meta=recording_meta(rig, config))

    return stage
