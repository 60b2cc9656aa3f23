"""Actions of the cell's states: motion, pictures, forces and checks."""
