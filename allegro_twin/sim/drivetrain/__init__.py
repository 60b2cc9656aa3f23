"""What is between a command and a joint: servos, tendons' lengths, friction, backlash."""
