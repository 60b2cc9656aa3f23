"""The commands that open a hand or a cell to people and programs: browser, ROS, camera."""
