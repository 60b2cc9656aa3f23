"""Policies: what they see, what they may do, how they are kept in a file, and the controller that runs one."""
