"""A depth camera in a simulated scene: what it sees, with what errors, when it is there, and what goes wrong with it."""
