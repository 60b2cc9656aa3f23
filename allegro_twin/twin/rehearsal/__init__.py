"""The rehearsal of one hand: what grasps and motions that were made on its twin lose on it.

`HandRehearsal` performs a `RehearsalProtocol` with a `RehearsedHand` and writes everything into a folder: recordings,
the identified hand's file, the result, and a page with the score beside those of hidden hands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.twin.rehearsal.measures import steady_error
    from allegro_twin.twin.rehearsal.program import Conversation, HandRehearsal
    from allegro_twin.twin.rehearsal.protocol import RehearsalProtocol, rehearsal_trajectory
    from allegro_twin.twin.rehearsal.score import hidden_scores, score_of
    from allegro_twin.twin.rehearsal.sessions import (
        RehearsedHand,
        RehearsedTwin,
        grasp_trial,
        hold_posture,
        lead_to_ends,
    )

__all__ = [
    "Conversation",
    "HandRehearsal",
    "RehearsalProtocol",
    "RehearsedHand",
    "RehearsedTwin",
    "grasp_trial",
    "hidden_scores",
    "hold_posture",
    "lead_to_ends",
    "rehearsal_trajectory",
    "score_of",
    "steady_error",
]
__getattr__, __dir__ = exports(
    __name__,
    {
        "measures": ("steady_error",),
        "program": ("Conversation", "HandRehearsal"),
        "protocol": ("RehearsalProtocol", "rehearsal_trajectory"),
        "score": ("hidden_scores", "score_of"),
        "sessions": ("RehearsedHand", "RehearsedTwin", "grasp_trial", "hold_posture", "lead_to_ends"),
    },
)  # fmt: skip
