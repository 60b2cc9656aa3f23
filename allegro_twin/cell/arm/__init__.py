"""Arms: Cartesian control over the backend that a hand has, what the flange feels, and a hand on the flange."""
