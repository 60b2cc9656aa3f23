"""Gymnasium environments: the engine for one hand and for many, and what differs from episode to episode."""
