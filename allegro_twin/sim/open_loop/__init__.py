"""Recorded commands played through a model of the drive, without feedback."""
