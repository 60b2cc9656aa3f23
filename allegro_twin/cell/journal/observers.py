"""Who looks on while the cell works: a recording, a viewer, ROS. Each hears of the same happenings, in plain data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Protocol

import numpy as np

from allegro_twin.cell.actions import Work
from allegro_twin.cell.assembly import Room
from allegro_twin.cell.camera.frame import Frame
from allegro_twin.cell.journal.rows import event, perceived, pictured
from allegro_twin.cell.journal.second_camera import Lens
from allegro_twin.cell.motion.arm_motion import Guide
from allegro_twin.cell.perception.errors import Refused
from allegro_twin.cell.perception.pipeline import Found
from allegro_twin.cell.states import Now
from allegro_twin.control.trajectory import Path
from allegro_twin.kinematics.pose import Pose, compose
from allegro_twin.recording.events import DeviceSample, JournalEntry, SessionEvent
from allegro_twin.types import Array, Sample, Vector


class Onlooker(Protocol):
    """Somebody who looks on."""

    def on_event(self, event: SessionEvent) -> None:
        """In the loop: as little as possible. Raises HandError, which ends the run."""
        ...


class Onlookers:
    """What `perform` is to call so that all of them see it. `lens`: takes their pictures; None: there are none."""

    def __init__(self, room: Room, each: Sequence[Onlooker], lens: Lens | None = None) -> None:
        self._room, self._each, self._lens = room, each, lens
        self._beside_hand = beside_hand(room)
        self._work: Work | None = None
        self._guide: Guide | None = None
        self._fingers: Path | None = None

    def prepared(self, work: Work) -> None:
        """A run begins."""
        self._work, work.looked = work, self.looked
        self._guide, self._fingers = work.guide, work.fingers

    def follows(self, guide: Guide, fingers: Path) -> None:
        """The cell is led from outside from now on: where its arm and its fingers are to be."""
        self._guide, self._fingers = guide, fingers
        self._tell(JournalEntry("states", {"t": 0.0, "state": "Following", "tries": 1}))

    def refused(self, t: float, sentence: str) -> None:
        """Something that was wished was not done."""
        row = {"t": t, "state": "Following", "tries": 1, "reason": "refused", "sentence": sentence}
        self._tell(JournalEntry("states", row))

    def entered(self, now: Now) -> None:
        """A state begins."""
        assert self._work is not None
        self._tell(JournalEntry("states", event(now, self._work)))

    def looked(self, frame: Frame, seen: Found | Refused) -> None:
        """Perception has looked at a picture."""
        self._tell(JournalEntry("perception", perceived(frame, seen, self._room.settings.perception)))

    def arm(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """The stage of the arm."""
        for sample in samples:
            assert self._guide is not None
            self._tell(DeviceSample("arm", sample, beside_arm(self._room, self._guide.target.pose, sample)))
            picture = None if self._lens is None else self._lens.due(sample.state.t)
            if picture is not None:
                self._tell(JournalEntry("pictures", pictured(picture)))
            yield sample

    def hand(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        """The stage of the hand."""
        for sample in samples:
            assert self._fingers is not None
            target = self._fingers(sample.state.t).position
            self._tell(DeviceSample("hand", sample, {**self._beside_hand(), "target": target}))
            yield sample

    def _tell(self, event: SessionEvent) -> None:
        for each in self._each:
            each.on_event(event)


def beside_arm(room: Room, target: Pose, sample: Sample) -> dict[str, Array]:
    """What is known beside an arm's sample: `flange` and `tool`, the palm, by the encoders, and `goal`, where the
    flange is to go, (7,) each in the world; `force`, what the world does to the hand, (6,). `target`: in the base."""
    cell, state = room.cell, sample.state
    poses = {"flange": cell.flange(state), "tool": cell.palm(state), "goal": compose(cell.base, target)}
    found = {name: np.concatenate([pose.position, pose.quaternion]) for name, pose in poses.items()}
    return found | {"force": cell.wrench(state)}


def beside_hand(room: Room) -> Callable[[], Mapping[str, Vector]]:
    """What only a simulation knows: `palm`, `object`, the first thing, (7,) each in the world, and `others`, of the
    rest in a row."""
    model, data = room.cell.world.model, room.cell.world.data
    first, *rest = (model.body(thing.name).id for thing in room.settings.objects)
    palm = model.body(room.hand.spec.root).id

    def pose(body: int) -> Vector:
        return np.concatenate([data.xpos[body], data.xquat[body]])

    def look() -> Mapping[str, Vector]:
        others = {"others": np.concatenate([pose(body) for body in rest])} if rest else {}
        return {"palm": pose(palm), "object": pose(first), **others}

    return look
