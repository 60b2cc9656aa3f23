"""Hands on a serial line. `line`: what every such hand needs; `dynamixel`: hands made of DYNAMIXEL servos."""
