"""From an object to ranked grasps: geometry proposes, physics closes the hand, the project's own trial confirms."""
