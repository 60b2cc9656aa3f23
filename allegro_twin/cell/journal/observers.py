"""Observers of a cell: recordings, viewers, ROS and pages get the same events, in plain data."""

from __future__ import annotations

import pathlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import Protocol

import numpy as np

from allegro_twin.cell.actions.cell_actions import CellActions
from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.camera.camera import CameraFrame, DepthCamera
from allegro_twin.cell.journal.rows import perception_entry, picture_entry, state_entry
from allegro_twin.cell.motion.arm_motion import ArmGuide
from allegro_twin.cell.perception.errors import PerceptionRefusal
from allegro_twin.cell.perception.pipeline import Detection
from allegro_twin.cell.run import SampleStage
from allegro_twin.cell.states import MachineState
from allegro_twin.control.trajectory import Path
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.kinematics.pose import Pose, compose
from allegro_twin.recording.events import DeviceSample, JournalEntry, SessionEvent
from allegro_twin.types import Array, Sample, Vector
from allegro_twin.viewing.camera import Camera
from allegro_twin.viewing.films import check_av, film_samples, open_film
from allegro_twin.viewing.stills import save_png
from allegro_twin.viewing.views import View


class ObserverCamera:
    """Pictures with colour at a rate, Hz. Raises ConfigError where nothing can be rendered, or for no rate."""

    def __init__(self, cell: Cell, rate: float) -> None:
        if not 0.0 < rate <= 30.0:
            raise ConfigError(f"pictures are taken at more than 0 and at most 30 Hz, not {rate:g}")
        settings, world = cell.settings, cell.robot.world
        self._data, self._rate, self._count = world.data, rate, 0
        self._camera = DepthCamera(world.model, settings.camera.model_copy(update={"colour": True}), settings.seed)

    def due(self, t: float) -> CameraFrame | None:
        """A picture of now, s, where one is due."""
        if t < self._count / self._rate - 1e-9:
            return None
        self._count = int(t * self._rate + 1e-6) + 1
        return self._camera.capture(self._data)

    def close(self) -> None:
        """Idempotent."""
        self._camera.close()


PICTURES = {"ToTargetPose": "before", "ToLiftedPose": "grasp", "Done": "end"}
"""What is taken when a state begins, by the name of the file."""
RECORDING = "lab.arrow"
"""Name of the recording that `SessionRecorder` writes beside them."""
_VIEW = View(azimuth=125.0, elevation=-25.0, distance=1.35)
_SIZE, _FPS = (640, 480), 20


class StatePictures:
    """An onlooker that writes them into a folder. Raises ConfigError where nothing can be rendered."""

    def __init__(self, cell: Cell, folder: pathlib.Path) -> None:
        self._folder = folder
        self._camera = Camera(cell.robot.hand_sim, width=_SIZE[0], height=_SIZE[1], view=_VIEW)

    def on_event(self, event: SessionEvent) -> None:
        """Take a picture where a state begins."""
        if isinstance(event, JournalEntry) and event.track == "states":
            name = PICTURES.get(event.row["state"])
            if name is not None:
                save_png(self._camera.take(), self._folder / f"{name}.png")

    def close(self) -> None:
        """Let go of the pictures' screen."""
        self._camera.close()


@contextmanager
def film_stage(cell: Cell, path: pathlib.Path, stage: SampleStage) -> Iterator[SampleStage]:
    """A stage of the hand that also makes a film of the cell, as `viewing.films.open_film` does. Raises ConfigError
    where nothing can be rendered, or without PyAV, and RecordingError at the end of the block."""
    check_av()
    camera = Camera(cell.robot.hand_sim, width=_SIZE[0], height=_SIZE[1], view=_VIEW)
    with closing(camera), open_film(path, _FPS) as add:
        yield lambda samples: film_samples(stage(samples), camera, add, _FPS)


class Observer(Protocol):
    """Somebody who looks on."""

    def on_event(self, event: SessionEvent) -> None:
        """In the loop: as little as possible. Raises HandError, which ends the run, but for RecordingError: the run
        goes on without this observer."""
        ...


