"""Commands for real and virtual hardware: hands, buses, ROS, teleoperation."""
