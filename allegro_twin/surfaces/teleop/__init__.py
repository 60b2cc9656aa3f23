"""A person's hand, tracked, drives a robot's: a client of `Hand` that never turns its loop.
docs/how-to/teleoperate.md."""
