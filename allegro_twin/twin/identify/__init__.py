"""Identification of a hand's drive: record excitations, fit a model, write the hand's file.

`pipeline` is the entry, `report` the HTML page. `record_excitation` records a config's hand. `motions` has the
excitations and their recordings, `fitting` goes from these to a drive, `results` to values with uncertainties and the
hand's file. What is named here is loaded when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.twin.identify.motions.excitation import ExcitationPose, find_pose, rehearse
    from allegro_twin.twin.identify.motions.limits import FoundLimits, encoder_offsets, limit_sweep, limits_in_samples

__all__ = [
    "ExcitationPose",
    "FoundLimits",
    "encoder_offsets",
    "find_pose",
    "limit_sweep",
    "limits_in_samples",
    "rehearse",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "motions.excitation": ("ExcitationPose", "find_pose", "rehearse"),
        "motions.limits": ("FoundLimits", "encoder_offsets", "limit_sweep", "limits_in_samples"),
    },
)
