"""Grasps in other people's files: read, checked, put under our names and frames, and written back."""
