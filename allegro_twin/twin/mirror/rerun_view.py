"""A mirror in Rerun: the hand as measured, as expected as a ghost, what pushes it, and what that means."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.faults import words
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array, HandState, Sample
from allegro_twin.viewing.rerun.layout import MORE
from allegro_twin.viewing.rerun.viewer import Viewer
from allegro_twin.viewing.scenery import Scenery, scenery

if TYPE_CHECKING:
    from allegro_twin.drivers.can.driver.health import Health

RATE = 10.0
"""Pictures a second: drawing more costs more than the mirror does (docs/mirror.md)."""
COUNTS = ("missed", "incomplete", "behind", "throttled")
"""Of a link's health: what is drawn."""


def stage(spec: HandSpec) -> Scenery:
    """What a viewer is to draw for a mirror."""
    return replace(scenery(spec, {}), ghost="expected", more=tuple(MORE), link=COUNTS)


def drawn(samples: Iterable[Sample], mirror: Mirror, viewer: Viewer, health: Health | None) -> Iterator[Sample]:
    """A stage after the mirror's."""
    said, unnamed = "", mirror.unnamed
    for sample in samples:
        viewer.draw(sample, _beside(sample.state, mirror, health))
        if unnamed:
            viewer.happens(sample.state.t, f"not looked for: {', '.join(unnamed)}")
            unnamed = ()
        now = happening(mirror)
        if now != said:
            viewer.happens(sample.state.t, now)
            said = now
        yield sample


def happening(mirror: Mirror) -> str:
    """In words; empty where all is as expected."""
    parts = [f"{name} is touched" for name in mirror.contacts]
    if mirror.anomaly is not None:
        parts.append(words(mirror.anomaly, mirror.spec))
    return "; ".join(parts)


def _beside(state: HandState, mirror: Mirror, health: Health | None) -> dict[str, Array]:
    latest = mirror.latest()
    found = {"disturbance": latest["disturbance"], "residual": state.position - latest["predicted"]}
    if np.isfinite(latest["predicted"]).all():
        found["target"] = latest["predicted"]
    if np.isfinite(state.temperature).any():
        found["temperature"] = state.temperature
    if health is not None:
        found["link"] = np.array([float(getattr(health, name)) for name in COUNTS])
    return found
