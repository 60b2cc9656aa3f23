"""Policies: interface to a hand, files with cards, and the controller that runs one."""
