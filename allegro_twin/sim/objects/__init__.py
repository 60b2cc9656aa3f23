"""What is grasped: meshes, primitives, the user's own; how it is presented, and how it looks."""
