"""What a virtual hand really is, where that is not what its host believes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from allegro_twin.drivers.can.config import CanSettings, FaultSettings
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.hands.description.calibration import NOTHING
from allegro_twin.spec import HandSpec

_BLOCKS = ("actuation", "drive", "wire")


def truth_of(settings: CanSettings) -> Mapping[str, Any]:
    """The blocks that override a hand's file in a virtual hand's own program. Raises ConfigError."""
    truth = settings.scene.truth if settings.scene is not None else None
    if truth is None:
        return NOTHING
    if isinstance(truth, str):
        table = read_yaml(find_file(truth, "hand", "conf/hands"))
        return {name: table[name] for name in _BLOCKS if name in table}
    return truth


def loosened(spec: HandSpec, faults: FaultSettings | None) -> HandSpec:
    """The same hand, with a play that can grow in the joints that its faults may loosen; by chance: the fingertips."""
    if faults is None:
        return spec
    joints = {event.which for event in faults.script if event.what == "loose"}
    joints |= {finger.joints[-1] for finger in spec.fingers} if faults.failures else set()
    if not joints:
        return spec
    from allegro_twin.sim.drivetrain.backlash import allow_backlash

    return allow_backlash(spec, sorted(joints))
