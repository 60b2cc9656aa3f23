"""Mirror in Rerun: the measured hand, the expected hand as a ghost, external torques, and events."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from allegro_twin.spec import HandSpec
from allegro_twin.twin.mirror.faults import fault_text
from allegro_twin.twin.mirror.mirror import Mirror
from allegro_twin.types import Array, HandState, Sample
from allegro_twin.viewing.rerun.layout import MORE
from allegro_twin.viewing.rerun.viewer import Viewer
from allegro_twin.viewing.scenery import Scenery, scenery

if TYPE_CHECKING:
    from allegro_twin.drivers.can.driver.health import Health

RATE = 10.0
"""Pictures per second: drawing more costs more than the mirror does (docs/results/mirror.md)."""
COUNTS = ("missed", "incomplete", "behind", "throttled")
"""Counts of a link's health that are drawn."""


def mirror_scenery(spec: HandSpec) -> Scenery:
    """What a viewer draws for a mirror."""
    return replace(scenery(spec, {}), ghost="expected", more=tuple(MORE), link=COUNTS)


def draw_mirror(samples: Iterable[Sample], mirror: Mirror, viewer: Viewer, health: Health | None) -> Iterator[Sample]:
    """Draw samples after the mirror observed them (a stage)."""
    last, unnamed = "", mirror.unchecked_faults
    for sample in samples:
        viewer.draw(sample, _columns(sample.state, mirror, health))
        if unnamed:
            viewer.happens(sample.state.t, f"not looked for: {', '.join(unnamed)}")
            unnamed = ()
        now = event_text(mirror)
        if now != last:
            viewer.happens(sample.state.t, now)
            last = now
        yield sample


def event_text(mirror: Mirror) -> str:
    """Contacts and faults as text; empty where all is as expected."""
    parts = [f"{name} is touched" for name in mirror.contacts]
    parts += [fault_text(each.fault, mirror.spec) for each in mirror.faults if each.ended == np.inf]
    return "; ".join(parts)


def _columns(state: HandState, mirror: Mirror, health: Health | None) -> dict[str, Array]:
    latest = mirror.columns()
    found = {"disturbance": latest["disturbance"], "residual": state.position - latest["predicted"]}
    if np.isfinite(latest["predicted"]).all():
        found["target"] = latest["predicted"]
    if np.isfinite(state.temperature).any():
        found["temperature"] = state.temperature
    if health is not None:
        found["link"] = np.array([float(getattr(health, name)) for name in COUNTS])
    return found
