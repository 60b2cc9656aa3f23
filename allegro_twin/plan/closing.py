"""Fingers that close until they meet something: each link stops where it touches, what is beyond it goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from allegro_twin.plan.candidate import Candidate
from allegro_twin.sim.workbench import Meetings, Workbench

COARSE, FINE = 0.17, 0.04
"""rad, of a step: where physics closes the fingers again afterwards, and where nothing does."""
FURTHEST = 1.6
"""rad that a joint closes."""


def closed(bench: Workbench, candidate: Candidate, step: float = COARSE) -> tuple[Candidate, Meetings]:
    """The candidate with its fingers closed, and where it touches the object."""
    spec = bench.spec
    posture = candidate.preshape.copy()
    moving = candidate.closing.copy()
    for _ in range(round(FURTHEST / step)):
        posture = np.clip(posture + step * moving, spec.lower, spec.upper)
        bench.place(candidate.position, candidate.rotation, posture)
        parts, links = bench.meets()
        for part, link in zip(parts.tolist(), links.tolist(), strict=True):
            if link >= 0:
                moving[list(spec.fingers[part].joints[: link + 1])] = 0.0
        moving[(posture <= spec.lower) | (posture >= spec.upper)] = 0.0
        if not moving.any():
            break
    return replace(candidate, close=posture), bench.touch()
