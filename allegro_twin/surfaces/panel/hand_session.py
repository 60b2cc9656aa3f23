"""A hand as a session of the panel: it carries out requests, and sends frames from the hand's own loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.app import Rig, assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.app.controller_settings import PlanningSettings, PositionSettings
from allegro_twin.control.demonstration import TaughtMotion
from allegro_twin.errors import ConfigError, HandError, RecordingError
from allegro_twin.files.atomic_write import write_error
from allegro_twin.files.first_error import closing_noted
from allegro_twin.hands.library.entries import posture_entry, trajectory_entry
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import Library, found_later
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.hand.demonstration import Demonstration
from allegro_twin.surfaces.hand.live_control import OWN
from allegro_twin.surfaces.hand.motion import FirstController
from allegro_twin.surfaces.panel import requests
from allegro_twin.surfaces.panel.description import describe_hand, library_contents, scene_of
from allegro_twin.surfaces.panel.episode_watch import HOLD, EpisodeWatch
from allegro_twin.surfaces.panel.host import Opener, Send
from allegro_twin.surfaces.panel.stream import (
    RATE,
    LibraryContents,
    Notice,
    SessionEnded,
    SessionInfo,
    StreamFrame,
)
from allegro_twin.types import Array, Sample

if TYPE_CHECKING:
    from allegro_twin.recording.recorder import Recorder

_WHILE_TEACHING = (
    requests.MoveJoints, requests.MoveToPosture, requests.PerformGrasp, requests.PlayTaught, requests.ChooseController,
)  # fmt: skip
"""Requests that end a demonstration."""
_DRIVES = (*_WHILE_TEACHING, requests.HoldHere, requests.SetGravity, requests.Teach)
"""Requests after which the hand does not do what its scenario asks; so do a stop and a driver who leaves."""


@dataclass(frozen=True, slots=True)
class Folders:
    """Files that the panel writes."""

    recordings: Path = Path("out")
    library: Path = Path("library/taught.yaml")
    """The user's library, for demonstrations."""


class HandSessions:
    """Opens the hand of a config, and opens it again in other scenes."""

    def __init__(self, config: RunConfig, folders: Folders) -> None:
        self._own, self._config, self._folders = config, config, folders
        self._last: HandSession | None = None

    def prepare(self, request: requests.OpenScene | requests.Reopen | None) -> Opener:
        """Raises ConfigError."""
        config, perform = self._config, False
        if isinstance(request, requests.OpenScene):
            config, perform = scene_of(self._own, request), request.perform
        controller = config.controller
        if isinstance(controller, PlanningSettings) and controller.time == "lockstep":
            raise ConfigError("controller.time lockstep: a hand in the panel waits for no plan, nor does its stop; "
                              "choose controller.time: real")  # fmt: skip

        def start(number: int, send: Send) -> HandSession:
            shown = None if self._last is None else self._last.demonstration
            session = HandSession(number, config, self._folders, send, perform=perform, shown=shown)
            self._config, self._last = config, session
            return session

        return start


