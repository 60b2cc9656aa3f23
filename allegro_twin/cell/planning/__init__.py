"""Which way to take what was seen: stored grasps, what the arm reaches, and grasps adapted to new solids."""
