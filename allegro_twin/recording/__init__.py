"""Recordings: written, read, replayed and converted."""