class HandSession:
    """A hand that a config describes, limp, with its time passing; in an episode holding, with the set-points of its
    beginning. `perform`: doing what the config is for; else its wrist stays where its scene begins. `shown`: the
    demonstration of the session before, which can be played and stored here. Raises HandError."""

    def __init__(
        self,
        number: int,
        config: RunConfig,
        folders: Folders,
        send: Send,
        *,
        perform: bool = False,
        shown: Demonstration | None = None,
    ) -> None:
        self._number, self._config, self._folders, self._send = number, config, folders, send
        self._next, self._lost, self._tick = 0.0, 0, -1
        self._recorder: Recorder | None = None
        self._recording = Path()
        self._recorded_from, self._teaching, self._trouble, self._verdict_due = 0.0, False, "", False
        self._stalled: HandError | None = None
        self._clipped, self._interfered, self._cut_short = 0, False, False
        with ExitStack() as opened:
            self.rig = assemble(config)
            opened.callback(self.rig.backend.close)
            episode, trial, controller = self.rig.episode, self.rig.trial, config.controller
            self.watch = None if episode is None else EpisodeWatch(self.rig, episode)
            self._look = scene_observer(self.rig) if self.watch is None else self.watch.look
            self._judged = trial if perform else None
            if trial is not None and not perform:
                trial.backend.drive = trial.backend.drive[:1]
            self._gains = controller.gains if isinstance(controller, PositionSettings) else "default"
            gains, first = load_gains(self._gains, self.rig.spec), None
            opened.callback(self._abandon_recording)
            if self.watch is not None:
                opened.callback(self.watch.close)
                first = FirstController(HOLD, self.watch.first())
                if perform:
                    self.watch.perform()
                    first = FirstController(OWN, self.rig.controller)
            self.hand = opened.enter_context(closing_noted(Hand(self.rig, gains, background=True, first=first)))
            self._demonstrating, self._demonstration = ExitStack(), shown or Demonstration(self.hand.spec)
            if self.watch is not None:
                self.hand.gravity = self.watch.gravity
            elif perform:
                self.hand.direct.perform()
            self.hand.listen(self._on_sample)
            self.hand.direct.prepare()
            self._opened = opened.pop_all()

    @property
    def demonstration(self) -> Demonstration:
        """The last one."""
        return self._demonstration

    def describe(self) -> SessionInfo:
        """Raises ConfigError."""
        return describe_hand(self._number, self.rig, self._config, self.hand.controllers, self.watch)

    def library(self) -> LibraryContents:
        """Raises ConfigError."""
        return library_contents(self.hand.spec)

    def execute(self, request: requests.Request) -> str:
        """Carry out a request: one call of the facade. A sentence for the person, or nothing. Raises HandError, and the
        hand goes on with what it did."""
        hand = self.hand
        self._interfered |= self._judged is not None and isinstance(request, _DRIVES)
        if self._teaching and isinstance(request, _WHILE_TEACHING):
            self._teach(False)
        match request:
            case requests.MoveJoints(position):
                hand.direct.steer(self._whole(position))
            case requests.MoveToPosture(name):
                hand.move_to(name, hand.direct.usual_speed(1.0), wait=False)
            case requests.PerformGrasp(name):
                hand.grasp(name, wait=False)
            case requests.ChooseController(kind):
                hand.set_controller(next((k for k in hand.controllers if k == kind), kind))  # type: ignore[arg-type]  # Checked there.
            case requests.SetGravity(vector):
                hand.gravity = self.watch.gravity if vector is None and self.watch is not None else vector
            case requests.ChooseGains(name):
                hand.direct.use_gains(name)
                self._gains = name
                return f"gains {name} from the next request on"
            case requests.HoldHere():
                self._hold()
            case requests.StopMotion():
                self.stop()
                shown, self._cut_short = self._cut_short, False
                return "the demonstration has ended here: repeat it, or store it" if shown else ""
            case requests.ReleaseStop():
                hand.direct.release()
                return "the stop is released; the hand is limp until the next request"
            case requests.DriverLeft():
                self.stay()
            case requests.DragObject():
                self._drag(request)
            case requests.DropObject():
                self._drop()
            case requests.TurnGoal(quaternion):
                self._episode().turn(quaternion)
            case requests.PerformEpisode():
                return self._perform()
            case requests.Teach(on):
                return self._teach(on)
            case requests.PlayTaught():
                hand.play(self._motion(), approach=hand.direct.usual_speed(1.0), wait=False)
            case requests.StoreTaught(name, motion, replace):
                return self._store(name, motion=motion, replace=replace)
            case requests.Record(on):
                return self._record(on)
            case _:
                raise ConfigError(f"a hand cannot carry out {type(request).__name__}")
        return ""

    def stop(self) -> None:
        """No torque from the next period on, and no force of the mouse; a demonstration ends here, before the hand
        sags."""
        self._demonstration.end()
        self._cut_short |= self._teaching
        self._teaching = False
        self._interfered |= self._judged is not None
        self._drop()
        self.hand.direct.limp()

    def stay(self) -> None:
        """End a motion where the hand is, and the force of the mouse."""
        self._interfered |= self._judged is not None
        self._drop()
        with suppress(HandError):  # The loop has ended, and the hand is limp; `report` tells.
            if self.watch is not None and self.hand.controller == OWN:
                self._hold()
            elif self.hand.controller != HOLD:
                self.hand.direct.stay()

    def report(self) -> Iterator[Notice | SessionEnded]:
        """What is new: a stall, a clipped request, a verdict, trouble with a recording, and the end of the hand."""
        hand = self.hand
        stalled, before, self._stalled = hand.stalled, self._stalled, hand.stalled
        if stalled is not None and stalled is not before:
            yield Notice(str(stalled), bad=True)
        if hand.clipped != self._clipped:
            self._clipped = hand.clipped
            yield Notice(f"{self._clipped} requests a little beyond a limit were clipped to it")
        if self._trouble:
            text, self._trouble = self._trouble, ""
            yield Notice(text, bad=True)
        if self._verdict_due and self.rig.trial is not None:
            self._verdict_due = False
            verdict = self.rig.trial.report()
            text = "held" if verdict.held else f"not held: {verdict.reason}"
            pulled = self._pulled()
            others = [f"the mouse pulled an object with up to {pulled:.1f} N"] if pulled > 0.0 else []
            others += ["the hand was driven from the page"] if self._interfered else []
            if others:
                text += f"; but {' and '.join(others)}: no verdict on the scenario"
            yield Notice(f"the verdict: {text}", bad=not verdict.held or bool(others))
        if self.watch is not None and (sentence := self.watch.ended()):
            yield SessionEnded(sentence)
            return
        try:
            _ = hand.state
        except HandError as error:
            yield SessionEnded(str(error))

    def close(self) -> str:
        """Leave the hand limp and let go of it. Returns which recording and demonstration that has ended. Raises
        LinkError when the hand did not confirm that."""
        self._drop()
        self._demonstration.end()
        recorded = self._recorder is not None
        self._opened.close()
        ended = []
        if recorded:
            ended += [f"the recording {self._recording} has ended with this hand: {self._trouble or 'it is whole'}"]
        if self._teaching:
            ended += ["the demonstration has ended with this hand: what was shown can be stored"]
        return "; ".join(ended)

    def _episode(self) -> EpisodeWatch:
        """Raises ConfigError where there is none."""
        if self.watch is None:
            raise ConfigError("this hand is in no episode: name one in the config, task: {episode: {task: Reorient}}")
        return self.watch

    def _perform(self) -> str:
        watch = self._episode()
        if self.hand.controller == OWN:
            return f"{watch.name} is being performed"
        self.hand.direct.perform()
        watch.perform()
        return ""

    def _whole(self, position: Sequence[float | None]) -> Sequence[float]:
        """A posture with the goals that joints have already where none is given."""
        goal = np.clip(self.hand.direct.goal, self.hand.spec.lower, self.hand.spec.upper).tolist()
        return [goal[joint] if asked is None else asked for joint, asked in enumerate(position)]

    def _hold(self) -> None:
        """Stay here; in an episode with the torques of now, or the fingertips would let go of the object."""
        if self.watch is None:
            self.hand.stop()
        else:
            self.hand.direct.drive(HOLD, self.watch.hold())

    def _drag(self, request: requests.DragObject) -> None:
        rig = self.rig
        if rig.sim is None or rig.trial is None:
            raise ConfigError("there is no simulated object to pull with the mouse")
        if self.hand.direct.stopped:
            raise ConfigError("nothing is pulled until the stop is released")
        objects, point, target = rig.trial.objects, np.array(request.point), np.array(request.target)
        if not 0 <= request.number < len(objects) or not np.isfinite([point, target]).all():
            raise ConfigError(f"there is no object {request.number} at such a place")
        rig.sim.drag(objects[request.number].grasp_object.name, point, target)

    def _drop(self) -> None:
        if self.rig.sim is not None:
            self.rig.sim.let_go()

    def _pulled(self) -> float:
        """The largest force of the mouse since the trial began, N."""
        return 0.0 if self.rig.sim is None else self.rig.sim.mouse.largest

    def _teach(self, on: bool) -> str:
        self._teaching = False
        self._demonstrating.close()
        if not on:
            return "shown: repeat it, or store it"
        self._demonstration = self._demonstrating.enter_context(self.hand.teach())
        self._teaching = True
        return "lead the fingers now"

    def _motion(self) -> TaughtMotion:
        if self._teaching:
            self._teach(False)
        return self._shown().motion()

    def _shown(self) -> Demonstration:
        """What somebody has shown, of this session or one before. Raises ConfigError where there is nothing."""
        if self._demonstration.empty:
            raise ConfigError("nothing was shown: press Teach and lead the fingers")
        return self._demonstration

    def _store(self, name: str, *, motion: bool, replace: bool) -> str:
        library, spec, target = Library(), self.hand.spec, self._folders.library
        old = library.check_store(name, target, spec)
        if old is not None and not replace:
            raise ConfigError(f"{name!r} is a {old.kind} in {target} already: tick Replace, or choose another name")
        if motion:
            taught = self._motion()
            library.add(name, trajectory_entry(taught.times, taught.positions, spec), spec)
        else:
            library.add(name, posture_entry(self._shown().posture(), spec), spec)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise write_error(target, error) from error
        library.store(name, target)
        notes = (self._demonstration.clipped(motion=motion), found_later(target))
        return "; ".join((f"{name} is in {target}", *filter(None, notes)))

    def _record(self, on: bool) -> str:
        recorded = self._recorder is not None
        self._stop_recording()
        if not on:
            return "the recording is whole" if recorded else "nothing is being recorded"
        from allegro_twin.app.session import recording_meta
        from allegro_twin.recording.recorder import Recorder

        path, rig = free_name(self._folders.recordings), self.rig
        self._recording = path
        self._recorded_from = self.hand.state.t
        look = {} if self.watch is None else {"look": self.watch.appearance}
        self._recorder = Recorder(path, rig.spec, rig.backend.period, recording_meta(rig, self._config) | look)
        return f"recording to {path}"

    def _stop_recording(self) -> None:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close()

    def _abandon_recording(self) -> None:
        try:
            self._stop_recording()
        except RecordingError as error:  # What was written is readable.
            self._trouble = self._trouble or str(error)

    def _on_sample(self, sample: Sample) -> None:
        """In the loop's own thread: as little as can be, and nothing that waits."""
        state = sample.state
        self._lost += 0 if self._tick < 0 else state.tick - self._tick - 1
        self._tick = state.tick
        if self.watch is not None:
            self.watch.see(sample)
        if self._judged is not None:
            self._judged.see(state)
            if state.t >= self._judged.seconds:
                self._judged, self._verdict_due = None, True
        if (recorder := self._recorder) is not None:
            look = {name: value for name, value in self._look().items() if value.ndim == 1 and name != "episode"}
            try:
                recorder.add(sample, {**look, "target": self.hand.direct.target, **self._mouse_column()})
            except RecordingError as error:
                self._trouble = str(error)
                self._abandon_recording()
        if state.t >= self._next:
            self._next = state.t + 1.0 / RATE - self.rig.backend.period / 2
            self._send(self._frame(sample))

    def _mouse_column(self) -> Mapping[str, Array]:
        """The force of the mouse as a recording has it, where there are objects."""
        if self.rig.sim is None or self.rig.trial is None:
            return {}
        now = self.rig.sim.mouse.now
        return {"mouse_force": np.zeros(3) if now is None else now[2]}

    def _dragged(self) -> Mapping[str, Array]:
        """The force of the mouse as the page shows it, while it acts."""
        rig = self.rig
        now = None if rig.sim is None else rig.sim.mouse.now
        if now is None or rig.sim is None or rig.trial is None:
            return {}
        drag, point, force = now
        name = rig.sim.model.body(drag.body).name
        number = [placed.grasp_object.name for placed in rig.trial.objects].index(name)
        return {"drag": np.concatenate([[number], point, drag.target, force])}

    def _given_gravity(self) -> tuple[float, float, float] | None:
        given = self.hand.direct.given_gravity
        if given is None or (self.watch is not None and np.array_equal(given, self.watch.gravity)):
            return None  # An episode's palm reports none, and its scene tells it.
        x, y, z = given.tolist()
        return x, y, z

    def _frame(self, sample: Sample) -> StreamFrame:
        state, direct, look = sample.state, self.hand.direct, {**self._look(), **self._dragged()}
        return StreamFrame(
            self._number, state.t, state.position, state.torque, state.temperature, direct.target, look,
            self.hand.controller, direct.stopped, self._lost, tuple(self.rig.device.warnings()),
            state.t - self._recorded_from if self._recorder is not None else -1.0, self._teaching, goal=direct.goal,
            gains=self._gains, gravity=self._given_gravity(),
        )  # fmt: skip


def scene_observer(rig: Rig) -> Callable[[], Mapping[str, Array]]:
    """What is known of a hand's surroundings, by the simulation, a recording, or nothing; for the thread that turns the
    loop, between two periods."""
    if rig.sim is None:
        extras = getattr(rig.backend, "extras", None)
        return dict if extras is None else extras
    model, data = rig.sim.model, rig.sim.data
    palm = model.body("palm_link").id
    if rig.trial is None:
        return lambda: {"palm": np.concatenate([data.xpos[palm], data.xquat[palm]])}
    from allegro_twin.sim.contact.probe import ObjectProbe

    first, *rest = [placed.grasp_object.name for placed in rig.trial.objects]
    probe, others = ObjectProbe(model, data, rig.spec, first), [model.body(name).id for name in rest]
    return lambda: probe() | {"others": np.hstack([data.xpos[others], data.xquat[others]])}


def free_name(folder: Path) -> Path:
    """A recording's name that is not taken."""
    count = 1
    while (path := folder / f"panel_{count:03d}.arrow").exists():
        count += 1
    return path
