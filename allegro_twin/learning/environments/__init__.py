"""Gymnasium environments of a hand at a task: single, batched, and as tensors.

`engine` simulates the episodes of all of them. `observation_model` says what hands and cameras report, `randomise` what
differs from episode to episode.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from allegro_twin._lazy import exports

if TYPE_CHECKING:
    from allegro_twin.learning.environments.episode import EpisodeBackend

__all__ = ["EpisodeBackend"]
__getattr__, __dir__ = exports(__name__, {"episode": ("EpisodeBackend",)})
