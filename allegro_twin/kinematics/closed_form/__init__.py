"""Closed-form kinematics of the Allegro Hand's fingers."""
