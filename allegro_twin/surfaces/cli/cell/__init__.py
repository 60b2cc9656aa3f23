"""The command for the cell of arm, hand and camera."""
