"""Checks of a grasp and of the sensors that judge it."""
