"""Backends of a config: which device answers to which `backend.kind`."""
