"""Gymnasium environments of a hand at a task: single, batched, and as tensors.

`engine` simulates the episodes of all of them. `observation_model` says what hands and cameras report, `randomise` what
differs from episode to episode.
"""
