"""Kinematics and statics of the whole hand."""
