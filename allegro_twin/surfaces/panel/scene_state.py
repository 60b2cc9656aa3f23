"""What is known of a hand's surroundings at one moment: from the simulation, from a recording, or nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from allegro_twin.app import Rig
from allegro_twin.types import Array
from allegro_twin.viewing.scenery import Scenery, scenery

Eyes = Callable[[], Mapping[str, Array]]


def eyes_of(rig: Rig) -> Eyes:
    """For the thread that turns the loop, between two periods."""
    if rig.sim is None:
        extras = getattr(rig.backend, "extras", None)
        return dict if extras is None else extras
    model, data = rig.sim.model, rig.sim.data
    palm = model.body("palm_link").id
    if rig.trial is None:
        return lambda: {"palm": np.concatenate([data.xpos[palm], data.xquat[palm]])}
    from allegro_twin.sim.contact.probe import ObjectProbe

    first, *rest = [placed.thing.name for placed in rig.trial.things]
    probe, others = ObjectProbe(model, data, rig.spec, first), [model.body(name).id for name in rest]

    def look() -> Mapping[str, Array]:
        return probe() | {"others": np.hstack([data.xpos[others], data.xquat[others]])}

    return look


def scenery_of(rig: Rig) -> Scenery:
    """What there is to be seen. Raises ConfigError."""
    return scenery(rig.spec, _meta(rig))


def _meta(rig: Rig) -> Mapping[str, Any]:
    if rig.trial is not None:
        return rig.trial.meta()
    if rig.sim is not None:
        from allegro_twin.sim.model.appearance import scene_appearance

        return {"look": scene_appearance(rig.sim.model, rig.spec, ())}
    recording = getattr(rig.backend, "recording", None)
    return {} if recording is None else dict(recording.meta)
