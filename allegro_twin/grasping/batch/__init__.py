"""Many grasp trials in one batch."""
