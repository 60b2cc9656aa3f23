"""Surfaces: the ways in for people and programs: Python, command line, browser, ROS, teleoperation."""
