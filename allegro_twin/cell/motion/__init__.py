"""Motion of arm and fingers: which grasp, which path, within which limits."""
