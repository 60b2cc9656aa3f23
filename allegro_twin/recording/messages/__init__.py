"""What ROS says of a hand: message types, and a hand's states as messages and back. Nothing here talks to anybody."""