class Observers:
    """Callbacks for `perform`, so that all observers see it. `lens`: takes their pictures; None: there are none."""

    unwritten: RecordingError | None = None
    """Why an observer cannot go on writing: a disk that is full stops no arm. To be raised when the run has ended."""

    def __init__(self, cell: Cell, each: Sequence[Observer], lens: ObserverCamera | None = None) -> None:
        self._cell, self._each, self._lens = cell, list(each), lens
        self._beside_hand = hand_extras(cell)
        self._work: CellActions | None = None
        self._guide: ArmGuide | None = None
        self._fingers: Path | None = None

    def on_prepare(self, work: CellActions) -> None:
        """A run begins."""
        self._work, work.on_detection = work, self.on_detection
        self._guide, self._fingers = work.guide, work.fingers

    def on_remote_control(self, guide: ArmGuide, fingers: Path) -> None:
        """The cell is led from outside from now on: where its arm and its fingers are to be."""
        self._guide, self._fingers = guide, fingers
        self._tell(JournalEntry("states", {"t": 0.0, "state": "Following", "tries": 1}))

    def on_refusal(self, t: float, sentence: str) -> None:
        """Something that was wished was not done."""
        row = {"t": t, "state": "Following", "tries": 1, "reason": "refused", "sentence": sentence}
        self._tell(JournalEntry("states", row))

    def on_state(self, now: MachineState) -> None:
        """A state begins."""
        assert self._work is not None
        self._tell(JournalEntry("states", state_entry(now, self._work)))

    def on_detection(self, frame: CameraFrame, detection: Detection | PerceptionRefusal) -> None:
        """Perception has looked at a picture."""
        self._tell(JournalEntry("perception", perception_entry(frame, detection, self._cell.settings.perception)))

    def arm(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """The stage of the arm."""
        for sample in samples:
            assert self._guide is not None
            self._tell(DeviceSample("arm", sample, arm_extras(self._cell, self._guide.target.pose, sample)))
            picture = None if self._lens is None else self._lens.due(sample.state.t)
            if picture is not None:
                self._tell(JournalEntry("pictures", picture_entry(picture)))
            yield sample

    def hand(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """The stage of the hand."""
        for sample in samples:
            assert self._fingers is not None
            target = self._fingers(sample.state.t).position
            self._tell(DeviceSample("hand", sample, {**self._beside_hand(), "target": target}))
            yield sample

    def _tell(self, event: SessionEvent) -> None:
        for each in tuple(self._each):
            try:
                each.on_event(event)
            except RecordingError as error:
                self._each.remove(each)
                self.unwritten = self.unwritten or error


def arm_extras(cell: Cell, target: Pose, sample: Sample) -> dict[str, Array]:
    """What is known beside an arm's sample: `flange` and `tool`, the palm, by the encoders, and `goal`, where the
    flange is to go, (7,) each in the world; `force`, what the world does to the hand, (6,). `target`: in the base."""
    robot, state = cell.robot, sample.state
    poses = {"flange": robot.flange(state), "tool": robot.palm(state), "goal": compose(robot.base, target)}
    found = {name: np.concatenate([pose.position, pose.quaternion]) for name, pose in poses.items()}
    return found | {"force": robot.wrench(state)}


def hand_extras(cell: Cell) -> Callable[[], Mapping[str, Vector]]:
    """What only a simulation knows: `palm`, `object`, the first thing, (7,) each in the world, and `others`, of the
    rest in a row."""
    model, data = cell.robot.world.model, cell.robot.world.data
    first, *rest = (model.body(each.name).id for each in cell.settings.objects)
    palm = model.body(cell.hand.spec.root).id

    def pose(body: int) -> Vector:
        return np.concatenate([data.xpos[body], data.xquat[body]])

    def look() -> Mapping[str, Vector]:
        others = {"others": np.concatenate([pose(body) for body in rest])} if rest else {}
        return {"palm": pose(palm), "object": pose(first), **others}

    return look
