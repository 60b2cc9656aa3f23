"""Everything of a run in one recording: arm and hand, states, detections, pictures, shapes and the config."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from allegro_twin.cell.assembly import Cell
from allegro_twin.cell.journal.rows import EVENTS, PERCEPTION, PICTURES
from allegro_twin.cell.settings import LabSettings
from allegro_twin.recording.arrow_writer import SharedFile
from allegro_twin.recording.events import DeviceSample, SessionEvent
from allegro_twin.recording.journal import Journal
from allegro_twin.recording.recorder import Recorder
from allegro_twin.sim.model.appearance import hand_bodies, scene_appearance, shapes_on
from allegro_twin.version import __version__
from allegro_twin.viewing.skeleton import bodies_of


def cell_look(cell: Cell) -> dict[str, Any]:
    """Links of `arm` and `hand`, `adapter` on the flange, `objects` and `fixed`; `base`: where the arm stands, m."""
    robot, object_names = cell.robot, tuple(each.name for each in cell.settings.objects)
    scene = scene_appearance(robot.world.model, cell.hand.spec, object_names)
    adapter = shapes_on(robot.world.model, f"{robot.spec.name}_adapter")
    return {
        "arm": [body.to_json() for body in hand_bodies(robot.spec)],
        "hand": [body.to_json() for body in bodies_of(cell.hand.spec)],
        "adapter": [shape.to_json() for shape in adapter],
        "base": [float(x) for x in robot.base.position],
        "objects": scene["objects"],
        "fixed": scene["fixed"],
    }


class SessionRecorder:
    """An onlooker that records one run into a file. Raises RecordingError for the file and the disk."""

    def __init__(self, cell: Cell, path: Path) -> None:
        object_names = tuple(each.name for each in cell.settings.objects)
        self._file = SharedFile(path, recording_meta(cell))
        fields = {"states": EVENTS, "perception": PERCEPTION, "pictures": PICTURES}
        self._journals = {name: Journal(self._file.track(name), each) for name, each in fields.items()}
        self._recorders: dict[str, Recorder] = {}
        for name, backend in (("arm", cell.arm), ("hand", cell.hand)):
            meta = {"lab": name, "look": scene_appearance(cell.robot.world.model, backend.spec, object_names)}
            self._recorders[name] = Recorder(self._file.track(name), backend.spec, backend.period, meta)

    def on_event(self, event: SessionEvent) -> None:
        """Write it; samples by the hundred, everything else at once."""
        if isinstance(event, DeviceSample):
            self._recorders[event.device].add(event.sample, event.extras)
        else:
            self._journals[event.track].add(**event.row)

    def close(self) -> None:
        """Write what is left. Idempotent. Raises RecordingError."""
        for recorder in self._recorders.values():
            recorder.close()
        for journal in self._journals.values():
            journal.close()
        self._file.close()


def recording_meta(cell: Cell) -> dict[str, Any]:
    """What is said of the whole run: who made it, of what, and from which config."""
    config = cell.settings.model_dump(mode="json")
    kept = {"allegro_twin": __version__, "lab": True, "config": config, "config_hash": config_hash(cell.settings)}
    return kept | cell.robot.arm_sim.meta() | {"look": cell_look(cell)}


def config_hash(settings: LabSettings) -> str:
    """Hash of everything that the config says, with what it leaves to defaults."""
    text = json.dumps(settings.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
