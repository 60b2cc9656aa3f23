"""The commands that find grasps, make them better and say what they are worth."""
