"""A hand on ROS."""
