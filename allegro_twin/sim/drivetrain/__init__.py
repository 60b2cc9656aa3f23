"""Drivetrain between command and joint: servos, tendon lengths, friction, backlash."""
