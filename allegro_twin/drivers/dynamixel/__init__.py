"""Hands made of DYNAMIXEL servos: `codec` is pure, `host` drives a hand, `device` is one that does not exist."""
