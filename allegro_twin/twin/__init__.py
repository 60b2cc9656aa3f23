"""The digital twin of one hand: identification, the mirror beside it, and what-if branches.

`identify` finds a hand"s drive from recordings. `mirror` runs a model beside the hand, and detects contacts and faults.
`branch` continues a recording differently. `rehearsal` performs on the hand what was made on its twin, and measures it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.twin.branch.result import BranchOptions, BranchResult
    from allegro_twin.twin.branch.what_if import branch_recording
    from allegro_twin.twin.identify.pipeline import Identification, KnownWeight, identify_hand
    from allegro_twin.twin.identify.results.hand_file import write_hand_file
    from allegro_twin.twin.mirror.factory import make_loop_mirror, make_mirror
    from allegro_twin.twin.mirror.fault_detection import Thresholds
    from allegro_twin.twin.mirror.mirror import Mirror
    from allegro_twin.twin.mirror.on_recording import mirror_recording

__all__ = [
    "BranchOptions",
    "BranchResult",
    "Identification",
    "KnownWeight",
    "Mirror",
    "Thresholds",
    "branch_recording",
    "identify_hand",
    "make_loop_mirror",
    "make_mirror",
    "mirror_recording",
    "write_hand_file",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "identify.pipeline": ("Identification", "KnownWeight", "identify_hand"),
        "identify.results.hand_file": ("write_hand_file",),
        "mirror.mirror": ("Mirror",),
        "mirror.factory": ("make_loop_mirror", "make_mirror"),
        "mirror.on_recording": ("mirror_recording",),
        "mirror.fault_detection": ("Thresholds",),
        "branch.what_if": ("branch_recording",),
        "branch.result": ("BranchOptions", "BranchResult"),
    },
)
