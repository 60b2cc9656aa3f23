"""Grasp search for an object: geometry proposes, physics closes the hand, the project's own trial confirms."""
