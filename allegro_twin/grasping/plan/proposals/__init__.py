"""Geometry proposes: pre-shapes, palms, fingers that close, and the evolution of what they come to."""
