"""Generates MJCF, URDF and meshes from a table of facts."""
